// A scene cut into a regular grid of voxels in memory, for tests that need blocks but no store.
#pragma once

#include <cstddef>
#include <memory>
#include <vector>

#include "common/octree.h"
#include "common/scene.h"
#include "common/scene_tables.h"
#include "common/voxel_block.h"

namespace preheat::test {

// Bytes at a 16-byte boundary, as blocks must lie.
class AlignedBytes {
 public:
  explicit AlignedBytes(const std::vector<std::byte>& bytes)
      : words_((bytes.size() + sizeof(Word) - 1) / sizeof(Word)), size_(bytes.size()) {
    std::copy(bytes.begin(), bytes.end(), reinterpret_cast<std::byte*>(words_.data()));
  }
  [[nodiscard]] std::span<const std::byte> bytes() const {
    return {reinterpret_cast<const std::byte*>(words_.data()), size_};
  }

 private:
  struct alignas(16) Word {
    std::byte bytes[16];
  };
  std::vector<Word> words_;
  std::size_t size_;
};

struct GridStore {
  SceneTables tables{};
  std::vector<std::shared_ptr<const AlignedBytes>> blocks{};  // [voxel_count]
  [[nodiscard]] VoxelBlockView view(VoxelId voxel) const {
    return view_voxel_block(blocks[index_of(voxel)]->bytes(), tables.materials.size()).value();
  }
};

// A generous bound, so that tests of the cache's bytes do not depend on Embree's version.
inline std::uint64_t bvh_bytes_of_test(std::uint64_t triangle_count) {
  return 16384 + 400 * triangle_count;
}

// cells^3 voxels over [-1,1]^3, empty ones left out.
inline GridStore cut_into_grid(const Scene& scene, int cells) {
  GridStore store;
  store.tables.triangle_count = scene.triangles.size();
  store.tables.materials = scene.materials;
  const float width = 2.0F / static_cast<float>(cells);
  std::vector<VoxelNode> leaves;
  Aabb all;
  for (int cell = 0; cell < cells * cells * cells; ++cell) {
    const Vec3 low =
        Vec3(static_cast<float>(cell % cells), static_cast<float>(cell / cells % cells),
             static_cast<float>(cell / cells / cells)) *
            width -
        1.0F;
    const Aabb grown{low - kVoxelMargin, low + width + kVoxelMargin};
    std::vector<std::uint32_t> ids;
    for (std::uint32_t id = 0; id < scene.triangles.size(); ++id) {
      const auto& v = scene.triangles[id].vertices;
      if (triangle_overlaps_box(scene.positions[v[0]], scene.positions[v[1]], scene.positions[v[2]],
                                grown)) {
        ids.push_back(id);
      }
    }
    if (ids.empty()) { continue; }
    const std::vector<std::byte> block = encode_voxel_block(scene, ids);
    const auto voxel = static_cast<std::uint32_t>(store.blocks.size());
    VoxelEntry entry;
    entry.bounds = grown;
    entry.block_bytes = static_cast<std::uint32_t>(block.size());
    entry.triangle_count = static_cast<std::uint32_t>(ids.size());
    entry.resident_bytes = block.size() + bvh_bytes_of_test(ids.size());
    store.tables.voxels.push_back(entry);
    store.blocks.push_back(std::make_shared<const AlignedBytes>(block));
    leaves.push_back({grown, voxel, 0});
    all.extend(grown);
  }
  for (std::size_t id = 0; id < scene.triangles.size(); ++id) {
    const Triangle& triangle = scene.triangles[id];
    if (scene.materials[triangle.material].emission == Vec3(0.0F)) { continue; }
    store.tables.emissive_triangles.push_back(
        {static_cast<std::uint32_t>(id),
         triangle.material,
         {scene.positions[triangle.vertices[0]], scene.positions[triangle.vertices[1]],
          scene.positions[triangle.vertices[2]]}});
  }
  if (leaves.empty()) { return store; }
  // One root over groups of eight leaves, so that walks see inner nodes.
  const auto group_count = static_cast<std::uint32_t>((leaves.size() + 7) / 8);
  store.tables.voxel_nodes.push_back({all, 1, group_count});
  for (std::uint32_t group = 0; group < group_count; ++group) {
    const std::size_t first = std::size_t{group} * 8;
    const std::size_t count = std::min<std::size_t>(8, leaves.size() - first);
    Aabb bounds;
    for (std::size_t leaf = first; leaf < first + count; ++leaf) {
      bounds.extend(leaves[leaf].bounds);
    }
    store.tables.voxel_nodes.push_back({bounds, static_cast<std::uint32_t>(1 + group_count + first),
                                        static_cast<std::uint32_t>(count)});
  }
  store.tables.voxel_nodes.insert(store.tables.voxel_nodes.end(), leaves.begin(), leaves.end());
  return store;
}

}  // namespace preheat::test
