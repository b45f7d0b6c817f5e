// The upper part of the fine octree, with what [P] section 2 says of the subtree below each node.
//
// A store keeps it so that the paper's model, which stops at a depth ([P] section 7), finds its
// cells and their traversal costs without the octree, which is not kept. Nodes down to
// kSummaryDepthMax that hold triangles; a node is an octree leaf, or has its non-empty children, or
// lies at that depth and stands for the subtree below. Cells follow from the root's by child_cell,
// to the bit. Same result on any number of threads.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "common/aabb.h"
#include "common/octree.h"
#include "common/result.h"
#include "common/scene.h"
#include "common/scene_tables.h"

namespace preheat {

inline constexpr std::uint32_t kSummaryDepthMax = 5;
inline constexpr std::size_t kSummaryNodesMax = 37449;  // 1 + 8 + ... + 8^5

// Sums over the leaves of a subtree, from which the averages of [P] section 2 follow. Depths count
// from the subtree's root; the sum of 8^-h over the leaves, empty ones included, is always 1. As it
// stands: a single empty leaf.
struct OctreeSums {
  std::uint32_t leaves_filled = 0;
  std::uint32_t leaves_empty = 1;
  std::uint32_t references = 0;  // (leaf, triangle) pairs
  std::uint32_t level_min = 0;   // of leaves, empty or not
  std::uint32_t level_max = 0;
  double surface = 1.0;        // sum of 4^-h
  double surface_depth = 0.0;  // sum of h 4^-h
  double blocking = 0.0;       // sum of p_i 8^-h

  [[nodiscard]] double depth_mean() const { return surface_depth / surface; }  // D-bar
  [[nodiscard]] double blocking_mean() const { return blocking; }              // p-bar
  [[nodiscard]] double objects_per_leaf() const {                              // m-bar
    return references / (static_cast<double>(leaves_filled) + static_cast<double>(leaves_empty));
  }
  // C_t: leaves of the subtree that a ray traverses which enters it.
  [[nodiscard]] double traversal_cost() const;
  // The probability that the subtree stops such a ray: 1 - (1 - p-bar)^(2^D-bar).
  [[nodiscard]] double stop_probability() const;

  friend bool operator==(const OctreeSums&, const OctreeSums&) = default;
};

struct SummaryNode {
  Aabb cell{};
  std::uint32_t depth = 0;
  std::uint32_t first_child = 0;  // into OctreeSummary::nodes; 0 = none are kept
  std::uint8_t child_mask = 0;    // bit i: octant i holds triangles; 0 = an octree leaf. The kept
                                  // children follow one another in that order
  OctreeSums sums{};
};

struct OctreeSummary {
  Aabb root{};                       // the octree's cell
  std::vector<SummaryNode> nodes{};  // breadth first, [0] is the root; empty for an empty octree

  // Of the whole octree.
  [[nodiscard]] OctreeSums sums() const { return nodes.empty() ? OctreeSums{} : nodes[0].sums; }
};

[[nodiscard]] OctreeSummary build_octree_summary(const Scene& scene, const Octree& octree);

[[nodiscard]] std::vector<std::byte> encode_octree_summary(const OctreeSummary& summary);

// Every count, mask, cell and sum is checked.
[[nodiscard]] Result<OctreeSummary> decode_octree_summary(std::span<const std::byte> bytes);

// ---- the octree cut at a depth ----

struct CutCell {
  Aabb cell{};
  std::uint32_t depth = 0;  // at most the cut's; less for an octree leaf
  std::uint32_t node = 0;   // into OctreeSummary::nodes
};

struct CutRange {
  std::uint32_t begin = 0;  // into OctreeCut::cells
  std::uint32_t end = 0;
  friend bool operator==(const CutRange&, const CutRange&) = default;
};

// The leaf voxels of [P] section 7: leaves above the cut's depth, and the nodes at it, each with
// the whole subtree below. Only those that hold triangles, in Morton order, which is the order of
// the arrays of a NodePrediction.
struct OctreeCut {
  std::uint32_t depth = 0;
  std::vector<CutCell> cells{};
  std::vector<CutRange> below{};  // [summary nodes]; of a node below the cut: the cell it lies in
};

// Requires: depth <= kSummaryDepthMax.
[[nodiscard]] OctreeCut cut_octree(const OctreeSummary& summary, std::uint32_t depth);

// The cut cells that an octree cell, such as a voxel's or a fine leaf's, shares space with: the one
// it lies in, or all that lie in it. Empty where it holds no triangle.
[[nodiscard]] CutRange cut_cells_of(const OctreeSummary& summary, const OctreeCut& cut,
                                    const Aabb& octree_cell);

// How many cells of the cut octree, empty ones included, the segment crosses for more than a point.
[[nodiscard]] std::uint32_t cells_crossed(const OctreeSummary& summary, std::uint32_t depth,
                                          const Vec3d& from, const Vec3d& to);

// Rays per cut cell as rays per voxel, a ray counting once in each voxel that it enters. Of the
// rays that cross a convex body, the share that meets a convex part of it is, over all lines alike,
// the ratio of their surfaces (Crofton). So a voxel inside a cut cell receives the cell's rays
// times the surface of the voxel's bounds over the cell's; a voxel that holds several cut cells
// sums them, less what they share by the same ratio, but sees no fewer than the busiest of them.
// `cell_rays` [cut cells], `voxel_cells` [voxel_count] the voxels' octree cells (Proxy::cells).
[[nodiscard]] std::vector<double> spread_over_voxels(const OctreeSummary& summary,
                                                     const OctreeCut& cut,
                                                     std::span<const double> cell_rays,
                                                     std::span<const Aabb> voxel_cells,
                                                     std::span<const VoxelEntry> voxels);

}  // namespace preheat
