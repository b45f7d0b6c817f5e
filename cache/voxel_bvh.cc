#include "cache/voxel_bvh.h"

#include <immintrin.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <numeric>

#include "cache/renderer.h"
#include "common/check.h"
#include "common/scene_tables.h"

namespace preheat {

namespace {

// Ranges of more than 16 groups are cut at multiples of 8, and smaller ones so that one node of
// leaves takes them: then all nodes without nodes below them are full but the last.
constexpr std::uint32_t kWidth = VoxelTreeNode::kWidth;

std::uint32_t groups_of(std::uint64_t triangle_count) {
  return static_cast<std::uint32_t>((triangle_count + TriangleGroup::kWidth - 1) /
                                    TriangleGroup::kWidth);
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

// Spreads the low 8 bits three apart.
std::uint32_t spread(std::uint32_t bits) {
  bits = (bits | bits << 8) & 0x00F00FU;
  bits = (bits | bits << 4) & 0x0C30C3U;
  return (bits | bits << 2) & 0x249249U;
}

// A triangle and the place of its centre along a Morton curve of 256 cells a side.
struct Placed {
  std::uint32_t code = 0;
  std::uint32_t triangle = 0;
};

std::vector<Placed> place(const std::vector<Box>& boxes) {
  Box centres;
  for (const Box& box : boxes) {
    const __m128 centre = _mm_add_ps(box.low, box.high);  // doubled
    centres.extend({centre, centre});
  }
  const __m128 extent = _mm_max_ps(_mm_sub_ps(centres.high, centres.low), _mm_set1_ps(1e-30F));
  const __m128 scale = _mm_div_ps(_mm_set1_ps(255.9F), extent);
  std::vector<Placed> placed(boxes.size());
  for (std::uint32_t triangle = 0; triangle < placed.size(); ++triangle) {
    const Box& box = boxes[triangle];
    const __m128 offset = _mm_sub_ps(_mm_add_ps(box.low, box.high), centres.low);
    alignas(16) std::array<std::uint32_t, 4> cell{};
    _mm_store_si128(reinterpret_cast<__m128i*>(cell.data()),
                    _mm_cvttps_epi32(_mm_mul_ps(offset, scale)));
    placed[triangle] = {
        spread(cell[0] & 255U) << 2 | spread(cell[1] & 255U) << 1 | spread(cell[2] & 255U),
        triangle};
  }
  return placed;
}

// By code, then by triangle: three stable passes over eight bits each.
void sort_by_place(std::vector<Placed>& placed) {
  std::vector<Placed> sorted(placed.size());
  for (unsigned shift = 0; shift < 24; shift += 8) {
    std::array<std::uint32_t, 257> begin{};
    for (const Placed& item : placed) { ++begin[(item.code >> shift & 255U) + 1]; }
    std::partial_sum(begin.begin(), begin.end(), begin.begin());
    for (const Placed& item : placed) { sorted[begin[item.code >> shift & 255U]++] = item; }
    placed.swap(sorted);
  }
}

// Cuts a range of groups where the curve leaves the largest octant that holds it all, as nearly as
// the unit and a share of an eighth on either side allow. Returns the left part's groups.
std::uint32_t cut(const std::vector<std::uint32_t>& codes, const Range& range, std::uint32_t unit) {
  const auto first = codes.begin() + range.begin;
  const auto last = first + range.count;
  std::uint32_t left = range.count / 2;
  if (const std::uint32_t differing = *first ^ *(last - 1); differing != 0) {
    const std::uint32_t bit = std::bit_floor(differing);
    left = static_cast<std::uint32_t>(
        std::partition_point(first, last, [&](std::uint32_t code) { return (code & bit) == 0; }) -
        first);
    left = std::clamp(left, range.count / 8, range.count - range.count / 8);
  }
  left = std::max((left + unit / 2) / unit, 1U) * unit;
  while (left >= range.count) { left -= unit; }
  return left;
}

// Up to 8 parts of a range of more than one unit.
struct Parts {
  std::array<Range, kWidth> ranges{};
  std::uint32_t count = 0;
};

Parts divide(const std::vector<std::uint32_t>& codes, const Range& range) {
  const std::uint32_t unit = unit_of(range.count);
  Parts parts;
  parts.ranges[parts.count++] = range;
  while (parts.count < kWidth) {
    Range& largest =
        *std::max_element(parts.ranges.begin(), parts.ranges.begin() + parts.count,
                          [](const Range& a, const Range& b) { return a.count < b.count; });
    if (largest.count <= unit) { break; }
    const std::uint32_t left = cut(codes, largest, unit);
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

std::vector<TriangleGroup> groups_in_order(const VoxelBlockView& block,
                                           const std::vector<Placed>& placed) {
  std::vector<TriangleGroup> groups(groups_of(placed.size()));
  for (std::size_t at = 0; at < groups.size() * TriangleGroup::kWidth; ++at) {
    TriangleGroup& group = groups[at / TriangleGroup::kWidth];
    const std::size_t lane = at % TriangleGroup::kWidth;
    const std::uint32_t triangle = placed[std::min(at, placed.size() - 1)].triangle;
    group.triangles[lane] = triangle;
    for (std::size_t corner = 0; corner < 3; ++corner) {
      group.vertices[corner][lane] = block.indices[std::size_t{triangle} * 3 + corner];
    }
  }
  return groups;
}

// What the nodes are made of, group by group.
struct GroupTable {
  std::vector<Box> boxes{};
  std::vector<std::uint32_t> codes{};  // of each group's first triangle
};

GroupTable tabulate(const std::vector<Box>& boxes, const std::vector<Placed>& placed) {
  GroupTable table;
  const std::uint32_t group_count = groups_of(placed.size());
  table.boxes.resize(group_count);
  table.codes.resize(group_count);
  for (std::size_t at = placed.size(); at-- > 0;) {
    table.boxes[at / TriangleGroup::kWidth].extend(boxes[placed[at].triangle]);
    table.codes[at / TriangleGroup::kWidth] = placed[at].code;
  }
  return table;
}

std::vector<VoxelTreeNode> make_nodes(const GroupTable& table) {
  struct Task {
    Range range{};
    std::uint32_t node = 0;
    std::size_t depth = 0;
  };
  std::vector<VoxelTreeNode> nodes;
  nodes.reserve(nodes_max(table.boxes.size()));
  nodes.emplace_back();
  std::vector<Task> tasks{{{0, static_cast<std::uint32_t>(table.boxes.size())}, 0, 1}};
  while (!tasks.empty()) {
    const Task task = tasks.back();
    tasks.pop_back();
    CHECK(task.depth < VoxelTree::kDepthMax);
    const bool over_leaves = unit_of(task.range.count) <= VoxelTree::kLeafGroupsMax;
    const Parts parts = divide(table.codes, task.range);
    for (std::uint32_t at = 0; at < kWidth; ++at) {
      Box box;
      if (at < parts.count) {
        const Range& part = parts.ranges[at];
        for (std::uint32_t group = part.begin; group < part.begin + part.count; ++group) {
          box.extend(table.boxes[group]);
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

VoxelBvh::VoxelBvh(const VoxelBlockView& block) : positions_(block.positions.data()) {
  const std::size_t triangle_count = block.triangles.size();
  CHECK(triangle_count > 0);
  std::vector<Box> boxes(triangle_count);
  for (std::uint32_t triangle = 0; triangle < triangle_count; ++triangle) {
    boxes[triangle] = box_of(block, triangle);
  }
  std::vector<Placed> placed = place(boxes);
  sort_by_place(placed);
  groups_ = groups_in_order(block, placed);
  if (groups_.size() == 1) {
    root_ = leaf_of({0, 1});
    return;
  }
  const std::vector<VoxelTreeNode> nodes = make_nodes(tabulate(boxes, placed));
  nodes_.assign(nodes.begin(), nodes.end());  // without room to spare
}

std::uint64_t VoxelBvh::bytes_max(std::uint64_t triangle_count) {
  const std::uint64_t groups = groups_of(triangle_count);
  return nodes_max(groups) * sizeof(VoxelTreeNode) + groups * sizeof(TriangleGroup);
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
