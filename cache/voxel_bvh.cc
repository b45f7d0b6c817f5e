#include "cache/voxel_bvh.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>

#include "cache/renderer.h"
#include "common/aabb.h"
#include "common/check.h"
#include "common/scene_tables.h"

namespace preheat {

namespace {

// Ranges of more than 64 triangles are cut at multiples of 32, and smaller ones so that one node of
// leaves takes them: then all nodes without nodes below them are full but the last.
constexpr std::uint32_t kNodeTriangles = VoxelTreeNode::kWidth * TriangleGroup::kWidth;

struct Item {
  Vec3 low{0.0F};
  std::uint32_t triangle = 0;
  Vec3 high{0.0F};
  [[nodiscard]] float centre(int axis) const { return low[axis] + high[axis]; }  // doubled
};

std::uint64_t groups_of(std::uint64_t triangle_count) {
  return (triangle_count + TriangleGroup::kWidth - 1) / TriangleGroup::kWidth;
}

struct Range {
  std::uint32_t begin = 0;
  std::uint32_t count = 0;
};

std::uint32_t unit_of(std::uint32_t count) {
  if (count <= kNodeTriangles) { return TriangleGroup::kWidth; }
  return count <= 2 * kNodeTriangles ? 2 * TriangleGroup::kWidth : kNodeTriangles;
}

float half_area(const Aabb& box) {
  const Vec3 extent = box.extent();
  return extent.x * extent.y + extent.y * extent.z + extent.z * extent.x;
}

class Bins {
 public:
  Bins(float low, float high, int axis)
      : low_(low), scale_(static_cast<float>(kBins) / (high - low)), axis_(axis) {}

  void add(const Item& item) {
    const auto at = static_cast<std::size_t>((item.centre(axis_) - low_) * scale_);
    Bin& bin = bins_[std::min(at, kBins - 1)];
    ++bin.count;
    bin.box.extend(item.low);
    bin.box.extend(item.high);
  }

  // How many items should go left of a cut, by the surface area heuristic.
  [[nodiscard]] std::uint32_t best_cut() const {
    std::array<float, kBins> cost_right{};
    Aabb box;
    std::uint32_t count = 0;
    for (std::size_t at = kBins; at-- > 1;) {
      box.extend(bins_[at].box);
      count += bins_[at].count;
      cost_right[at] = count == 0 ? 0.0F : half_area(box) * static_cast<float>(count);
    }
    box = Aabb{};
    count = 0;
    float best_cost = kInfinity;
    std::uint32_t best = 0;
    for (std::size_t at = 0; at + 1 < kBins; ++at) {
      box.extend(bins_[at].box);
      count += bins_[at].count;
      if (count == 0) { continue; }
      const float cost = half_area(box) * static_cast<float>(count) + cost_right[at + 1];
      if (cost < best_cost) {
        best_cost = cost;
        best = count;
      }
    }
    return best;
  }

 private:
  static constexpr std::size_t kBins = 16;
  struct Bin {
    Aabb box{};
    std::uint32_t count = 0;
  };
  float low_;
  float scale_;
  int axis_;
  std::array<Bin, kBins> bins_{};
};

// Cuts a range in two along the widest axis of its centres and returns the left part's size, a
// multiple of `unit`, with at least an eighth on either side where the unit allows it.
std::uint32_t cut(std::span<Item> items, std::uint32_t unit) {
  Aabb centres;
  for (const Item& item : items) { centres.extend(item.low + item.high); }
  const Vec3 extent = centres.extent();
  const int axis = extent.x >= extent.y && extent.x >= extent.z ? 0 : extent.y >= extent.z ? 1 : 2;
  const auto count = static_cast<std::uint32_t>(items.size());
  std::uint32_t left = count / 2;
  if (extent[axis] > 0.0F) {
    Bins bins(centres.low[axis], centres.high[axis], axis);
    for (const Item& item : items) { bins.add(item); }
    left = std::clamp(bins.best_cut(), count / 8, count - count / 8);
  }
  left = std::max((left + unit / 2) / unit, 1U) * unit;
  while (left >= count) { left -= unit; }
  // Ties go to the lower triangle, so that the tree is a function of the block.
  std::nth_element(items.begin(), items.begin() + left, items.end(),
                   [axis](const Item& a, const Item& b) {
                     const float at_a = a.centre(axis);
                     const float at_b = b.centre(axis);
                     return at_a != at_b ? at_a < at_b : a.triangle < b.triangle;
                   });
  return left;
}

// Up to 8 parts of a range of more than one unit.
struct Parts {
  std::array<Range, VoxelTreeNode::kWidth> ranges{};
  std::uint32_t count = 0;
};

Parts divide(std::vector<Item>& items, const Range& range) {
  const std::uint32_t unit = unit_of(range.count);
  Parts parts;
  parts.ranges[parts.count++] = range;
  while (parts.count < VoxelTreeNode::kWidth) {
    Range& largest =
        *std::max_element(parts.ranges.begin(), parts.ranges.begin() + parts.count,
                          [](const Range& a, const Range& b) { return a.count < b.count; });
    if (largest.count <= unit) { break; }
    const std::uint32_t left = cut(std::span(items).subspan(largest.begin, largest.count), unit);
    parts.ranges[parts.count++] = {largest.begin + left, largest.count - left};
    largest.count = left;
  }
  return parts;
}

Aabb box_of(const std::vector<Item>& items, const Range& range) {
  Aabb box;
  for (std::uint32_t at = range.begin; at < range.begin + range.count; ++at) {
    box.extend(items[at].low);
    box.extend(items[at].high);
  }
  return {box.low - kVoxelMargin, box.high + kVoxelMargin};
}

std::uint32_t leaf_of(const Range& range) {
  const auto groups = static_cast<std::uint32_t>(groups_of(range.count));
  CHECK(groups <= VoxelTree::kLeafGroupsMax && range.begin % TriangleGroup::kWidth == 0);
  return VoxelTree::kLeaf | (groups - 1) << VoxelTree::kLeafGroupsShift |
         range.begin / TriangleGroup::kWidth;
}

std::vector<Item> items_of(const VoxelBlockView& block) {
  std::vector<Item> items(block.triangles.size());
  for (std::uint32_t triangle = 0; triangle < items.size(); ++triangle) {
    Aabb box;
    for (std::size_t corner = 0; corner < 3; ++corner) {
      const float* const vertex =
          block.positions.data() + std::size_t{block.indices[triangle * 3 + corner]} * 3;
      box.extend(Vec3(vertex[0], vertex[1], vertex[2]));
    }
    items[triangle] = {box.low, triangle, box.high};
  }
  return items;
}

bool fits_leaf(const Range& range, std::uint32_t unit) {
  return range.count <= unit && unit <= VoxelTree::kLeafGroupsMax * TriangleGroup::kWidth;
}

// Nodes of `triangle_count` triangles, at most.
std::uint64_t nodes_max(std::uint64_t triangle_count) {
  const std::uint64_t full = (triangle_count + kNodeTriangles - 1) / kNodeTriangles;
  return full + (full * 4 + 6) / 7;
}

std::vector<TriangleGroup> groups_in_order(const VoxelBlockView& block,
                                           const std::vector<Item>& items) {
  std::vector<TriangleGroup> groups(groups_of(items.size()));
  for (std::size_t at = 0; at < groups.size() * TriangleGroup::kWidth; ++at) {
    TriangleGroup& group = groups[at / TriangleGroup::kWidth];
    const std::size_t lane = at % TriangleGroup::kWidth;
    const std::uint32_t triangle = items[std::min(at, items.size() - 1)].triangle;
    group.triangles[lane] = triangle;
    for (std::size_t corner = 0; corner < 3; ++corner) {
      group.vertices[corner][lane] = block.indices[std::size_t{triangle} * 3 + corner];
    }
  }
  return groups;
}

}  // namespace

VoxelBvh::VoxelBvh(const VoxelBlockView& block) : positions_(block.positions.data()) {
  CHECK(!block.triangles.empty());
  std::vector<Item> items = items_of(block);
  const auto count = static_cast<std::uint32_t>(items.size());
  struct Task {
    Range range{};
    std::uint32_t node = 0;
    std::size_t depth = 0;
  };
  std::vector<Task> tasks;
  if (count <= TriangleGroup::kWidth) {
    root_ = leaf_of({0, count});
  } else {
    nodes_.reserve(nodes_max(count));
    nodes_.emplace_back();
    tasks.push_back({{0, count}, 0, 1});
  }
  while (!tasks.empty()) {
    const Task task = tasks.back();
    tasks.pop_back();
    CHECK(task.depth < VoxelTree::kDepthMax);
    const std::uint32_t unit = unit_of(task.range.count);
    const Parts parts = divide(items, task.range);
    for (std::uint32_t at = 0; at < VoxelTreeNode::kWidth; ++at) {
      const bool used = at < parts.count;
      const Aabb box = used ? box_of(items, parts.ranges[at]) : Aabb{};
      for (int axis = 0; axis < 3; ++axis) {
        nodes_[task.node].faces[axis][at] = box.low[axis];
        nodes_[task.node].faces[axis + 3][at] = box.high[axis];
      }
      nodes_[task.node].children[at] = 0;
      if (!used) { continue; }
      if (fits_leaf(parts.ranges[at], unit)) {
        nodes_[task.node].children[at] = leaf_of(parts.ranges[at]);
        continue;
      }
      const auto child = static_cast<std::uint32_t>(nodes_.size());
      nodes_.emplace_back();
      nodes_[task.node].children[at] = child;
      tasks.push_back({parts.ranges[at], child, task.depth + 1});
    }
  }
  groups_ = groups_in_order(block, items);
  nodes_.shrink_to_fit();
}

std::uint64_t VoxelBvh::bytes_max(std::uint64_t triangle_count) {
  const std::uint64_t nodes =
      triangle_count <= TriangleGroup::kWidth ? 0 : nodes_max(triangle_count);
  return nodes * sizeof(VoxelTreeNode) + groups_of(triangle_count) * sizeof(TriangleGroup);
}

KernelRay kernel_ray(const Ray& ray, float t_far) {
  constexpr float kReciprocalMax = 1e18F;  // Embree's bound on 1 / 0
  KernelRay result;
  for (unsigned at = 0; at < 3; ++at) {
    const auto axis = static_cast<int>(at);
    result.origin[axis] = ray.origin[axis];
    result.direction[axis] = ray.direction[axis];
    result.reciprocal[axis] = std::copysign(
        std::min(1.0F / std::abs(ray.direction[axis]), kReciprocalMax), ray.direction[axis]);
    const bool backwards = result.reciprocal[axis] < 0.0F;
    result.near_face[at] = backwards ? at + 3 : at;
    result.far_face[at] = backwards ? at : at + 3;
  }
  result.t_near = ray.t_min;
  result.t_far = t_far;
  return result;
}

VoxelKernel voxel_kernel() {
  static const VoxelKernel kernel =
      std::strcmp(tracing_isa(), "avx2") == 0 ? trace_voxel_avx2 : trace_voxel_sse42;
  return kernel;
}

}  // namespace preheat
