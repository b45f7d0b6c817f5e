#include "cache/voxel_cache.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <deque>
#include <iostream>
#include <random>
#include <tuple>
#include <utility>

namespace preheat {
namespace {

using Action = VoxelCache::Action;
using Command = VoxelCache::Command;

// Voxels of 40 bytes raw and 140 built.
std::vector<VoxelCache::Size> make_voxels(std::size_t count) {
  return std::vector<VoxelCache::Size>(count, {40, 100});
}

VoxelCache make_cache(const std::vector<VoxelCache::Size>& voxels, std::uint64_t limit_bytes,
                      Eviction eviction = Eviction::kLru) {
  EvictionInput input;
  for (const VoxelCache::Size& voxel : voxels) {
    input.bytes.push_back(voxel.block_bytes);
    input.chance_expected.push_back(1.0 / static_cast<double>(input.bytes.size()));
  }
  return {voxels, limit_bytes, make_eviction_policy(eviction, std::move(input))};
}

void fetch_build_and_serve(VoxelCache& cache, VoxelId voxel) {
  cache.add_waiting(voxel, 1);
  ASSERT_EQ(cache.step(), (std::vector<Command>{{Action::kFetch, voxel}}));
  ASSERT_TRUE(cache.block_arrived(voxel));
  ASSERT_EQ(cache.step(), (std::vector<Command>{{Action::kBuild, voxel}}));
  cache.built(voxel, 100);
  cache.served(voxel, 1);
}

TEST(VoxelCache, FetchesAVoxelThatRaysWaitForOnce) {
  const auto voxels = make_voxels(3);
  VoxelCache cache = make_cache(voxels, 1000);

  cache.add_waiting(VoxelId{1}, 5);
  EXPECT_EQ(cache.step(), (std::vector<Command>{{Action::kFetch, VoxelId{1}}}));
  cache.add_waiting(VoxelId{1}, 7);

  EXPECT_TRUE(cache.step().empty());
}

TEST(VoxelCache, AdmitsTheVoxelThatMostRaysWaitForFirst) {
  const auto voxels = make_voxels(3);
  VoxelCache cache = make_cache(voxels, 140);

  cache.add_waiting(VoxelId{0}, 5);
  cache.add_waiting(VoxelId{2}, 7);

  EXPECT_EQ(cache.step(), (std::vector<Command>{{Action::kFetch, VoxelId{2}}}));
}

TEST(VoxelCache, GivesUpTheBvhBeforeTheBlockAndTheOldestFirst) {
  const auto voxels = make_voxels(3);
  VoxelCache cache = make_cache(voxels, 320);
  fetch_build_and_serve(cache, VoxelId{0});
  fetch_build_and_serve(cache, VoxelId{1});

  cache.add_waiting(VoxelId{2}, 1);
  EXPECT_EQ(cache.step(), (std::vector<Command>{{Action::kWithdraw, VoxelId{0}}}));
  EXPECT_EQ(cache.held_bytes(), 280U);
  cache.withdrawn(VoxelId{0});

  EXPECT_EQ(cache.held_bytes(), 180U);
  EXPECT_EQ(cache.step(), (std::vector<Command>{{Action::kFetch, VoxelId{2}}}));
}

// Voxel 0 raw and oldest, voxel 1 built, eight being fetched, no room left; voxel 10 takes no more
// than one BVH.
struct FullCache {
  std::vector<VoxelCache::Size> voxels = make_voxels(11);
  VoxelCache cache;

  FullCache() : cache(make_cache(with_a_small_one(voxels), 1300)) {
    fetch_build_and_serve(cache, VoxelId{0});
    fetch_build_and_serve(cache, VoxelId{1});
    for (std::uint32_t voxel = 2; voxel < 10; ++voxel) { cache.add_waiting(VoxelId{voxel}, 1); }
    EXPECT_EQ(cache.step().size(), 8U);  // seven fetches, and the BVH of voxel 0
    cache.withdrawn(VoxelId{0});
    EXPECT_EQ(cache.step(), (std::vector<Command>{{Action::kFetch, VoxelId{9}}}));
    EXPECT_EQ(cache.promised_bytes(), 1300U);
  }

  static const std::vector<VoxelCache::Size>& with_a_small_one(
      std::vector<VoxelCache::Size>& voxels) {
    voxels[10] = {40, 60};
    return voxels;
  }
};

TEST(VoxelCache, GivesUpTheOldestWhereFetchesAreNotShort) {
  FullCache full;
  full.cache.add_waiting(VoxelId{10}, 1);
  EXPECT_EQ(full.cache.step(), (std::vector<Command>{{Action::kDropBlock, VoxelId{0}},
                                                     {Action::kWithdraw, VoxelId{1}}}));
}

TEST(VoxelCache, GivesUpABvhBeforeAnyBlockWhereFetchesAreShort) {
  FullCache full;
  // Nothing of it arrives.
  for (int i = 0; i < 64; ++i) { EXPECT_TRUE(full.cache.step().empty()); }
  full.cache.add_waiting(VoxelId{10}, 1);
  EXPECT_EQ(full.cache.step(), (std::vector<Command>{{Action::kWithdraw, VoxelId{1}}}));
  full.cache.withdrawn(VoxelId{1});
  EXPECT_EQ(full.cache.step(), (std::vector<Command>{{Action::kFetch, VoxelId{10}}}));
}

TEST(VoxelCache, RebuildsFromAHeldBlockWithoutFetching) {
  const auto voxels = make_voxels(2);
  VoxelCache cache = make_cache(voxels, 180);
  fetch_build_and_serve(cache, VoxelId{0});
  cache.add_waiting(VoxelId{1}, 1);
  EXPECT_EQ(cache.step(), (std::vector<Command>{{Action::kWithdraw, VoxelId{0}}}));
  cache.withdrawn(VoxelId{0});
  EXPECT_EQ(cache.step(), (std::vector<Command>{{Action::kFetch, VoxelId{1}}}));
  ASSERT_TRUE(cache.block_arrived(VoxelId{1}));
  EXPECT_EQ(cache.step(), (std::vector<Command>{{Action::kBuild, VoxelId{1}}}));
  cache.built(VoxelId{1}, 100);
  cache.served(VoxelId{1}, 1);

  cache.add_waiting(VoxelId{0}, 1);
  EXPECT_EQ(cache.step(), (std::vector<Command>{{Action::kWithdraw, VoxelId{1}}}));
  cache.withdrawn(VoxelId{1});

  EXPECT_EQ(cache.step(), (std::vector<Command>{{Action::kBuild, VoxelId{0}}}));
  cache.built(VoxelId{0}, 100);
  EXPECT_EQ(cache.counts().rebuilds, 1U);
  EXPECT_EQ(cache.counts().fetches, 2U);
}

TEST(VoxelCache, NeverEvictsABuiltVoxelThatHasRaysToServe) {
  const auto voxels = make_voxels(2);
  VoxelCache cache = make_cache(voxels, 140);
  cache.add_waiting(VoxelId{0}, 1);
  EXPECT_EQ(cache.step().size(), 1U);
  ASSERT_TRUE(cache.block_arrived(VoxelId{0}));
  EXPECT_EQ(cache.step().size(), 1U);
  cache.built(VoxelId{0}, 100);

  cache.add_waiting(VoxelId{1}, 100);
  EXPECT_TRUE(cache.step().empty());
  cache.served(VoxelId{0}, 1);

  EXPECT_EQ(cache.step(), (std::vector<Command>{{Action::kWithdraw, VoxelId{0}}}));
}

void arrive_and_build(VoxelCache& cache, VoxelId voxel) {
  ASSERT_TRUE(cache.block_arrived(voxel));
  const std::vector<Command> commands = cache.step();
  ASSERT_EQ(commands.front(), (Command{Action::kBuild, voxel}));
  cache.built(voxel, 100);
}

TEST(VoxelCache, PrefetchesInOrderAsFarAsThereIsRoom) {
  VoxelCache cache = make_cache(make_voxels(4), 300);

  cache.prefetch(std::vector<VoxelId>{VoxelId{2}, VoxelId{0}, VoxelId{1}});
  EXPECT_EQ(cache.step(),
            (std::vector<Command>{{Action::kFetch, VoxelId{2}}, {Action::kFetch, VoxelId{0}}}));
  arrive_and_build(cache, VoxelId{2});
  arrive_and_build(cache, VoxelId{0});

  EXPECT_TRUE(cache.step().empty());
  EXPECT_TRUE(cache.is_built(VoxelId{2}));
  EXPECT_EQ(cache.counts().prefetches, 2U);
  EXPECT_EQ(cache.counts().prefetched_bytes, 80U);
  EXPECT_EQ(cache.counts().fetches, 0U);
}

TEST(VoxelCache, FetchesWhatRaysWaitForBeforeItPrefetches) {
  VoxelCache cache = make_cache(make_voxels(3), 300);

  cache.prefetch(std::vector<VoxelId>{VoxelId{0}, VoxelId{1}});
  cache.add_waiting(VoxelId{2}, 1);

  EXPECT_EQ(cache.step(),
            (std::vector<Command>{{Action::kFetch, VoxelId{2}}, {Action::kFetch, VoxelId{0}}}));
}

TEST(VoxelCache, GivesUpWhatWasPrefetchedForWhatRaysWaitFor) {
  VoxelCache cache = make_cache(make_voxels(2), 140);
  cache.prefetch(std::vector<VoxelId>{VoxelId{0}});
  ASSERT_EQ(cache.step().size(), 1U);
  arrive_and_build(cache, VoxelId{0});

  cache.add_waiting(VoxelId{1}, 1);

  EXPECT_EQ(cache.step(), (std::vector<Command>{{Action::kWithdraw, VoxelId{0}}}));
}

TEST(VoxelCache, ServesRaysThatBeginToWaitForWhatIsBeingPrefetched) {
  VoxelCache cache = make_cache(make_voxels(2), 140);
  cache.prefetch(std::vector<VoxelId>{VoxelId{0}});
  ASSERT_EQ(cache.step().size(), 1U);

  cache.add_waiting(VoxelId{0}, 3);
  EXPECT_TRUE(cache.step().empty()) << "asked for twice";
  arrive_and_build(cache, VoxelId{0});
  cache.add_waiting(VoxelId{1}, 1);
  EXPECT_TRUE(cache.step().empty()) << "evicted before it served";
  cache.served(VoxelId{0}, 3);

  EXPECT_EQ(cache.step(), (std::vector<Command>{{Action::kWithdraw, VoxelId{0}}}));
}

TEST(VoxelCache, DropsBytesThatNobodyAskedFor) {
  const auto voxels = make_voxels(1);
  VoxelCache cache = make_cache(voxels, 140);

  EXPECT_FALSE(cache.block_arrived(VoxelId{0}));
  EXPECT_EQ(cache.held_bytes(), 0U);
}

// Random demand against caches of one voxel and up; commands are answered in random order. Every
// ray that waits must be served and the limit must hold after every call.
class VoxelCacheUnderRandomDemand
    : public testing::TestWithParam<std::tuple<Eviction, std::uint64_t>> {};

TEST_P(VoxelCacheUnderRandomDemand, ServesEveryRayWithinTheLimit) {
  const unsigned seed = std::random_device{}();
  std::cout << "seed=" << seed << '\n';
  std::mt19937 random(seed);
  auto voxels = make_voxels(24);
  for (VoxelCache::Size& voxel : voxels) { voxel = {20 + random() % 21, 30 + random() % 71}; }
  const auto [eviction, voxels_that_fit] = GetParam();
  const std::uint64_t limit = 140 * voxels_that_fit;
  VoxelCache cache = make_cache(voxels, limit, eviction);
  std::vector<std::uint64_t> waiting(voxels.size());
  std::uint64_t total_waiting = 0;
  std::vector<Command> under_way;

  const auto act = [&](bool demand) {
    if (demand) {
      const VoxelId voxel{static_cast<std::uint32_t>(random() % voxels.size())};
      const std::uint64_t rays = 1 + random() % 9;
      cache.add_waiting(voxel, rays);
      waiting[index_of(voxel)] += rays;
      total_waiting += rays;
    } else if (!under_way.empty()) {
      std::swap(under_way[random() % under_way.size()], under_way.back());
      const Command command = under_way.back();
      under_way.pop_back();
      switch (command.action) {
        case Action::kFetch:
          ASSERT_TRUE(cache.block_arrived(command.voxel));
          break;
        case Action::kBuild:
          cache.built(command.voxel,
                      voxels[index_of(command.voxel)].bvh_bytes_max * (1 + random() % 10) / 10);
          break;
        case Action::kWithdraw:
          cache.withdrawn(command.voxel);
          break;
        case Action::kDropBlock:
          break;
      }
    }
    for (std::uint32_t id = 0; id < voxels.size(); ++id) {
      if (waiting[id] > 0 && cache.is_built(VoxelId{id})) {
        cache.served(VoxelId{id}, waiting[id]);
        total_waiting -= waiting[id];
        waiting[id] = 0;
        cache.used(VoxelId{id}, 1);
      }
    }
    for (const Command& command : cache.step()) {
      if (command.action != Action::kDropBlock) { under_way.push_back(command); }
    }
    ASSERT_LE(cache.promised_bytes(), limit);
    ASSERT_LE(cache.held_bytes(), cache.promised_bytes());
  };
  for (int step = 0; step < 100000; ++step) {
    act(random() % 3 == 0);
    if (step % 50 == 0) { cache.begin_period(); }
  }
  for (int step = 0; step < 10000 && total_waiting > 0; ++step) { act(false); }

  EXPECT_EQ(total_waiting, 0U);
  EXPECT_GT(cache.counts().evictions, 0U);
}

INSTANTIATE_TEST_SUITE_P(PolicyAndVoxelsThatFit, VoxelCacheUnderRandomDemand,
                         testing::Combine(testing::Values(Eviction::kLru, Eviction::kLfu,
                                                          Eviction::kPrior, Eviction::kS3Fifo),
                                          testing::Values(1, 2, 3, 8)));

}  // namespace
}  // namespace preheat
