// SceneTables as bytes: a section of the store and the first thing that a worker fetches.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "common/result.h"
#include "common/scene_tables.h"
#include "common/voxel_block.h"

namespace preheat {

// Limits that both sides know; a scene beyond them is rejected when it is compiled.
inline constexpr std::uint64_t kVoxelBytesMax = std::uint64_t{64} << 20U;
inline constexpr std::size_t kVoxelCountMax = std::size_t{1} << 24U;
inline constexpr std::size_t kLightCountMax = std::size_t{1} << 20U;
inline constexpr std::uint64_t kTriangleCountMax = std::uint64_t{1} << 31U;
inline constexpr std::size_t kNameBytesMax = 4096;

// Requires: tables that validate_scene_tables accepts.
[[nodiscard]] std::vector<std::byte> encode_scene_tables(const SceneTables& tables);

// Decodes and validates; no bytes may be left over.
[[nodiscard]] Result<SceneTables> decode_scene_tables(std::span<const std::byte> bytes);

// Everything that a reader relies on: limits, indices in range, sorted ids, blocks that do not
// overlap, material values in their ranges, voxel_nodes a tree whose children lie behind their
// parent and inside its bounds and whose leaves are all voxels, each once.
[[nodiscard]] Result<void> validate_scene_tables(const SceneTables& tables);

}  // namespace preheat
