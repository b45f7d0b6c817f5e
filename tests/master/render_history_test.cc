#include "master/render_history.h"

#include <gtest/gtest.h>

#include <random>

namespace preheat {
namespace {

using std::chrono::milliseconds;

constexpr WorkerId kFirst{0};
constexpr WorkerId kSecond{1};

WorkerStats stats_of(std::uint64_t accesses, std::uint64_t misses, std::uint64_t bytes) {
  WorkerStats stats;
  stats.cache.accesses = accesses;
  stats.cache.misses = misses;
  stats.cache.remote_bytes = bytes;
  return stats;
}

TEST(RenderHistory, CountsSecondsFromTheFirstLease) {
  HistoryRecorder recorder;
  const Time start{};
  recorder.worker_ready(kFirst, 3, start);
  recorder.counted(kFirst, stats_of(1, 0, 0), start + milliseconds(100));
  recorder.begin(start + milliseconds(500));
  recorder.begin(start + milliseconds(900));  // later ones are not news
  recorder.counted(kFirst, stats_of(100, 10, 1000), start + milliseconds(1500));
  recorder.worker_ready(kSecond, 1, start + milliseconds(2000));
  recorder.worker_gone(kSecond, /*lost=*/true, start + milliseconds(2500));

  const RenderHistory history = recorder.take(start + milliseconds(3500));

  EXPECT_DOUBLE_EQ(history.seconds, 3.0);
  ASSERT_EQ(history.workers.size(), 2U);
  EXPECT_EQ(history.workers[0].threads, 3U);
  EXPECT_DOUBLE_EQ(history.workers[0].begin_seconds, 0.0);
  EXPECT_DOUBLE_EQ(history.workers[0].end_seconds, 3.0);
  EXPECT_FALSE(history.workers[0].lost);
  ASSERT_EQ(history.workers[0].points.size(), 1U);
  EXPECT_DOUBLE_EQ(history.workers[0].points[0].seconds, 1.0);
  EXPECT_EQ(history.workers[0].points[0].misses, 10U);
  EXPECT_EQ(history.workers[0].points[0].remote_bytes, 1000U);
  EXPECT_DOUBLE_EQ(history.workers[1].begin_seconds, 1.5);
  EXPECT_DOUBLE_EQ(history.workers[1].end_seconds, 2.0);
  EXPECT_TRUE(history.workers[1].lost);
}

TEST(RenderHistory, IsEmptyIfNothingWasLeased) {
  HistoryRecorder recorder;
  recorder.worker_ready(kFirst, 1, Time{});
  recorder.counted(kFirst, {}, Time{});
  recorder.tile_done(kFirst, TileId{0}, Time{}, Time{});

  EXPECT_TRUE(recorder.take(Time{}).workers.empty());
}

TEST(RenderHistory, ARunBeginsNeitherBeforeItsLeaseNorBeforeThePreviousResult) {
  HistoryRecorder recorder;
  const Time start{};
  recorder.begin(start);
  recorder.tile_done(kFirst, TileId{4}, start, start + milliseconds(1000));
  recorder.tile_done(kFirst, TileId{5}, start, start + milliseconds(1500));
  recorder.tile_done(kFirst, TileId{6}, start + milliseconds(2000), start + milliseconds(2500));

  const RenderHistory history = recorder.take(start + milliseconds(3000));

  const std::vector<TileRun>& runs = history.workers.at(0).runs;
  ASSERT_EQ(runs.size(), 3U);
  EXPECT_DOUBLE_EQ(runs[0].begin_seconds, 0.0);
  EXPECT_DOUBLE_EQ(runs[1].begin_seconds, 1.0);
  EXPECT_DOUBLE_EQ(runs[1].end_seconds, 1.5);
  EXPECT_DOUBLE_EQ(runs[2].begin_seconds, 2.0);
  EXPECT_EQ(runs[2].tile_first, 6U);
}

TEST(RenderHistory, StaysBoundedAndKeepsBothEndsAndEveryTile) {
  constexpr std::uint32_t kTold = 400'000;
  constexpr std::uint32_t kSeed = 11;
  SCOPED_TRACE(testing::Message() << "seed " << kSeed);
  std::mt19937 random(kSeed);
  HistoryRecorder recorder;
  Time now{};
  recorder.begin(now);
  std::array<std::uint32_t, 3> told{};
  for (std::uint32_t i = 0; i < kTold; ++i) {
    now += milliseconds(20 + random() % 100);
    const auto worker = static_cast<std::uint32_t>(random() % 3);
    ++told[worker];
    recorder.counted(WorkerId{worker}, stats_of(told[worker], 0, 0), now);
    recorder.tile_done(WorkerId{worker}, TileId{i}, now - milliseconds(50), now);
  }

  const RenderHistory history = recorder.take(now);

  ASSERT_EQ(history.workers.size(), 3U);
  std::size_t points = 0;
  std::size_t runs = 0;
  for (std::size_t id = 0; id < 3; ++id) {
    const WorkerHistory& worker = history.workers[id];
    points += worker.points.size();
    runs += worker.runs.size();
    EXPECT_EQ(worker.points.back().accesses, told[id]);
    EXPECT_LT(worker.points.front().seconds, 1.0);
    std::uint32_t tiles = 0;
    for (std::size_t i = 0; i < worker.runs.size(); ++i) {
      tiles += worker.runs[i].tiles;
      EXPECT_LE(worker.runs[i].begin_seconds, worker.runs[i].end_seconds);
      if (i > 0) { EXPECT_GE(worker.runs[i].begin_seconds, worker.runs[i - 1].end_seconds); }
    }
    EXPECT_EQ(tiles, told[id]);
    for (std::size_t i = 1; i < worker.points.size(); ++i) {
      EXPECT_GT(worker.points[i].seconds, worker.points[i - 1].seconds);
    }
  }
  EXPECT_LE(points, HistoryRecorder::kPointsMax);
  EXPECT_GT(points, HistoryRecorder::kPointsMax / 4);
  EXPECT_LE(runs, HistoryRecorder::kRunsMax);
  EXPECT_GT(runs, HistoryRecorder::kRunsMax / 4);
}

TEST(RenderHistory, ManyWorkersHaveThreePointsEach) {
  constexpr std::uint32_t kWorkers = 16'384;
  HistoryRecorder recorder;
  recorder.begin(Time{});
  for (int round = 1; round <= 4; ++round) {
    for (std::uint32_t worker = 0; worker < kWorkers; ++worker) {
      recorder.counted(WorkerId{worker}, {}, Time{} + std::chrono::seconds(round));
    }
  }

  const RenderHistory history = recorder.take(Time{} + std::chrono::seconds(5));

  std::size_t points = 0;
  for (const WorkerHistory& worker : history.workers) {
    ASSERT_GE(worker.points.size(), 1U);
    EXPECT_DOUBLE_EQ(worker.points.back().seconds, 4.0);
    points += worker.points.size();
  }
  EXPECT_LE(points, 3U * kWorkers);
}

}  // namespace
}  // namespace preheat
