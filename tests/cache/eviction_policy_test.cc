#include "cache/eviction_policy.h"

#include <gtest/gtest.h>

#include <cmath>
#include <iostream>
#include <random>
#include <set>

#include "tests/bench/belady_policy.h"

namespace preheat {
namespace {

bool any(VoxelId /*voxel*/) { return true; }

std::unique_ptr<EvictionPolicy> make_policy(Eviction eviction, std::size_t voxel_count,
                                            std::vector<double> chance_expected = {}) {
  return make_eviction_policy(
      eviction, {std::vector<std::uint64_t>(voxel_count, 1), std::move(chance_expected)});
}

// Voxels of one size, one used a period.
struct Sequence {
  std::vector<std::uint32_t> voxels{};

  [[nodiscard]] std::vector<std::vector<std::uint32_t>> periods_of_use(std::size_t count) const {
    std::vector<std::vector<std::uint32_t>> periods(count);
    for (std::size_t at = 0; at < voxels.size(); ++at) {
      periods[voxels[at]].push_back(static_cast<std::uint32_t>(at + 1));
    }
    return periods;
  }
};

// Misses of a cache of `capacity` voxels.
std::uint64_t misses(EvictionPolicy& policy, const Sequence& sequence, std::size_t capacity) {
  std::set<VoxelId> held;
  std::uint64_t misses = 0;
  for (const std::uint32_t id : sequence.voxels) {
    const VoxelId voxel{id};
    policy.begin_period();
    if (!held.contains(voxel)) {
      ++misses;
      if (held.size() == capacity) {
        const std::optional<VoxelId> victim = policy.first_to_go(any);
        EXPECT_TRUE(victim && held.contains(*victim));
        held.erase(*victim);
        policy.dropped(*victim);
      }
      held.insert(voxel);
      policy.admitted(voxel);
    }
    policy.used(voxel, 1);
  }
  return misses;
}

// The sequence of Belady, Nelson and Shedler (1969), with the misses they count.
TEST(EvictionPolicy, LruAndBeladyMissAsPublished) {
  const Sequence sequence{{1, 2, 3, 4, 1, 2, 5, 1, 2, 3, 4, 5}};

  EXPECT_EQ(misses(*make_policy(Eviction::kLru, 6), sequence, 3), 10U);
  EXPECT_EQ(misses(*make_policy(Eviction::kLru, 6), sequence, 4), 8U);
  BeladyPolicy of_three(sequence.periods_of_use(6));
  EXPECT_EQ(misses(of_three, sequence, 3), 7U);
  BeladyPolicy of_four(sequence.periods_of_use(6));
  EXPECT_EQ(misses(of_four, sequence, 4), 6U);
}

class EveryEvictionPolicy : public testing::TestWithParam<Eviction> {};

TEST_P(EveryEvictionPolicy, NamesOnlyHeldVoxelsThatMayGo) {
  const auto policy = make_policy(GetParam(), 3, {0.5, 0.5, 0.5});

  EXPECT_EQ(policy->first_to_go(any), std::nullopt);
  policy->admitted(VoxelId{1});
  policy->admitted(VoxelId{2});
  EXPECT_EQ(policy->first_to_go([](VoxelId voxel) { return voxel == VoxelId{2}; }), VoxelId{2});
  EXPECT_EQ(policy->first_to_go([](VoxelId) { return false; }), std::nullopt);
  policy->dropped(VoxelId{1});
  EXPECT_EQ(policy->first_to_go(any), VoxelId{2});
}

// Gives up any voxel.
class RandomPolicy : public RankedPolicy {
 public:
  RandomPolicy(std::size_t voxel_count, unsigned seed) : RankedPolicy(voxel_count), random_(seed) {}
  void admitted(VoxelId voxel) override {
    set_rank(voxel, static_cast<double>(random_()));
    RankedPolicy::admitted(voxel);
  }
  void used(VoxelId /*voxel*/, std::uint64_t /*rays*/) override {}
  void begin_period() override {}

 private:
  std::mt19937 random_;
};

// Skewed and drifting uses.
TEST_P(EveryEvictionPolicy, MissesNoLessThanBeladyAndLessThanAtRandom) {
  const unsigned seed = std::random_device{}();
  std::cout << "seed=" << seed << '\n';
  std::mt19937 random(seed);
  std::uint64_t misses_here = 0;
  std::uint64_t misses_at_random = 0;
  for (int round = 0; round < 8; ++round) {
    Sequence sequence;
    for (int at = 0; at < 3000; ++at) {
      const double uniform = static_cast<double>(random() % 10000 + 1) / 10000.0;
      const auto skewed = static_cast<std::uint32_t>(40.0 * uniform * uniform * uniform);
      sequence.voxels.push_back((skewed + static_cast<std::uint32_t>(at) / 1000 * 7) % 41);
    }
    for (const std::size_t capacity : {1U, 2U, 5U, 12U, 30U, 41U}) {
      BeladyPolicy belady(sequence.periods_of_use(41));
      const std::uint64_t fewest = misses(belady, sequence, capacity);
      const auto policy = make_policy(GetParam(), 41, std::vector<double>(41, 0.1));
      const std::uint64_t here = misses(*policy, sequence, capacity);
      EXPECT_GE(here, fewest) << "capacity " << capacity;
      RandomPolicy anyone(41, seed);
      misses_here += here;
      misses_at_random += misses(anyone, sequence, capacity);
    }
  }
  EXPECT_LT(misses_here, misses_at_random);
}

INSTANTIATE_TEST_SUITE_P(Policies, EveryEvictionPolicy,
                         testing::Values(Eviction::kLru, Eviction::kLfu, Eviction::kPrior,
                                         Eviction::kS3Fifo),
                         [](const auto& parameter) {
                           return testing::PrintToString(static_cast<int>(parameter.param)) + "_" +
                                  std::string(name_of(parameter.param)).substr(0, 2);
                         });

TEST(LfuPolicy, GivesUpTheVoxelUsedInTheFewestPeriods) {
  const auto policy = make_policy(Eviction::kLfu, 3);
  for (const std::uint32_t voxel : {0U, 1U, 2U}) { policy->admitted(VoxelId{voxel}); }

  // Voxel 0 in one period but by many rays; 1 in three; 2 in two, most recently.
  policy->begin_period();
  policy->used(VoxelId{0}, 1000);
  policy->used(VoxelId{0}, 1000);
  for (int period = 0; period < 3; ++period) {
    policy->used(VoxelId{1}, 1);
    policy->begin_period();
  }
  policy->used(VoxelId{2}, 1);
  policy->begin_period();
  policy->used(VoxelId{2}, 1);

  EXPECT_EQ(policy->first_to_go(any), VoxelId{0});
  policy->dropped(VoxelId{0});
  EXPECT_EQ(policy->first_to_go(any), VoxelId{2});
}

TEST(LfuPolicy, ForgetsUsesOfLongAgo) {
  const auto policy = make_policy(Eviction::kLfu, 2);
  policy->admitted(VoxelId{0});
  policy->admitted(VoxelId{1});
  for (int period = 0; period < 4; ++period) {
    policy->begin_period();
    policy->used(VoxelId{0}, 1);
  }
  for (int period = 0; period < 1000; ++period) { policy->begin_period(); }

  policy->used(VoxelId{1}, 1);

  EXPECT_EQ(policy->first_to_go(any), VoxelId{0});
}

TEST(LfuPolicy, RemembersAVoxelThatWasGivenUp) {
  const auto policy = make_policy(Eviction::kLfu, 2);
  policy->admitted(VoxelId{0});
  for (int period = 0; period < 4; ++period) {
    policy->begin_period();
    policy->used(VoxelId{0}, 1);
  }
  policy->dropped(VoxelId{0});
  policy->admitted(VoxelId{1});
  policy->used(VoxelId{1}, 1);

  policy->admitted(VoxelId{0});

  EXPECT_EQ(policy->first_to_go(any), VoxelId{1});
}

TEST(PriorPolicy, BeginsWithThePredictionAndLearns) {
  const auto policy = make_policy(Eviction::kPrior, 3, {0.9, 0.1, 0.5});
  for (const std::uint32_t voxel : {0U, 1U, 2U}) { policy->admitted(VoxelId{voxel}); }

  EXPECT_EQ(policy->first_to_go(any), VoxelId{1});
  for (int period = 0; period < 30; ++period) {
    policy->begin_period();
    policy->used(VoxelId{1}, 1);
  }

  EXPECT_EQ(policy->first_to_go(any), VoxelId{2});
}

TEST(ChancePerPeriod, IsThatOfAtLeastOneRay) {
  const std::vector<double> rays{0.0, 10.0, 1000.0};

  const std::vector<double> chances = chance_per_period(rays, 10.0);

  EXPECT_EQ(chances[0], 0.0);
  EXPECT_NEAR(chances[1], 1.0 - std::exp(-1.0), 1e-15);
  EXPECT_EQ(chances[2], 1.0);
}

// Ten voxels of one byte come in through the small queue, whose part is one of ten.
class S3Fifo : public testing::Test {
 protected:
  void SetUp() override {
    for (std::uint32_t voxel = 0; voxel < 10; ++voxel) { admit(voxel); }
  }
  void admit(std::uint32_t voxel) {
    policy_->begin_period();
    policy_->admitted(VoxelId{voxel});
    policy_->used(VoxelId{voxel}, 1);
  }
  void use(std::uint32_t voxel) {
    policy_->begin_period();
    policy_->used(VoxelId{voxel}, 1);
  }
  std::uint32_t drop() {
    const VoxelId victim = policy_->first_to_go(any).value();
    policy_->dropped(victim);
    return index_of(victim);
  }
  std::unique_ptr<EvictionPolicy> policy_ = make_policy(Eviction::kS3Fifo, 40);
};

TEST_F(S3Fifo, ThrowsOutFirstWhoCameFirstAndWasNotUsedAgain) {
  use(0);
  use(2);

  EXPECT_EQ(drop(), 1U);
  EXPECT_EQ(drop(), 3U);
  EXPECT_EQ(drop(), 4U);
}

TEST_F(S3Fifo, ShieldsTheMainQueueFromAScan) {
  for (std::uint32_t voxel = 0; voxel < 9; ++voxel) { use(voxel); }

  std::vector<std::uint32_t> dropped;
  for (std::uint32_t voxel = 10; voxel < 30; ++voxel) {
    dropped.push_back(drop());
    admit(voxel);
  }

  EXPECT_EQ(dropped.front(), 9U);
  for (std::size_t at = 1; at < dropped.size(); ++at) { EXPECT_EQ(dropped[at], at + 9U); }
}

TEST_F(S3Fifo, TakesAReturningVoxelIntoTheMainQueue) {
  ASSERT_EQ(drop(), 0U);
  admit(0);  // remembered: to the main queue

  // All others pass the small queue out before it.
  for (std::uint32_t voxel = 1; voxel < 10; ++voxel) { EXPECT_EQ(drop(), voxel); }
  EXPECT_EQ(drop(), 0U);
}

TEST_F(S3Fifo, GivesAUsedVoxelOfTheMainQueueAFurtherRound) {
  use(0);
  use(1);
  ASSERT_EQ(drop(), 2U);  // 0 and 1 moved to the main queue
  for (std::uint32_t voxel = 3; voxel < 10; ++voxel) { ASSERT_EQ(drop(), voxel); }
  use(0);

  EXPECT_EQ(drop(), 1U);
  EXPECT_EQ(drop(), 0U);
}

}  // namespace
}  // namespace preheat
