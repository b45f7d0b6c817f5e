#include "tests/bench/cache_replay.h"

#include <gtest/gtest.h>

#include <iostream>
#include <random>

#include "tests/bench/belady_policy.h"

namespace preheat {
namespace {

ReplaySteps one_voxel_steps(const std::vector<std::uint32_t>& voxels) {
  ReplaySteps steps;
  for (const std::uint32_t voxel : voxels) { steps.push_back({{VoxelId{voxel}, 10}}); }
  return steps;
}

std::unique_ptr<EvictionPolicy> make_policy(Eviction eviction,
                                            const std::vector<VoxelCache::Size>& voxels) {
  EvictionInput input;
  for (const VoxelCache::Size& voxel : voxels) {
    input.bytes.push_back(voxel.block_bytes);
    input.chance_expected.push_back(0.5);
  }
  return make_eviction_policy(eviction, std::move(input));
}

TEST(CacheReplay, CountsFetchesRebuildsAndHits) {
  const std::vector<VoxelCache::Size> voxels(3, {40, 100});
  const ReplaySteps steps = one_voxel_steps({0, 0, 1, 0, 2});

  // Room for one built voxel and another's block: 1 drives out 0's BVH, 0 comes back built anew.
  const ReplayResult result =
      replay(steps, voxels, std::vector<bool>(3), 180, make_policy(Eviction::kLru, voxels));

  EXPECT_EQ(result.accesses, 50U);
  EXPECT_EQ(result.hits, 10U);
  EXPECT_EQ(result.counts.fetches, 3U);
  EXPECT_EQ(result.counts.fetched_bytes, 120U);
  EXPECT_EQ(result.counts.rebuilds, 1U);
}

TEST(CacheReplay, LeavesHotVoxelsOut) {
  const std::vector<VoxelCache::Size> voxels(2, {40, 100});
  const ReplaySteps steps = one_voxel_steps({0, 1, 0, 1});

  const ReplayResult result =
      replay(steps, voxels, {true, false}, 140, make_policy(Eviction::kLru, voxels));

  EXPECT_EQ(result.counts.fetches, 1U);
  EXPECT_EQ(result.hits, 30U);
}

TEST(FetchedBytesBound, KeepsThePartThatIsUsedSoonest) {
  const std::vector<VoxelCache::Size> voxels{{40, 0}, {40, 0}, {40, 0}};
  const ReplaySteps steps = one_voxel_steps({0, 1, 2, 0, 1});

  // All of it fits: each once.
  EXPECT_EQ(fetched_bytes_bound(steps, voxels, std::vector<bool>(3), 120), 120U);
  // 60 bytes: after voxel 1 half of it stays beside 0, which is used sooner; 2 is never used again.
  EXPECT_EQ(fetched_bytes_bound(steps, voxels, std::vector<bool>(3), 60), 120U + 20U);
  EXPECT_EQ(fetched_bytes_bound(steps, voxels, std::vector<bool>(3), 0), 200U);
  EXPECT_EQ(fetched_bytes_bound(steps, voxels, {false, true, false}, 0), 120U);
}

// Random steps of many voxels of different sizes: nothing beats the bound, every access is served.
TEST(FetchedBytesBound, IsNeverBeaten) {
  const unsigned seed = std::random_device{}();
  std::cout << "seed=" << seed << '\n';
  std::mt19937 random(seed);
  std::uint64_t bytes_of_belady = 0;
  std::uint64_t bytes_of_lru = 0;
  for (int round = 0; round < 30; ++round) {
    std::vector<VoxelCache::Size> voxels(30);
    for (VoxelCache::Size& voxel : voxels) { voxel = {10 + random() % 90, 10 + random() % 90}; }
    ReplaySteps steps(100);
    for (std::vector<TraceAccess>& step : steps) {
      for (std::uint32_t voxel = 0; voxel < voxels.size(); ++voxel) {
        if (random() % (2 + voxel) == 0) {
          step.push_back({VoxelId{voxel}, static_cast<std::uint32_t>(1 + random() % 9)});
        }
      }
    }
    const std::vector<bool> none_hot(voxels.size());
    const std::uint64_t limit = 200 + random() % 2000;
    const std::uint64_t bound = fetched_bytes_bound(steps, voxels, none_hot, limit);

    for (const Eviction eviction :
         {Eviction::kLru, Eviction::kLfu, Eviction::kPrior, Eviction::kS3Fifo}) {
      const ReplayResult result =
          replay(steps, voxels, none_hot, limit, make_policy(eviction, voxels));
      EXPECT_GE(result.counts.fetched_bytes, bound) << name_of(eviction) << " limit " << limit;
      if (eviction == Eviction::kLru) { bytes_of_lru += result.counts.fetched_bytes; }
    }
    const ReplayResult belady =
        replay(steps, voxels, none_hot, limit,
               std::make_unique<BeladyPolicy>(steps_of_use(steps, voxels.size())));
    EXPECT_GE(belady.counts.fetched_bytes, bound) << "belady, limit " << limit;
    bytes_of_belady += belady.counts.fetched_bytes;
  }
  EXPECT_LT(bytes_of_belady, bytes_of_lru);
}

}  // namespace
}  // namespace preheat
