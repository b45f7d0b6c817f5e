#include "cache/voxel_bvh.h"

#include <immintrin.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>

#include "cache/renderer.h"
#include "common/check.h"
#include "common/scene_tables.h"
#include "common/triangle_order.h"

namespace preheat {

namespace {

// Ranges of more than 16 groups are cut at multiples of 8, and smaller ones so that one node of
// leaves takes them: then all nodes without nodes below them are full but the last.
constexpr std::uint32_t kWidth = VoxelTreeNode::kWidth;

static_assert(VoxelTree::kGroupWidth == kTrianglesPerLeaf &&
                  VoxelTree::kGroupWidth * kWidth == kTrianglesPerLeafNode,
              "blocks are ordered for these trees");

std::uint32_t groups_of(std::uint64_t triangle_count) {
  return static_cast<std::uint32_t>((triangle_count + VoxelTree::kGroupWidth - 1) /
                                    VoxelTree::kGroupWidth);
}

// Groups that follow each other.
struct Range {
  std::uint32_t begin = 0;
  std::uint32_t count = 0;
};

std::uint32_t unit_of(std::uint32_t group_count) {
  if (group_count <= kWidth) { return 1; }
  return group_count <= 2 * kWidth ? 2 : kWidth;
}

// A box in two registers; the fourth lane means nothing.
struct Box {
  __m128 low = _mm_set1_ps(kInfinity);
  __m128 high = _mm_set1_ps(-kInfinity);
  void extend(const Box& box) {
    low = _mm_min_ps(low, box.low);
    high = _mm_max_ps(high, box.high);
  }
};

Box box_of(const VoxelBlockView& block, std::uint32_t triangle) {
  const auto load = [&](std::size_t corner) {
    const std::size_t vertex = block.indices[std::size_t{triangle} * 3 + corner];
    return _mm_loadu_ps(block.positions.data() + vertex * 3);  // blocks are padded for this
  };
  const __m128 a = load(0);
  const __m128 b = load(1);
  const __m128 c = load(2);
  return {_mm_min_ps(_mm_min_ps(a, b), c), _mm_max_ps(_mm_max_ps(a, b), c)};
}

float half_area(const Box& box) {
  const __m128 extent = _mm_sub_ps(box.high, box.low);
  const __m128 next = _mm_shuffle_ps(extent, extent, _MM_SHUFFLE(3, 0, 2, 1));
  const __m128 products = _mm_mul_ps(extent, next);  // xy, yz, zx
  alignas(16) std::array<float, 4> sides{};
  _mm_store_ps(sides.data(), products);
  return sides[0] + sides[1] + sides[2];
}

// Cuts a range of groups into two that follow each other, where the sum of area times groups is
// least (MacDonald and Booth 1990, section 3), with an eighth of the groups on either side if the
// unit allows. `areas`: scratch, as long as `boxes`. Returns the left part's groups.
std::uint32_t cut(const std::vector<Box>& boxes, const Range& range, std::uint32_t unit,
                  std::vector<float>& areas) {
  const std::uint32_t margin = std::max(range.count / 8, 1U);
  const std::uint32_t first = (margin + unit - 1) / unit * unit;
  const std::uint32_t last = std::max((range.count - margin) / unit * unit, first);
  Box right;
  for (std::uint32_t left = range.count; left-- > first;) {
    right.extend(boxes[range.begin + left]);
    if (left % unit == 0) { areas[left] = half_area(right); }
  }
  Box box;
  std::uint32_t best = first;
  float best_cost = kInfinity;
  for (std::uint32_t left = 1; left <= last; ++left) {
    box.extend(boxes[range.begin + left - 1]);
    if (left < first || left % unit != 0) { continue; }
    const float cost = half_area(box) * static_cast<float>(left) +
                       areas[left] * static_cast<float>(range.count - left);
    if (cost < best_cost) {
      best = left;
      best_cost = cost;
    }
  }
  return best;
}

// Up to 8 parts of a range of more than one unit.
struct Parts {
  std::array<Range, kWidth> ranges{};
  std::uint32_t count = 0;
};

Parts divide(const std::vector<Box>& boxes, const Range& range, std::vector<float>& areas) {
  const std::uint32_t unit = unit_of(range.count);
  Parts parts;
  parts.ranges[parts.count++] = range;
  while (parts.count < kWidth) {
    Range& largest =
        *std::max_element(parts.ranges.begin(), parts.ranges.begin() + parts.count,
                          [](const Range& a, const Range& b) { return a.count < b.count; });
    if (largest.count <= unit) { break; }
    const std::uint32_t left = cut(boxes, largest, unit, areas);
    parts.ranges[parts.count++] = {largest.begin + left, largest.count - left};
    largest.count = left;
  }
  return parts;
}

void set_box(VoxelTreeNode& node, std::uint32_t at, const Box& box) {
  alignas(16) std::array<float, 4> low{};
  alignas(16) std::array<float, 4> high{};
  _mm_store_ps(low.data(), _mm_sub_ps(box.low, _mm_set1_ps(kVoxelMargin)));
  _mm_store_ps(high.data(), _mm_add_ps(box.high, _mm_set1_ps(kVoxelMargin)));
  for (std::size_t axis = 0; axis < 3; ++axis) {
    node.faces[axis][at] = low[axis];
    node.faces[axis + 3][at] = high[axis];
  }
}

std::uint32_t leaf_of(const Range& range) {
  CHECK(range.count <= VoxelTree::kLeafGroupsMax);
  return VoxelTree::kLeaf | (range.count - 1) << VoxelTree::kLeafGroupsShift | range.begin;
}

// Nodes over so many groups, at most.
std::uint64_t nodes_max(std::uint64_t group_count) {
  if (group_count <= 1) { return 0; }
  const std::uint64_t full = (group_count + kWidth - 1) / kWidth;
  return full + (full * 4 + 6) / 7;
}

std::vector<Box> boxes_of_groups(const VoxelBlockView& block) {
  std::vector<Box> boxes(groups_of(block.triangles.size()));
  for (std::uint32_t triangle = 0; triangle < block.triangles.size(); ++triangle) {
    boxes[triangle / VoxelTree::kGroupWidth].extend(box_of(block, triangle));
  }
  return boxes;
}

std::vector<VoxelTreeNode> make_nodes(const std::vector<Box>& boxes) {
  struct Task {
    Range range{};
    std::uint32_t node = 0;
    std::size_t depth = 0;
  };
  std::vector<float> areas(boxes.size());
  std::vector<VoxelTreeNode> nodes;
  nodes.reserve(nodes_max(boxes.size()));
  nodes.emplace_back();
  std::vector<Task> tasks{{{0, static_cast<std::uint32_t>(boxes.size())}, 0, 1}};
  while (!tasks.empty()) {
    const Task task = tasks.back();
    tasks.pop_back();
    CHECK(task.depth < VoxelTree::kDepthMax);
    const bool over_leaves = unit_of(task.range.count) <= VoxelTree::kLeafGroupsMax;
    const Parts parts = divide(boxes, task.range, areas);
    for (std::uint32_t at = 0; at < kWidth; ++at) {
      Box box;
      if (at < parts.count) {
        const Range& part = parts.ranges[at];
        for (std::uint32_t group = part.begin; group < part.begin + part.count; ++group) {
          box.extend(boxes[group]);
        }
        if (over_leaves) {
          nodes[task.node].children[at] = leaf_of(part);
        } else {
          nodes[task.node].children[at] = static_cast<std::uint32_t>(nodes.size());
          tasks.push_back({part, static_cast<std::uint32_t>(nodes.size()), task.depth + 1});
          nodes.emplace_back();
        }
      }
      set_box(nodes[task.node], at, box);
    }
  }
  return nodes;
}

}  // namespace

VoxelBvh::VoxelBvh(const VoxelBlockView& block)
    : indices_(block.indices),
      positions_(block.positions.data()),
      triangle_count_(static_cast<std::uint32_t>(block.triangles.size())) {
  CHECK(triangle_count_ > 0);
  if (groups_of(triangle_count_) == 1) {
    root_ = leaf_of({0, 1});
    return;
  }
  const std::vector<VoxelTreeNode> nodes = make_nodes(boxes_of_groups(block));
  nodes_.assign(nodes.begin(), nodes.end());  // without room to spare
}

std::uint64_t VoxelBvh::bytes_max(std::uint64_t triangle_count) {
  return nodes_max(groups_of(triangle_count)) * sizeof(VoxelTreeNode);
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
