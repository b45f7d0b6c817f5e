// Cuts a scene's octree into voxels: the highest nodes whose subtree's block fits the voxel size.
#pragma once

#include <cstdint>
#include <vector>

#include "common/octree.h"
#include "common/scene.h"
#include "common/scene_tables.h"

namespace preheat {

inline constexpr std::uint64_t kVoxelSizeBytesMin = std::uint64_t{4} << 10U;
inline constexpr std::uint64_t kVoxelSizeBytesDefaultMax = std::uint64_t{256} << 10U;

// The smaller of 256 KiB and 1/256 of the scene's data, but no less than 4 KiB.
[[nodiscard]] std::uint64_t default_voxel_size(const Scene& scene);

struct VoxelCut {
  std::vector<std::uint32_t> roots{};  // [voxel_count] octree nodes, in Morton order
  std::vector<Aabb> cells{};           // [voxel_count]
  // The octree above the voxels without empty nodes and only children, breadth-first; bounds empty.
  std::vector<VoxelNode> nodes{};
};

// Nodes without references become no voxel. A leaf that is larger than the size, which happens
// where many triangles coincide, is a voxel as it is.
[[nodiscard]] VoxelCut cut_into_voxels(const Scene& scene, const Octree& octree,
                                       std::uint64_t voxel_size_bytes);

// The extent of what of these triangles lies in the cell, both grown by kVoxelMargin. Each triangle
// must overlap the grown cell.
[[nodiscard]] Aabb voxel_bounds(const Scene& scene, const std::vector<std::uint32_t>& triangle_ids,
                                const Aabb& cell);

// Fills the nodes' bounds from those of the voxels.
void set_node_bounds(std::vector<VoxelNode>& nodes, const std::vector<VoxelEntry>& voxels);

}  // namespace preheat
