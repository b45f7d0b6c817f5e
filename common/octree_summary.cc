#include "common/octree_summary.h"

#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>

#include "common/blocking.h"
#include "common/bounded.h"
#include "common/check.h"
#include "common/compensated_sum.h"

namespace preheat {

double OctreeSums::traversal_cost() const {
  return preheat::traversal_cost(depth_mean(), blocking_mean());
}

double OctreeSums::stop_probability() const {
  return preheat::stop_probability(blocking_mean(), std::exp2(depth_mean()));
}

namespace {

constexpr unsigned kChildren = 8;

struct Leaf {
  Aabb cell{};
  std::uint32_t node = 0;
  std::uint32_t depth = 0;  // below the summary node
};

// The leaves below a node of the summary that has no children there.
struct Subtree {
  std::uint32_t summary_node = 0;
  std::uint32_t octree_node = 0;
  std::size_t leaves_begin = 0;  // of the filled ones
  std::size_t leaves_end = 0;
};

[[nodiscard]] double blocking_of_leaf(const Scene& scene, const Octree& octree, const Leaf& leaf) {
  const OctreeNode& node = octree.nodes[leaf.node];
  BlockingFactor blocking(leaf.cell);
  for (std::uint64_t i = 0; i < node.references_count; ++i) {
    const Triangle& triangle = scene.triangles[octree.references[node.references_begin + i]];
    Aabb box;
    for (const std::uint32_t vertex : triangle.vertices) { box.extend(scene.positions[vertex]); }
    blocking.add(box);
  }
  return blocking.probability();
}

// The nodes without their sums, and what hangs below those that have no children.
[[nodiscard]] std::vector<Subtree> grow_nodes(const Octree& octree, OctreeSummary& summary) {
  std::vector<Subtree> subtrees;
  if (octree.nodes.empty() || octree.nodes[0].references_count == 0) { return subtrees; }
  std::vector<std::uint32_t> octree_node{0};  // of each in summary.nodes
  summary.nodes.push_back({.cell = octree.root});
  for (std::uint32_t index = 0; index < summary.nodes.size(); ++index) {
    const std::uint32_t first_child = octree.nodes[octree_node[index]].first_child;
    SummaryNode node = summary.nodes[index];
    for (unsigned octant = 0; octant < kChildren && first_child != 0; ++octant) {
      const bool filled = octree.nodes[first_child + octant].references_count > 0;
      node.child_mask = static_cast<std::uint8_t>(node.child_mask | (filled ? 1U : 0U) << octant);
    }
    if (first_child == 0 || node.depth == kSummaryDepthMax) {
      subtrees.push_back({index, octree_node[index]});
    } else {
      node.first_child = static_cast<std::uint32_t>(summary.nodes.size());
      for (unsigned octant = 0; octant < kChildren; ++octant) {
        if ((node.child_mask >> octant & 1U) == 0) { continue; }
        summary.nodes.push_back({.cell = child_cell(node.cell, octant), .depth = node.depth + 1});
        octree_node.push_back(first_child + octant);
      }
    }
    summary.nodes[index] = node;
  }
  return subtrees;
}

// Appends the filled leaves of a subtree; the counts and levels of all of them go to the sums.
void collect_leaves(const Octree& octree, Subtree& subtree, OctreeSummary& summary,
                    std::vector<Leaf>& leaves) {
  SummaryNode& root = summary.nodes[subtree.summary_node];
  OctreeSums& sums = root.sums;
  CompensatedSum surface;
  CompensatedSum surface_depth;
  sums = {.leaves_empty = 0, .level_min = kOctreeDepthMax};
  subtree.leaves_begin = leaves.size();
  std::vector<Leaf> waiting{{root.cell, subtree.octree_node, 0}};
  while (!waiting.empty()) {
    const Leaf at = waiting.back();
    waiting.pop_back();
    const OctreeNode& node = octree.nodes[at.node];
    if (node.first_child != 0) {
      for (unsigned octant = kChildren; octant-- > 0;) {
        waiting.push_back({child_cell(at.cell, octant), node.first_child + octant, at.depth + 1});
      }
      continue;
    }
    const double leaf_surface = std::ldexp(1.0, -2 * static_cast<int>(at.depth));
    surface.add(leaf_surface);
    surface_depth.add(leaf_surface * at.depth);
    sums.level_min = std::min(sums.level_min, at.depth);
    sums.level_max = std::max(sums.level_max, at.depth);
    sums.references += node.references_count;
    ++(node.references_count == 0 ? sums.leaves_empty : sums.leaves_filled);
    if (node.references_count > 0) { leaves.push_back(at); }
  }
  subtree.leaves_end = leaves.size();
  sums.surface = surface.value();
  sums.surface_depth = surface_depth.value();
}

// Octants without triangles are single empty leaves.
[[nodiscard]] OctreeSums sums_of_children(const OctreeSummary& summary, const SummaryNode& node) {
  OctreeSums sums{.leaves_empty = 0, .level_min = kOctreeDepthMax, .surface = 0.0};
  std::uint32_t child = node.first_child;
  for (unsigned octant = 0; octant < kChildren; ++octant) {
    const bool filled = (node.child_mask >> octant & 1U) != 0;
    const OctreeSums part = filled ? summary.nodes[child++].sums : OctreeSums{};
    sums.leaves_filled += part.leaves_filled;
    sums.leaves_empty += part.leaves_empty;
    sums.references += part.references;
    sums.level_min = std::min(sums.level_min, part.level_min + 1);
    sums.level_max = std::max(sums.level_max, part.level_max + 1);
    sums.surface += 0.25 * part.surface;
    sums.surface_depth += 0.25 * (part.surface_depth + part.surface);
    sums.blocking += 0.125 * part.blocking;
  }
  sums.blocking = std::min(1.0, sums.blocking);  // up to rounding it is
  return sums;
}

void add_up(OctreeSummary& summary) {
  for (std::size_t index = summary.nodes.size(); index-- > 0;) {
    SummaryNode& node = summary.nodes[index];
    if (node.first_child != 0) { node.sums = sums_of_children(summary, node); }
  }
}

}  // namespace

OctreeSummary build_octree_summary(const Scene& scene, const Octree& octree) {
  OctreeSummary summary{.root = octree.root};
  std::vector<Subtree> subtrees = grow_nodes(octree, summary);
  std::vector<Leaf> leaves;
  for (Subtree& subtree : subtrees) { collect_leaves(octree, subtree, summary, leaves); }
  std::vector<double> blocking(leaves.size());
  tbb::parallel_for(std::size_t{0}, leaves.size(), [&](std::size_t i) {
    blocking[i] = blocking_of_leaf(scene, octree, leaves[i]);
  });
  for (const Subtree& subtree : subtrees) {
    CompensatedSum sum;
    for (std::size_t i = subtree.leaves_begin; i < subtree.leaves_end; ++i) {
      sum.add(std::ldexp(blocking[i], -3 * static_cast<int>(leaves[i].depth)));
    }
    summary.nodes[subtree.summary_node].sums.blocking = std::min(1.0, sum.value());
  }
  add_up(summary);
  return summary;
}

// ---- bytes ----

template <class Archive>
void serialize(Archive& archive, OctreeSums& sums) {
  archive(sums.leaves_filled, sums.leaves_empty, sums.references, sums.level_min, sums.level_max,
          sums.surface, sums.surface_depth, sums.blocking);
}

namespace {

// An inner node needs no more than its mask, as its sums are its children's; a leaf needs two
// numbers.
struct Packed {
  Aabb root{};
  std::vector<std::uint8_t> child_masks{};       // [nodes]
  std::vector<std::uint32_t> leaf_references{};  // [nodes that are octree leaves]
  std::vector<double> leaf_blocking{};           // [same]
  std::vector<OctreeSums> subtrees{};            // [nodes at kSummaryDepthMax that are not]
};

template <class Archive>
void serialize(Archive& archive, Packed& packed) {
  archive(packed.root, at_most(packed.child_masks, kSummaryNodesMax),
          at_most(packed.leaf_references, kSummaryNodesMax),
          at_most(packed.leaf_blocking, kSummaryNodesMax),
          at_most(packed.subtrees, kSummaryNodesMax));
}

[[nodiscard]] tl::unexpected<Error> damaged(std::string what) {
  return fail(ExitCode::kStoreDamaged, "octree summary: " + std::move(what));
}

[[nodiscard]] bool is_possible(const OctreeSums& sums) {
  constexpr double kSurfaceMax = 1U << kOctreeDepthMax;  // every leaf at the depth limit
  return sums.leaves_filled > 0 && sums.references >= sums.leaves_filled && sums.level_min > 0 &&
         sums.level_min <= sums.level_max && sums.level_max <= kOctreeDepthMax &&
         sums.surface >= 1.0 && sums.surface <= kSurfaceMax && sums.surface_depth >= 0.0 &&
         sums.surface_depth <= sums.surface * kOctreeDepthMax && sums.blocking >= 0.0 &&
         sums.blocking <= 1.0;
}

[[nodiscard]] bool is_cube_like(const Aabb& cell) {
  constexpr float kReach = 4.0F;  // the scene's frame is [-1,1] and margins
  bool usable = true;
  for (int axis = 0; axis < 3; ++axis) {
    usable = usable && cell.low[axis] < cell.high[axis] && cell.low[axis] >= -kReach &&
             cell.high[axis] <= kReach;
  }
  return usable;
}

// The counts of the whole octree must fit their type: a node's fit if its parent's do.
[[nodiscard]] bool counts_fit(const Packed& packed) {
  std::uint64_t leaves = 8 * packed.child_masks.size();
  std::uint64_t references = 0;
  for (const std::uint32_t count : packed.leaf_references) { references += count; }
  for (const OctreeSums& sums : packed.subtrees) {
    leaves += std::uint64_t{sums.leaves_filled} + sums.leaves_empty;
    references += sums.references;
  }
  return leaves <= ~std::uint32_t{0} && references <= ~std::uint32_t{0};
}

// Nodes from masks: each appends its children, so that breadth first falls out.
[[nodiscard]] Result<OctreeSummary> expand(const Packed& packed) {
  if (!is_cube_like(packed.root)) { return damaged("its root is no cell of a scene"); }
  if (!counts_fit(packed)) { return damaged("more leaves or references than it can count"); }
  OctreeSummary summary{.root = packed.root};
  const std::size_t count = packed.child_masks.size();
  std::size_t leaf = 0;
  std::size_t subtree = 0;
  if (count > 0) { summary.nodes.push_back({.cell = packed.root}); }
  for (std::size_t index = 0; index < summary.nodes.size(); ++index) {
    if (index >= count) { return damaged(fmt::format("children beyond its {} nodes", count)); }
    SummaryNode node = summary.nodes[index];
    node.child_mask = packed.child_masks[index];
    if (node.child_mask == 0) {
      if (leaf >= std::min(packed.leaf_references.size(), packed.leaf_blocking.size()) ||
          packed.leaf_references[leaf] == 0 || !(packed.leaf_blocking[leaf] >= 0.0) ||
          packed.leaf_blocking[leaf] > 1.0) {
        return damaged(fmt::format("leaf {} is missing or impossible", leaf));
      }
      node.sums.leaves_filled = 1;
      node.sums.leaves_empty = 0;
      node.sums.references = packed.leaf_references[leaf];
      node.sums.blocking = packed.leaf_blocking[leaf++];
    } else if (node.depth == kSummaryDepthMax) {
      if (subtree >= packed.subtrees.size() || !is_possible(packed.subtrees[subtree])) {
        return damaged(fmt::format("subtree {} is missing or impossible", subtree));
      }
      node.sums = packed.subtrees[subtree++];
    } else {
      node.first_child = static_cast<std::uint32_t>(summary.nodes.size());
      for (unsigned octant = 0; octant < kChildren; ++octant) {
        if ((node.child_mask >> octant & 1U) == 0) { continue; }
        summary.nodes.push_back({.cell = child_cell(node.cell, octant), .depth = node.depth + 1});
      }
    }
    summary.nodes[index] = node;
  }
  if (summary.nodes.size() != count || leaf != packed.leaf_references.size() ||
      leaf != packed.leaf_blocking.size() || subtree != packed.subtrees.size()) {
    return damaged(fmt::format("{} nodes where its masks make {}", count, summary.nodes.size()));
  }
  add_up(summary);
  return summary;
}

}  // namespace

std::vector<std::byte> encode_octree_summary(const OctreeSummary& summary) {
  Packed packed{.root = summary.root};
  for (const SummaryNode& node : summary.nodes) {
    packed.child_masks.push_back(node.child_mask);
    if (node.child_mask == 0) {
      packed.leaf_references.push_back(node.sums.references);
      packed.leaf_blocking.push_back(node.sums.blocking);
    } else if (node.first_child == 0) {
      packed.subtrees.push_back(node.sums);
    }
  }
  return encode(packed);
}

Result<OctreeSummary> decode_octree_summary(std::span<const std::byte> bytes) {
  const Result<Packed> packed = decode<Packed>(bytes, "octree summary", ExitCode::kStoreDamaged);
  if (!packed) { return tl::unexpected(packed.error()); }
  return expand(*packed);
}

// ---- cuts ----

namespace {

[[nodiscard]] bool is_cut(const SummaryNode& node, std::uint32_t depth) {
  return node.first_child == 0 || node.depth == depth;
}

// The kept child of a node in an octant; 0 where the octant is empty.
[[nodiscard]] std::uint32_t child_in(const SummaryNode& node, unsigned octant) {
  if ((node.child_mask >> octant & 1U) == 0) { return 0; }
  const unsigned before = node.child_mask & ((1U << octant) - 1U);
  return node.first_child + static_cast<std::uint32_t>(std::popcount(before));
}

[[nodiscard]] double surface_of(const Aabb& box) {
  const Vec3d extent = Vec3d(box.high) - Vec3d(box.low);
  return 2.0 * (extent.x * extent.y + extent.y * extent.z + extent.z * extent.x);
}

// Whether the segment lies in the cell for more than a point. A segment in a face belongs to the
// cell whose lower face it is.
[[nodiscard]] bool crosses(const Vec3d& from, const Vec3d& step, const Aabb& cell) {
  constexpr double kPoint = 1e-12;  // share of the segment
  double enter = 0.0;
  double exit = 1.0;
  for (int axis = 0; axis < 3; ++axis) {
    const auto low = static_cast<double>(cell.low[axis]);
    const auto high = static_cast<double>(cell.high[axis]);
    if (step[axis] == 0.0) {
      if (from[axis] < low || from[axis] >= high) { return false; }
      continue;
    }
    const double at_low = (low - from[axis]) / step[axis];
    const double at_high = (high - from[axis]) / step[axis];
    enter = std::max(enter, std::min(at_low, at_high));
    exit = std::min(exit, std::max(at_low, at_high));
  }
  return exit - enter > kPoint;
}

}  // namespace

OctreeCut cut_octree(const OctreeSummary& summary, std::uint32_t depth) {
  CHECK(depth <= kSummaryDepthMax);
  OctreeCut cut{.depth = depth};
  cut.below.resize(summary.nodes.size());
  if (summary.nodes.empty()) { return cut; }
  // Octant 0 first. A node comes a second time, behind all that lies below it.
  struct Visit {
    std::uint32_t node = 0;
    bool is_left = false;
  };
  std::vector<Visit> waiting{{0, false}};
  while (!waiting.empty()) {
    const Visit visit = waiting.back();
    waiting.pop_back();
    const SummaryNode& node = summary.nodes[visit.node];
    const auto cells = static_cast<std::uint32_t>(cut.cells.size());
    if (visit.is_left) {
      cut.below[visit.node].end = cells;
      continue;
    }
    cut.below[visit.node].begin = cells;
    if (is_cut(node, depth)) {
      cut.cells.push_back({node.cell, node.depth, visit.node});
      cut.below[visit.node].end = cells + 1;
      continue;
    }
    waiting.push_back({visit.node, true});
    for (unsigned octant = kChildren; octant-- > 0;) {
      if (const std::uint32_t child = child_in(node, octant); child != 0) {
        waiting.push_back({child, false});
      }
    }
  }
  for (std::uint32_t index = 0; index < summary.nodes.size(); ++index) {  // parents come first
    const SummaryNode& node = summary.nodes[index];
    if (node.depth < depth || node.first_child == 0) { continue; }
    const auto children = static_cast<std::uint32_t>(std::popcount(node.child_mask));
    for (std::uint32_t child = 0; child < children; ++child) {
      cut.below[node.first_child + child] = cut.below[index];
    }
  }
  return cut;
}

CutRange cut_cells_of(const OctreeSummary& summary, const OctreeCut& cut, const Aabb& octree_cell) {
  if (summary.nodes.empty()) { return {}; }
  const Vec3 centre = 0.5F * (octree_cell.low + octree_cell.high);
  const float size = octree_cell.high.x - octree_cell.low.x;
  std::uint32_t at = 0;
  for (;;) {
    const SummaryNode& node = summary.nodes[at];
    // Sizes of different levels differ by two, so that half a level apart is unmistakable.
    const bool is_reached = node.cell.high.x - node.cell.low.x < 1.5F * size;
    if (is_cut(node, cut.depth) || is_reached) { return cut.below[at]; }
    const Vec3 split = child_cell(node.cell, 7).low;
    const unsigned octant = static_cast<unsigned>(centre.x > split.x) |
                            static_cast<unsigned>(centre.y > split.y) << 1U |
                            static_cast<unsigned>(centre.z > split.z) << 2U;
    at = child_in(node, octant);
    if (at == 0) { return {}; }
  }
}

std::uint32_t cells_crossed(const OctreeSummary& summary, std::uint32_t depth, const Vec3d& from,
                            const Vec3d& to) {
  const Vec3d step = to - from;
  if (summary.nodes.empty()) { return crosses(from, step, summary.root) ? 1 : 0; }
  if (!crosses(from, step, summary.nodes[0].cell)) { return 0; }
  std::uint32_t count = 0;
  std::array<std::uint32_t, kChildren*(kSummaryDepthMax + 1)> waiting{};
  std::size_t waiting_count = 1;
  while (waiting_count > 0) {
    const SummaryNode& node = summary.nodes[waiting[--waiting_count]];
    if (is_cut(node, depth)) {
      ++count;
      continue;
    }
    for (unsigned octant = 0; octant < kChildren; ++octant) {
      if (!crosses(from, step, child_cell(node.cell, octant))) { continue; }
      const std::uint32_t child = child_in(node, octant);
      if (child == 0) {
        ++count;
      } else {
        waiting[waiting_count++] = child;
      }
    }
  }
  return count;
}

std::vector<double> spread_over_voxels(const OctreeSummary& summary, const OctreeCut& cut,
                                       std::span<const double> cell_rays,
                                       std::span<const Aabb> voxel_cells,
                                       std::span<const VoxelEntry> voxels) {
  CHECK(cell_rays.size() == cut.cells.size() && voxel_cells.size() == voxels.size());
  std::vector<double> rays(voxels.size(), 0.0);
  for (std::size_t voxel = 0; voxel < voxels.size(); ++voxel) {
    const CutRange range = cut_cells_of(summary, cut, voxel_cells[voxel]);
    double surface = 0.0;
    double sum = 0.0;
    double busiest = 0.0;
    for (std::uint32_t cell = range.begin; cell < range.end; ++cell) {
      surface += surface_of(cut.cells[cell].cell);
      sum += cell_rays[cell];
      busiest = std::max(busiest, cell_rays[cell]);
    }
    if (range.begin == range.end) { continue; }
    const double share = std::min(1.0, surface_of(voxels[voxel].bounds) / surface);
    const bool holds_several = range.end - range.begin > 1;
    rays[voxel] = holds_several ? std::max(busiest, share * sum) : share * sum;
  }
  return rays;
}

}  // namespace preheat
