// A recorded trace driven through a worker's cache: what a policy would fetch, and what no policy
// can avoid.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "cache/eviction_policy.h"
#include "cache/voxel_cache.h"
#include "tests/bench/access_trace.h"

namespace preheat {

// One step's voxels may be visited in any order; a step follows the one before.
using ReplaySteps = std::vector<std::vector<TraceAccess>>;

struct ReplayResult {
  std::uint64_t accesses = 0;  // rays entering voxels, hot ones included
  std::uint64_t hits = 0;      // of these, where the voxel was hot or built
  VoxelCache::Counts counts{};

  [[nodiscard]] double hit_rate() const {
    return accesses == 0 ? 1.0 : static_cast<double>(hits) / static_cast<double>(accesses);
  }
};

// Rays of a step use what is built, then wait for the rest, which come by the order of the cache.
// Voxels of `is_hot` take no part; `limit_bytes` is what the others share. A step is a period.
[[nodiscard]] ReplayResult replay(const ReplaySteps& steps,
                                  const std::vector<VoxelCache::Size>& voxels,
                                  const std::vector<bool>& is_hot, std::uint64_t limit_bytes,
                                  std::unique_ptr<EvictionPolicy> policy);

// Steps in which a voxel is used, counted from 1, as Belady's policy wants them.
[[nodiscard]] std::vector<std::vector<std::uint32_t>> steps_of_use(const ReplaySteps& steps,
                                                                   std::size_t voxel_count);

// Bytes of blocks that every cache of `limit_bytes` fetches at least, whatever its policy. It is
// the optimum of a cache that may give up single bytes, holds no BVHs and needs no room for the
// voxels of the step that runs: of all that was held it keeps, after each step, the bytes that are
// used again soonest. There a byte is a page, all pages are alike, and Belady's choice is optimal.
[[nodiscard]] std::uint64_t fetched_bytes_bound(const ReplaySteps& steps,
                                                const std::vector<VoxelCache::Size>& voxels,
                                                const std::vector<bool>& is_hot,
                                                std::uint64_t limit_bytes);

}  // namespace preheat
