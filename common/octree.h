// The octree over a scene's triangles, down to the fine leaves that prediction reads.
//
// Built top-down by triangle-box overlap; same result on any number of threads. A node's eight
// children are contiguous and lie behind their parent. References are in Morton order of the leaves
// (the order of a depth-first walk, octant 0 first) and ascend within a leaf, so those of a subtree
// are one contiguous range of `references`.
//
// A triangle is referenced by every leaf whose cell, grown by kVoxelMargin, it overlaps: a point
// computed with rounding on a triangle always lies in a cell that references it.
#pragma once

#include <cstdint>
#include <vector>

#include "common/aabb.h"
#include "common/scene.h"

namespace preheat {

struct OctreeNode {
  std::uint32_t first_child = 0;       // 0 = leaf
  std::uint32_t references_count = 0;  // of the whole subtree
  std::uint64_t references_begin = 0;  // into Octree::references
};

struct Octree {
  Aabb root{};                              // a cube
  std::vector<OctreeNode> nodes{};          // [0] is the root
  std::vector<std::uint32_t> references{};  // global triangle ids
  std::uint32_t depth_max = 0;              // deepest leaf
};

// References never exceed this many times the triangles, whatever the scene: every split multiplies
// a path's growth by (references of the children) / (references of the node), and a split that
// would take the growth past this limit is not made. Dividing each leaf's references by its path's
// growth and summing gives the number of triangles, hence the bound.
inline constexpr double kReferenceGrowthMax = 8.0;

// A split whose children hold more than this many times their parent's references makes a ray test
// more triangles, not fewer: a child's surface is a quarter of its parent's.
inline constexpr double kSplitGrowthMax = 4.0;

inline constexpr std::uint32_t kOctreeDepthMax = 20;

// A node becomes a leaf when it has no more than leaf_references_max references, lies depth_max
// deep, is smaller than four times kVoxelMargin, or when one of the two growth limits above forbids
// to split it. Without a bound of their own, identical triangles would be split until depth_max.
struct OctreeLimits {
  std::uint32_t leaf_references_max = 32;
  std::uint32_t depth_max = 16;  // <= kOctreeDepthMax
  unsigned threads = 0;          // 0 = all cores; changes the time only
};

[[nodiscard]] Octree build_octree(const Scene& scene, const OctreeLimits& limits);

// The triangles that a subtree references, ascending, each once.
[[nodiscard]] std::vector<std::uint32_t> triangles_below(const Octree& octree, std::uint32_t node);

// The cell of child `octant` (bit 0: upper half in x, bit 1: y, bit 2: z).
[[nodiscard]] Aabb child_cell(const Aabb& cell, unsigned octant);

// The cell grown by kVoxelMargin on every side: what overlap is tested against.
[[nodiscard]] Aabb grown_cell(const Aabb& cell);

// Conservative separating-axis test (Akenine-Moeller 2001): true if the triangle and the box, grown
// by the test's own rounding, share a point.
[[nodiscard]] bool triangle_overlaps_box(const Vec3& a, const Vec3& b, const Vec3& c,
                                         const Aabb& box);

}  // namespace preheat
