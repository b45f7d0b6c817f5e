// A recorded trace driven through a worker's cache: what a policy would fetch, and what no policy
// can avoid.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
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

// A worker's cache, visited step by step; what it asks for is there at once.
class ReplayedCache {
 public:
  // Voxels of `is_hot` take no part; `limit_bytes` is what the others share. The first two
  // arguments outlive this.
  ReplayedCache(const std::vector<VoxelCache::Size>& voxels, const std::vector<bool>& is_hot,
                std::uint64_t limit_bytes, std::unique_ptr<EvictionPolicy> policy);

  // Rays use what is built, then wait for the rest, which come by the order of the cache. A step is
  // a period.
  void visit(std::span<const TraceAccess> step);

  // Of the last step, in order.
  [[nodiscard]] const std::vector<VoxelId>& fetched() const { return fetched_; }
  [[nodiscard]] const std::vector<VoxelId>& built() const { return built_; }

  [[nodiscard]] ReplayResult result() const;

 private:
  void carry_out(const VoxelCache::Command& command);

  const std::vector<VoxelCache::Size>& voxels_;
  const std::vector<bool>& is_hot_;
  VoxelCache cache_;
  std::vector<std::uint64_t> waiting_;  // rays, [voxel_count]
  std::size_t waiting_count_ = 0;       // voxels with such
  std::vector<VoxelId> fetched_;
  std::vector<VoxelId> built_;
  std::uint64_t accesses_ = 0;
  std::uint64_t hits_ = 0;
};

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
