// The compiled scene on disk: header with section table, voxel blocks, facts, scene tables,
// cameras, proxy, octree summary. The exact layout is in store_format.h, the writer in
// store_writer.h.
//
// Written once to a temporary name, synced and renamed. Read by mapping: opening checks magic,
// version, every section's place and the tables' hashes, never the blocks, which each carry a hash
// of their own in the directory and are checked by whoever receives them. Little-endian. Threads: a
// Store is immutable; any thread may read it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "common/octree_summary.h"
#include "common/proxy.h"
#include "common/result.h"
#include "common/scene.h"
#include "common/scene_tables.h"

namespace preheat {

inline constexpr std::uint32_t kStoreVersion = 5;

// Facts about how the store was made, for inspect and the report.
struct StoreInfo {
  std::string source_file{};
  Hash128 source_hash{};
  ImportReport import{};
  std::uint64_t voxel_size_bytes = 0;  // the limit that voxels were cut to
  // [P] Table 1 and section 2, over the fine octree.
  std::uint64_t voxels_internal = 0;
  std::uint64_t voxels_leaf = 0;  // non-empty leaves
  std::uint64_t voxels_empty = 0;
  std::uint32_t level_min = 0;
  std::uint32_t level_max = 0;
  double depth_mean = 0.0;        // D-bar, weighted by surface area
  double blocking_mean = 0.0;     // p-bar
  double objects_per_leaf = 0.0;  // m-bar
  double traversal_cost = 0.0;    // C_t
};

class Store {
 public:
  // Missing, truncated, foreign, damaged or of another version: kStoreDamaged, with file and
  // offset.
  [[nodiscard]] static Result<Store> open(const std::filesystem::path& file);

  [[nodiscard]] const SceneTables& tables() const;
  [[nodiscard]] const std::vector<Camera>& cameras() const;
  [[nodiscard]] const Proxy& proxy() const;
  [[nodiscard]] const OctreeSummary& octree_summary() const;
  [[nodiscard]] const StoreInfo& info() const;

  // The encoded scene tables, as sent to workers.
  [[nodiscard]] std::span<const std::byte> tables_bytes() const;
  // A voxel's block in the mapping, 16-byte aligned. Not verified here.
  [[nodiscard]] std::span<const std::byte> block(VoxelId voxel) const;
  // False if the block is not what the directory says: the disk or the file has failed.
  [[nodiscard]] bool block_is_intact(VoxelId voxel) const;
  [[nodiscard]] std::uint64_t proxy_bytes() const;
  [[nodiscard]] std::uint64_t file_bytes() const;
  // Bytes of each section, named, in file order; they and the padding between make up the file.
  [[nodiscard]] std::vector<std::pair<std::string, std::uint64_t>> section_bytes() const;
  // Of everything that the image depends on: tables and block hashes.
  [[nodiscard]] Hash128 scene_hash() const;

 private:
  struct Content;
  std::shared_ptr<const Content> content_;
};

}  // namespace preheat
