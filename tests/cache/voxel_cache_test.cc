#include "cache/voxel_cache.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <deque>
#include <iostream>
#include <random>

namespace preheat {
namespace {

using Action = VoxelCache::Action;
using Command = VoxelCache::Command;

// Voxels of 40 bytes raw and 140 built.
std::vector<VoxelCache::Size> make_voxels(std::size_t count) {
  return std::vector<VoxelCache::Size>(count, {40, 100});
}

// A cache whose voxels were last used in the order of their ids.
VoxelCache make_cache(const std::vector<VoxelCache::Size>& voxels, std::uint64_t limit_bytes) {
  return {voxels, limit_bytes, [](VoxelId voxel) { return index_of(voxel); }};
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

TEST(VoxelCache, DropsBytesThatNobodyAskedFor) {
  const auto voxels = make_voxels(1);
  VoxelCache cache = make_cache(voxels, 140);

  EXPECT_FALSE(cache.block_arrived(VoxelId{0}));
  EXPECT_EQ(cache.held_bytes(), 0U);
}

// Random demand against caches of one voxel and up; commands are answered in random order. Every
// ray that waits must be served and the limit must hold after every call.
class VoxelCacheUnderRandomDemand : public testing::TestWithParam<std::uint64_t> {};

TEST_P(VoxelCacheUnderRandomDemand, ServesEveryRayWithinTheLimit) {
  const unsigned seed = std::random_device{}();
  std::cout << "seed=" << seed << '\n';
  std::mt19937 random(seed);
  auto voxels = make_voxels(24);
  for (VoxelCache::Size& voxel : voxels) { voxel = {20 + random() % 21, 30 + random() % 71}; }
  std::vector<std::uint64_t> used(voxels.size());
  const std::uint64_t limit = 140 * GetParam();
  VoxelCache cache(voxels, limit, [&](VoxelId voxel) { return used[index_of(voxel)]; });
  std::vector<std::uint64_t> waiting(voxels.size());
  std::uint64_t total_waiting = 0;
  std::vector<Command> under_way;
  std::uint64_t clock = 0;

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
        used[id] = ++clock;
      }
    }
    for (const Command& command : cache.step()) {
      if (command.action != Action::kDropBlock) { under_way.push_back(command); }
    }
    ASSERT_LE(cache.promised_bytes(), limit);
    ASSERT_LE(cache.held_bytes(), cache.promised_bytes());
  };
  for (int step = 0; step < 100000; ++step) { act(random() % 3 == 0); }
  for (int step = 0; step < 10000 && total_waiting > 0; ++step) { act(false); }

  EXPECT_EQ(total_waiting, 0U);
  EXPECT_GT(cache.counts().evictions, 0U);
}

INSTANTIATE_TEST_SUITE_P(VoxelsThatFit, VoxelCacheUnderRandomDemand, testing::Values(1, 2, 3, 8));

}  // namespace
}  // namespace preheat
