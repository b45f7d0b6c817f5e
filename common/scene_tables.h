// What every worker knows of a scene before it holds a single voxel: the store's small tables.
//
// The same value is a section of the store and the first thing that a worker fetches.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "common/aabb.h"
#include "common/ids.h"
#include "common/scene.h"

namespace preheat {

// XXH3, 128 bits: the name of a block's content.
struct Hash128 {
  std::uint64_t low = 0;
  std::uint64_t high = 0;
  friend bool operator==(const Hash128&, const Hash128&) = default;
};

// One triangle that emits. Sorted by `triangle` in SceneTables, so that a hit finds its light.
struct EmissiveTriangle {
  std::uint32_t triangle = 0;  // global triangle id
  std::uint32_t material = 0;
  std::array<Vec3, 3> vertices{};  // scene frame
};

// One non-empty voxel. VoxelId is its index; ids follow the octree's Morton order, so neighbours in
// space are near in id.
struct VoxelEntry {
  // The triangles' extent inside the octree node, both grown by kVoxelMargin.
  Aabb bounds{};
  std::uint64_t block_offset = 0;  // in the store's block section [bytes]
  std::uint32_t block_bytes = 0;   // held raw
  std::uint32_t triangle_count = 0;
  std::uint64_t resident_bytes = 0;  // held built: the block and an upper bound of its BVH
  Hash128 hash{};                    // of the block's bytes

  // An upper bound of what the voxel adds to a hot set, whose one BVH has kBvhBytesFixed only once.
  [[nodiscard]] std::uint64_t hot_bytes() const;
};

// Voxel bounds are grown by 2^-20 scene units, some eight times the rounding of a coordinate of
// magnitude 1, so that a hit computed with rounding never lies outside the voxel that holds it.
inline constexpr float kVoxelMargin = 9.5367431640625e-07F;

// A node of the octree above the voxels, for walking a ray through the voxels' bounds in order.
struct VoxelNode {
  Aabb bounds{};  // of all voxels below
  // Inner node: index of the first of `count` children in SceneTables::voxel_nodes. Leaf: VoxelId.
  std::uint32_t first = 0;
  std::uint32_t count = 0;  // 0 = leaf
};

struct SceneTables {
  Frame frame{};
  std::uint64_t triangle_count = 0;
  std::vector<Material> materials{};
  std::vector<PunctualLight> lights{};
  std::vector<EmissiveTriangle> emissive_triangles{};
  std::vector<VoxelEntry> voxels{};
  std::vector<VoxelNode> voxel_nodes{};  // [0] is the root; empty for an empty scene

  // Every voxel built: what 100 % of a cache means.
  [[nodiscard]] std::uint64_t resident_bytes() const;
  // The least cache that renders: the largest voxel, built.
  [[nodiscard]] std::uint64_t resident_bytes_min() const;
};

// What the scene calls for; a stage, ray type or term exists only where its feature is set.
struct Features {
  bool emitters = false;      // emissive triangles
  bool point_lights = false;  // point, spot or directional
  bool environment = false;   // a sky, known when a render starts
  bool diffuse = false;
  bool specular = false;  // metals and dielectric coats
  bool transmission = false;
  bool rough_transmission = false;
  [[nodiscard]] std::vector<std::string> modelled() const;
  [[nodiscard]] std::vector<std::string> left_out() const;
};

[[nodiscard]] Features detect_features(const SceneTables& tables);

}  // namespace preheat
