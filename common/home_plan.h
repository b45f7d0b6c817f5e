// Which worker keeps each cold voxel for the others, and how they are reached: made by the master,
// followed by the workers.
//
// A home knows its voxel's holders, and keeps the block itself where the plan found room for it. A
// plan may be old or wrong: a worker that follows it loses time, never a voxel, as the master has
// them all.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "common/messages.h"
#include "common/result.h"

namespace preheat {

struct HomePlan {
  static constexpr std::uint16_t kNoHome = UINT16_MAX;
  static constexpr std::uint16_t kKept = 0x8000;  // beside the index: the home keeps the block

  std::vector<PeerAddress> peers{};    // at most kPeersMax
  std::vector<std::uint16_t> homes{};  // [voxel_count] index into `peers` with kKept, or kNoHome

  [[nodiscard]] static std::size_t index(std::uint16_t home) { return home & ~unsigned{kKept}; }

  // nullptr: the voxel has no home.
  [[nodiscard]] const PeerAddress* home_of(VoxelId voxel) const {
    const std::size_t at = index_of(voxel);
    if (at >= homes.size() || homes[at] == kNoHome) { return nullptr; }
    return &peers[index(homes[at])];
  }
  [[nodiscard]] bool is_kept(VoxelId voxel) const {
    return home_of(voxel) != nullptr && (homes[index_of(voxel)] & kKept) != 0;
  }
};
static_assert(kPeersMax < HomePlan::kKept);

inline constexpr std::uint64_t kHomePlanBytesMax =
    16 + kPeersMax * (4 + 16 + 8 + kEndpointBytesMax) + kVoxelCountMax * sizeof(std::uint16_t);

[[nodiscard]] std::vector<std::byte> encode_home_plan(const HomePlan& plan);

// An error unless it is a plan for so many voxels whose homes are all among its peers.
[[nodiscard]] Result<HomePlan> decode_home_plan(std::span<const std::byte> bytes,
                                                std::size_t voxel_count);

}  // namespace preheat
