#include "master/home_assignment.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <numeric>
#include <random>

namespace preheat {
namespace {

std::vector<VoxelEntry> voxels_of(std::size_t count, std::uint32_t block_bytes) {
  std::vector<VoxelEntry> voxels(count);
  for (VoxelEntry& voxel : voxels) { voxel.block_bytes = block_bytes; }
  return voxels;
}

std::vector<HomeCandidate> workers_of(std::size_t count, std::uint64_t bytes_max) {
  std::vector<HomeCandidate> workers;
  for (std::uint32_t id = 0; id < count; ++id) { workers.push_back({WorkerId{id}, bytes_max}); }
  return workers;
}

std::vector<double> skewed_fetches(std::size_t count, std::uint32_t seed) {
  std::mt19937 random{seed};
  std::vector<double> fetches(count);
  for (double& one : fetches) { one = static_cast<double>(1 + random() % 1000) * 0.1; }
  return fetches;
}

std::vector<double> loads_of(const std::vector<std::uint16_t>& homes,
                             const std::vector<double>& fetches, std::size_t workers) {
  std::vector<double> loads(workers);
  for (std::size_t voxel = 0; voxel < homes.size(); ++voxel) {
    if (homes[voxel] != HomePlan::kNoHome) {
      loads[HomePlan::index(homes[voxel])] += fetches[voxel];
    }
  }
  return loads;
}

TEST(HomeAssignment, SharesTheFetchesOutEvenly) {
  const std::vector<double> fetches = skewed_fetches(5000, 1);
  const auto homes = assign_homes(workers_of(16, UINT64_MAX), fetches, voxels_of(5000, 100), {});

  const std::vector<double> loads = loads_of(homes, fetches, 16);
  const double mean = std::accumulate(loads.begin(), loads.end(), 0.0) / 16.0;
  for (const double load : loads) { EXPECT_NEAR(load, mean, 0.02 * mean); }
}

TEST(HomeAssignment, GivesRoomWhereThereIsSome) {
  // The small worker has room for two blocks and gets no third while the other has room.
  std::vector<HomeCandidate> workers = workers_of(2, 1000);
  workers[0].bytes_max = 200;
  const std::vector<double> fetches(12, 1.0);
  const auto homes = assign_homes(workers, fetches, voxels_of(12, 100), {});

  EXPECT_EQ(std::count(homes.begin(), homes.end(), 0 | HomePlan::kKept), 2);
  EXPECT_EQ(std::count(homes.begin(), homes.end(), 1 | HomePlan::kKept), 10);
}

TEST(HomeAssignment, KeepsWhatIsFetchedMostWhereThereIsNoRoomForAll) {
  const std::vector<double> fetches{1.0, 9.0, 8.0, 2.0};
  const auto homes = assign_homes(workers_of(2, 100), fetches, voxels_of(4, 100), {});

  for (const std::size_t voxel : {1U, 2U}) { EXPECT_NE(homes[voxel] & HomePlan::kKept, 0); }
  for (const std::size_t voxel : {0U, 3U}) {
    EXPECT_NE(homes[voxel], HomePlan::kNoHome);
    EXPECT_EQ(homes[voxel] & HomePlan::kKept, 0);
  }
}

TEST(HomeAssignment, GivesNoHomeToWhatNobodyFetches) {
  const std::vector<double> fetches{1.0, 0.0, 1.0};
  const auto homes = assign_homes(workers_of(2, 1000), fetches, voxels_of(3, 1), {});
  EXPECT_EQ(homes[1], HomePlan::kNoHome);
  EXPECT_NE(homes[0], homes[2]);
}

TEST(HomeAssignment, WithoutWorkersNothingHasAHome) {
  const std::vector<double> fetches{1.0};
  EXPECT_EQ(assign_homes({}, fetches, voxels_of(1, 1), {}),
            std::vector<std::uint16_t>{HomePlan::kNoHome});
}

TEST(HomeAssignment, OfAWorkerThatIsGoneGoToTheOthersAndNothingElseMoves) {
  const std::vector<double> fetches = skewed_fetches(2000, 2);
  std::vector<HomeCandidate> workers = workers_of(8, UINT64_MAX);
  const auto first = assign_homes(workers, fetches, voxels_of(2000, 100), {});
  std::vector<WorkerId> before;
  for (const std::uint16_t home : first) {
    before.push_back(workers[HomePlan::index(home)].worker);
  }

  workers.erase(workers.begin() + 3);
  const auto second = assign_homes(workers, fetches, voxels_of(2000, 100), before);

  for (std::size_t voxel = 0; voxel < 2000; ++voxel) {
    const WorkerId now = workers[HomePlan::index(second[voxel])].worker;
    if (before[voxel] == WorkerId{3}) {
      EXPECT_NE(now, WorkerId{3});
    } else {
      EXPECT_EQ(now, before[voxel]);
    }
  }
}

TEST(HomeAssignment, ANewcomerGetsItsShareAndNoMoreMoves) {
  const std::vector<double> fetches(900, 1.0);
  const auto first = assign_homes(workers_of(2, UINT64_MAX), fetches, voxels_of(900, 100), {});
  std::vector<WorkerId> before;
  for (const std::uint16_t home : first) {
    before.push_back(WorkerId{home & ~unsigned{HomePlan::kKept}});
  }

  const auto second = assign_homes(workers_of(3, UINT64_MAX), fetches, voxels_of(900, 100), before);

  int moved = 0;
  for (std::size_t voxel = 0; voxel < 900; ++voxel) { moved += first[voxel] != second[voxel]; }
  EXPECT_GE(moved, 270);  // 300 but for the slack
  EXPECT_LE(moved, 300);
  EXPECT_EQ(std::count(second.begin(), second.end(), 2 | HomePlan::kKept), moved);
}

TEST(HomeBytes, LeaveRoomForTheLargestVoxel) {
  SceneTables tables;
  tables.voxels = voxels_of(10, 100);
  for (VoxelEntry& voxel : tables.voxels) { voxel.resident_bytes = 400; }
  for (std::uint64_t limit = 0; limit < 10'000; limit += 7) {
    for (const std::size_t workers : {0U, 1U, 2U, 5U, 1000U}) {
      const std::uint64_t bytes = home_bytes(tables, 1000, limit, workers);
      if (bytes == 0) { continue; }
      EXPECT_GE(workers, 2U);
      EXPECT_GE(limit - bytes, 400U);
      EXPECT_EQ(bytes, 1000 / workers);
      EXPECT_LE(bytes, limit / 20);
    }
  }
}

TEST(HomeBytes, AreGivenWhereAllColdBlocksFitASmallPartOfTheCaches) {
  SceneTables tables;
  tables.voxels = voxels_of(10, 100);
  EXPECT_EQ(home_bytes(tables, 1000, 20 * 200, 5), 200U);
  EXPECT_EQ(home_bytes(tables, 1000, 20 * 200 - 1, 5), 0U);
  EXPECT_EQ(home_bytes(tables, 1000, 20 * 200, 4), 0U);
}

TEST(ExpectedFetches, AreRaysWhereTheyAreFewAndGenerationsWhereManyAre) {
  const std::vector<double> rays{0.0, 0.01, 1e9};
  const std::vector<double> fetches = expected_fetches(rays, 50.0);
  EXPECT_EQ(fetches[0], 0.0);
  EXPECT_NEAR(fetches[1], 0.01, 1e-5);
  EXPECT_NEAR(fetches[2], 50.0, 1e-9);
}

}  // namespace
}  // namespace preheat
