// The order of a voxel's triangles in its block: such that a tree whose leaves are runs of it is a
// good one, so that whoever builds a tree over the block needs neither to sort nor to keep lists.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/scene.h"

namespace preheat {

// Triangles in a leaf of such a tree, and in a node whose children are leaves.
inline constexpr std::size_t kTrianglesPerLeaf = 4;
inline constexpr std::size_t kTrianglesPerLeafNode = 8 * kTrianglesPerLeaf;

// The given triangles in depth-first order of a binary tree that is cut, level by level, at the
// triangle along the axis where the sum of surface area times triangles is least (MacDonald and
// Booth, The Visual Computer 6, 1990, section 3), in whole leaves and at least an eighth of the
// triangles on either side. Depends on nothing but the triangles; equal ones keep their order.
[[nodiscard]] std::vector<std::uint32_t> order_for_tree(const Scene& scene,
                                                        std::span<const std::uint32_t> triangles);

}  // namespace preheat
