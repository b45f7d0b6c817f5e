#include "common/home_plan.h"

#include <gtest/gtest.h>

#include <random>

namespace preheat {
namespace {

// A random number less than `count`.
std::uint32_t below(std::mt19937& random, std::uint32_t count) {
  return static_cast<std::uint32_t>(random() % count);
}

HomePlan some_plan() {
  HomePlan plan;
  plan.peers.push_back({WorkerId{3}, {1, 2}, {"tcp://127.0.0.1:4000"}});
  plan.peers.push_back({WorkerId{9}, {3, 4}, {"tcp://127.0.0.1:4001"}});
  plan.homes = {0, 1 | HomePlan::kKept, HomePlan::kNoHome, 1};
  return plan;
}

TEST(HomePlan, ComesBackAsItWentOut) {
  const auto plan = decode_home_plan(encode_home_plan(some_plan()), 4);

  ASSERT_TRUE(plan.has_value()) << plan.error().message;
  ASSERT_EQ(plan->peers.size(), 2U);
  EXPECT_EQ(plan->peers[1].endpoint.text, "tcp://127.0.0.1:4001");
  EXPECT_EQ(plan->home_of(VoxelId{0})->worker, WorkerId{3});
  EXPECT_EQ(plan->home_of(VoxelId{3})->worker, WorkerId{9});
  EXPECT_EQ(plan->home_of(VoxelId{2}), nullptr);
  EXPECT_EQ(plan->home_of(VoxelId{4}), nullptr);
  EXPECT_TRUE(plan->is_kept(VoxelId{1}));
  for (const std::uint32_t voxel : {0U, 2U, 3U, 4U}) {
    EXPECT_FALSE(plan->is_kept(VoxelId{voxel}));
  }
}

TEST(HomePlan, IsRefusedForAnotherNumberOfVoxels) {
  const auto plan = decode_home_plan(encode_home_plan(some_plan()), 5);
  ASSERT_FALSE(plan.has_value());
  EXPECT_EQ(plan.error().message, "the plan of homes is for 4 voxels, not 5");
}

TEST(HomePlan, IsRefusedWithAHomeThatIsNoPeer) {
  HomePlan plan = some_plan();
  plan.homes[1] = 2;
  EXPECT_FALSE(decode_home_plan(encode_home_plan(plan), 4).has_value());
}

TEST(HomePlan, IsRefusedCutShort) {
  const std::vector<std::byte> whole = encode_home_plan(some_plan());
  for (std::size_t size = 0; size < whole.size(); ++size) {
    EXPECT_FALSE(decode_home_plan(std::span(whole).first(size), 4).has_value()) << size;
  }
}

TEST(HomePlan, SurvivesChangedBytes) {
  constexpr std::uint32_t kSeed = 3;
  SCOPED_TRACE(kSeed);
  std::mt19937 random{kSeed};
  for (int i = 0; i < 100'000; ++i) {
    std::vector<std::byte> bytes = encode_home_plan(some_plan());
    for (unsigned changes = 1 + below(random, 3); changes > 0; --changes) {
      bytes[below(random, static_cast<std::uint32_t>(bytes.size()))] =
          static_cast<std::byte>(random());
    }
    const auto plan = decode_home_plan(bytes, 4);
    if (!plan) { continue; }
    for (std::uint32_t voxel = 0; voxel < 4; ++voxel) {
      static_cast<void>(plan->home_of(VoxelId{voxel}));
    }
  }
}

}  // namespace
}  // namespace preheat
