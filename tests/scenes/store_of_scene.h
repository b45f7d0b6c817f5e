// A scene compiled into a store on disk, for tests that need one below the compiler.
#pragma once

#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <vector>

#include "common/content_hash.h"
#include "common/octree_summary.h"
#include "common/proxy.h"
#include "common/store.h"
#include "common/store_writer.h"
#include "common/voxel_block.h"

namespace preheat::test {

// Voxels are the highest octree nodes of at most so many references; their bounds are their cells.
inline Result<Store> store_of_scene(const Scene& scene, std::uint32_t voxel_references_max,
                                    const std::filesystem::path& file,
                                    const OctreeLimits& limits = {}) {
  Result<StoreWriter> writer = StoreWriter::create(file);
  if (!writer) { return tl::unexpected(writer.error()); }
  const Octree octree = build_octree(scene, limits);
  SceneTables tables;
  tables.frame = scene.frame;
  tables.triangle_count = scene.triangles.size();
  tables.materials = scene.materials;
  tables.lights = scene.lights;
  for (std::uint32_t id = 0; id < scene.triangles.size(); ++id) {
    const Triangle& triangle = scene.triangles[id];
    if (scene.materials[triangle.material].emission == Vec3(0.0F)) { continue; }
    tables.emissive_triangles.push_back(
        {id,
         triangle.material,
         {scene.positions[triangle.vertices[0]], scene.positions[triangle.vertices[1]],
          scene.positions[triangle.vertices[2]]}});
  }
  struct Pending {
    std::uint32_t node = 0;
    Aabb cell{};
  };
  std::vector<std::uint32_t> roots;
  std::vector<Pending> pending{{0, octree.root}};
  while (!pending.empty()) {
    const Pending at = pending.back();
    pending.pop_back();
    const OctreeNode& node = octree.nodes[at.node];
    if (node.references_count == 0) { continue; }
    if (node.first_child != 0 && node.references_count > voxel_references_max) {
      for (unsigned octant = 8; octant-- > 0;) {
        pending.push_back({node.first_child + octant, child_cell(at.cell, octant)});
      }
      continue;
    }
    const auto begin =
        octree.references.begin() + static_cast<std::ptrdiff_t>(node.references_begin);
    std::vector<std::uint32_t> ids(begin, begin + node.references_count);
    std::sort(ids.begin(), ids.end());
    ids.erase(std::unique(ids.begin(), ids.end()), ids.end());
    const std::vector<std::byte> block = encode_voxel_block(scene, ids);
    VoxelEntry entry;
    entry.bounds = grown_cell(at.cell);
    entry.block_offset = writer->blocks_bytes();
    entry.block_bytes = static_cast<std::uint32_t>(block.size());
    entry.triangle_count = static_cast<std::uint32_t>(ids.size());
    entry.resident_bytes = block.size() + bvh_bytes_bound(ids.size());
    entry.hash = content_hash(block);
    if (Result<void> written = writer->append_block(block); !written) {
      return tl::unexpected(written.error());
    }
    roots.push_back(at.node);
    tables.voxels.push_back(entry);
  }
  if (!roots.empty()) {  // one level is enough for what prediction reads
    Aabb all;
    for (const VoxelEntry& voxel : tables.voxels) { all.extend(voxel.bounds); }
    tables.voxel_nodes.push_back({all, 1, static_cast<std::uint32_t>(roots.size())});
    for (std::uint32_t voxel = 0; voxel < roots.size(); ++voxel) {
      tables.voxel_nodes.push_back({tables.voxels[voxel].bounds, voxel, 0});
    }
  }
  StoreInfo info;
  info.source_file = "scene";
  Result<void> finished =
      writer->finish(info, tables, scene.cameras, build_proxy(scene, octree, roots),
                     build_octree_summary(scene, octree));
  if (!finished) { return tl::unexpected(finished.error()); }
  return Store::open(file);
}

}  // namespace preheat::test
