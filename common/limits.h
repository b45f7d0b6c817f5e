// What options, frames and files may ask for at most. Checked before anything is allocated.
#pragma once

#include <cstddef>
#include <cstdint>

namespace preheat {

inline constexpr std::uint32_t kImageSideMax = 65536;
inline constexpr std::uint64_t kImagePixelsMax = std::uint64_t{1} << 31;
inline constexpr std::uint32_t kSppMax = 1U << 20;
inline constexpr std::uint32_t kBouncesMax = 64;
inline constexpr std::uint32_t kTileSizeMax = 1024;
inline constexpr std::uint64_t kTilesMax = std::uint64_t{16} << 20;
inline constexpr std::uint32_t kThreadsMax = 1024;

// Paths that a tracer thread has in flight, some 420 bytes each: by default, and at most. The more
// there are, the more rays one visit of a voxel serves.
inline constexpr std::uint32_t kPathsPerThread = 131072;
inline constexpr std::uint32_t kPathsPerThreadMin = 64;
inline constexpr std::uint32_t kPathsPerThreadMax = 1U << 22;

}  // namespace preheat
