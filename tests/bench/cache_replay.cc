#include "tests/bench/cache_replay.h"

#include <algorithm>
#include <iterator>
#include <set>
#include <utility>

#include "common/check.h"

namespace preheat {
ReplayedCache::ReplayedCache(const std::vector<VoxelCache::Size>& voxels,
                             const std::vector<bool>& is_hot, std::uint64_t limit_bytes,
                             std::unique_ptr<EvictionPolicy> policy)
    : voxels_(voxels),
      is_hot_(is_hot),
      cache_(voxels, limit_bytes, std::move(policy)),
      waiting_(voxels.size()) {}

void ReplayedCache::visit(std::span<const TraceAccess> step) {
  fetched_.clear();
  built_.clear();
  cache_.begin_period();
  for (const TraceAccess& access : step) {
    accesses_ += access.rays;
    if (is_hot_[index_of(access.voxel)]) {
      hits_ += access.rays;
    } else if (cache_.is_built(access.voxel)) {
      hits_ += access.rays;
      cache_.used(access.voxel, access.rays);
    } else {
      cache_.add_waiting(access.voxel, access.rays);
      waiting_[index_of(access.voxel)] = access.rays;
      ++waiting_count_;
    }
  }
  while (waiting_count_ > 0) {
    const std::vector<VoxelCache::Command> commands = cache_.step();
    CHECK(!commands.empty());
    for (const VoxelCache::Command& command : commands) { carry_out(command); }
  }
}

void ReplayedCache::carry_out(const VoxelCache::Command& command) {
  switch (command.action) {
    case VoxelCache::Action::kFetch:
      fetched_.push_back(command.voxel);
      CHECK(cache_.block_arrived(command.voxel));
      break;
    case VoxelCache::Action::kBuild: {
      built_.push_back(command.voxel);
      cache_.built(command.voxel, voxels_[index_of(command.voxel)].bvh_bytes_max);
      const std::uint64_t rays = std::exchange(waiting_[index_of(command.voxel)], 0U);
      cache_.served(command.voxel, rays);
      cache_.used(command.voxel, rays);
      --waiting_count_;
      break;
    }
    case VoxelCache::Action::kWithdraw:
      cache_.withdrawn(command.voxel);
      break;
    case VoxelCache::Action::kDropBlock:
      break;
  }
}

ReplayResult ReplayedCache::result() const { return {accesses_, hits_, cache_.counts()}; }

ReplayResult replay(const ReplaySteps& steps, const std::vector<VoxelCache::Size>& voxels,
                    const std::vector<bool>& is_hot, std::uint64_t limit_bytes,
                    std::unique_ptr<EvictionPolicy> policy) {
  ReplayedCache cache(voxels, is_hot, limit_bytes, std::move(policy));
  for (const std::vector<TraceAccess>& step : steps) { cache.visit(step); }
  return cache.result();
}

std::vector<std::vector<std::uint32_t>> steps_of_use(const ReplaySteps& steps,
                                                     std::size_t voxel_count) {
  std::vector<std::vector<std::uint32_t>> uses(voxel_count);
  for (std::size_t step = 0; step < steps.size(); ++step) {
    for (const TraceAccess& access : steps[step]) {
      uses[index_of(access.voxel)].push_back(static_cast<std::uint32_t>(step + 1));
    }
  }
  return uses;
}

std::uint64_t fetched_bytes_bound(const ReplaySteps& steps,
                                  const std::vector<VoxelCache::Size>& voxels,
                                  const std::vector<bool>& is_hot, std::uint64_t limit_bytes) {
  const auto uses = steps_of_use(steps, voxels.size());
  std::vector<std::size_t> next(voxels.size());
  std::vector<std::uint64_t> held(voxels.size());  // bytes
  std::set<std::pair<std::uint32_t, VoxelId>> by_next_use;
  std::uint64_t held_bytes = 0;
  std::uint64_t fetched = 0;
  for (std::size_t step = 0; step < steps.size(); ++step) {
    for (const TraceAccess& access : steps[step]) {
      const std::uint32_t voxel = index_of(access.voxel);
      if (is_hot[voxel]) { continue; }
      fetched += voxels[voxel].block_bytes - held[voxel];
      held_bytes += voxels[voxel].block_bytes - held[voxel];
      held[voxel] = voxels[voxel].block_bytes;
      by_next_use.erase({static_cast<std::uint32_t>(step + 1), access.voxel});
      const bool ends = ++next[voxel] == uses[voxel].size();
      by_next_use.emplace(ends ? UINT32_MAX : uses[voxel][next[voxel]], access.voxel);
    }
    while (held_bytes > limit_bytes) {
      const auto farthest = std::prev(by_next_use.end());
      std::uint64_t& bytes = held[index_of(farthest->second)];
      const std::uint64_t given_up = std::min(bytes, held_bytes - limit_bytes);
      bytes -= given_up;
      held_bytes -= given_up;
      if (bytes == 0) { by_next_use.erase(farthest); }
    }
  }
  return fetched;
}

}  // namespace preheat
