// How a store lies in its file. Included by the writer and the reader of stores, and by their
// tests.
//
//   [0, 4096)          StoreHeader, then zeros
//   [4096, ...)        voxel blocks, one behind the other, each a multiple of 16 bytes
//   then, each from the next multiple of 16, with zeros between: facts, tables, cameras, proxy,
//                     octree summary
//
// The blocks come first so that they are written as they are made, before their hashes, which the
// tables hold, are known. All numbers are little-endian.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/bounded.h"
#include "common/scene_tables_codec.h"
#include "common/store.h"

namespace preheat {

enum class StoreSection : std::uint8_t { kBlocks = 0, kInfo, kTables, kCameras, kProxy, kOctree };

inline constexpr std::size_t kStoreSectionCount = 6;
inline constexpr std::array<const char*, kStoreSectionCount> kStoreSectionNames{
    "blocks", "info", "tables", "cameras", "proxy", "octree"};
inline constexpr std::uint64_t kStoreBlocksOffset = 4096;
inline constexpr std::uint64_t kStoreSectionAlignment = 16;
inline constexpr std::array<char, 8> kStoreMagic{'P', 'R', 'E', 'H', 'E', 'A', 'T', '\n'};

struct StorePlace {
  std::uint64_t offset = 0;
  std::uint64_t bytes = 0;
  Hash128 hash{};  // of the section's bytes; 0 for the blocks, which have hashes of their own
};

struct StoreHeader {
  std::array<char, 8> magic = kStoreMagic;
  std::uint32_t version = kStoreVersion;
  std::uint32_t section_count = kStoreSectionCount;
  std::uint64_t file_bytes = 0;
  std::array<StorePlace, kStoreSectionCount> sections{};
  Hash128 hash{};  // of all that is above
};
static_assert(sizeof(StoreHeader) == 24 + kStoreSectionCount * 32 + 16, "no padding");

[[nodiscard]] constexpr std::uint64_t next_section_offset(std::uint64_t end) {
  return (end + kStoreSectionAlignment - 1) / kStoreSectionAlignment * kStoreSectionAlignment;
}

inline constexpr std::size_t kImportNoteCountMax = 1U << 16U;
inline constexpr std::size_t kCameraCountMax = 1U << 16U;

template <class Archive>
void serialize(Archive& archive, ImportReport& report) {
  archive(report.triangles_declared, report.triangles_non_finite, report.triangles_zero_area,
          at_most(report.notes, kImportNoteCountMax, kNameBytesMax));
}

template <class Archive>
void serialize(Archive& archive, StoreInfo& info) {
  archive(at_most(info.source_file, kNameBytesMax), info.source_hash, info.import,
          info.voxel_size_bytes, info.voxels_internal, info.voxels_leaf, info.voxels_empty,
          info.level_min, info.level_max, info.depth_mean, info.blocking_mean,
          info.objects_per_leaf, info.traversal_cost);
}

template <class Archive>
void serialize(Archive& archive, Camera& camera) {
  archive(at_most(camera.name, kNameBytesMax), camera.position_file, camera.right, camera.up,
          camera.forward, camera.vertical_fov_rad, camera.orthographic, camera.height_file);
}

struct CameraSection {
  std::vector<Camera> cameras{};
};
template <class Archive>
void serialize(Archive& archive, CameraSection& section) {
  archive(at_most(section.cameras, kCameraCountMax));
}

}  // namespace preheat
