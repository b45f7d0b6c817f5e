// Strong names for the numbers that travel between processes.
#pragma once

#include <cstdint>
#include <type_traits>

namespace preheat {

enum class VoxelId : std::uint32_t {};   // index into SceneTables::voxels
enum class TileId : std::uint32_t {};    // row-major tile number of an image
enum class WorkerId : std::uint32_t {};  // given by the master, counted from 0
enum class LeaseId : std::uint64_t {};   // random, single use

inline constexpr WorkerId kNoWorker{UINT32_MAX};

template <class Id>
[[nodiscard]] constexpr auto index_of(Id id) {
  return static_cast<std::underlying_type_t<Id>>(id);
}

}  // namespace preheat
