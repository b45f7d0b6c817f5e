// The octree over a scene's triangles, down to the fine leaves that prediction reads.
//
// Built top-down by triangle-box overlap; same result on any number of threads. A node's eight
// children are contiguous; leaves in node order are in Morton order, so the references of a
// subtree are one contiguous range of `references`.
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
  Aabb root{};  // a cube
  std::vector<OctreeNode> nodes{};           // [0] is the root
  std::vector<std::uint32_t> references{};   // global triangle ids
  std::uint32_t depth_max = 0;               // deepest leaf
};

struct OctreeLimits {
  std::uint32_t leaf_references_max = 32;
  std::uint32_t depth_max = 16;
  unsigned threads = 0;  // 0 = all cores; changes the time only
};

[[nodiscard]] Octree build_octree(const Scene& scene, const OctreeLimits& limits);

// The cell of child `octant` (bit 0: upper half in x, bit 1: y, bit 2: z).
[[nodiscard]] Aabb child_cell(const Aabb& cell, unsigned octant);

// Conservative separating-axis test (Akenine-Moeller 2001): true if the triangle and the box, grown by
// the test's own rounding, share a point.
[[nodiscard]] bool triangle_overlaps_box(const Vec3& a, const Vec3& b, const Vec3& c,
                                         const Aabb& box);

}  // namespace preheat
