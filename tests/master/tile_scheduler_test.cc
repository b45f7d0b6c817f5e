#include "master/tile_scheduler.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <map>
#include <random>
#include <set>

namespace preheat {
namespace {

// A random number less than `count`.
std::uint32_t below(std::mt19937& random, std::uint32_t count) {
  return static_cast<std::uint32_t>(random() % count);
}

constexpr auto kAny = [](TileId) { return true; };

std::uint32_t distance(const TileGrid& grid, TileId a, TileId b) {
  const auto columns = static_cast<int>(grid.columns());
  const auto x = static_cast<int>(index_of(a)) % columns - static_cast<int>(index_of(b)) % columns;
  const auto y = static_cast<int>(index_of(a)) / columns - static_cast<int>(index_of(b)) / columns;
  return static_cast<std::uint32_t>(std::abs(x) + std::abs(y));
}

TEST(TileScheduler, GoesFromNeighbourToNeighbour) {
  const TileGrid grid{256, 256, 16};
  TileScheduler scheduler{grid};
  TileId last = *scheduler.next(WorkerId{0}, kAny);
  for (std::uint32_t i = 1; i < grid.count(); ++i) {
    const TileId tile = *scheduler.next(WorkerId{0}, kAny);
    EXPECT_EQ(distance(grid, last, tile), 1U);
    last = tile;
  }
  EXPECT_FALSE(scheduler.next(WorkerId{0}, kAny).has_value());
}

TEST(TileSize, IsSmallerWhereManyThreadsShareTheImage) {
  EXPECT_EQ(tile_size_for(512, 512, 8), 32U);
  EXPECT_EQ(tile_size_for(512, 512, 9), 16U);
  EXPECT_EQ(tile_size_for(3840, 2160, 255), 32U);  // 8,160 tiles of 32
  EXPECT_EQ(tile_size_for(3840, 2160, 256), 16U);
  EXPECT_EQ(tile_size_for(3840, 2160, 1'000), 16U);
  EXPECT_EQ(tile_size_for(3840, 2160, 100'000), 8U);
  EXPECT_EQ(tile_size_for(1, 1, 1), 8U);
}

TEST(TileScheduler, KeepsWorkersApart) {
  const TileGrid grid{256, 256, 16};
  TileScheduler scheduler{grid};
  // In turns, each takes a quarter of the image: the four are its quadrants, or nearly.
  std::map<std::uint32_t, std::set<std::uint32_t>> quadrants;
  for (std::uint32_t i = 0; i < 4 * 40; ++i) {
    const std::uint32_t tile = index_of(*scheduler.next(WorkerId{i % 4}, kAny));
    quadrants[i % 4].insert(tile % 16 / 8 + tile / 16 / 8 * 2);
  }
  for (const auto& [worker, touched] : quadrants) { EXPECT_LE(touched.size(), 2U) << worker; }
}

TEST(TileScheduler, GivesBackFirst) {
  TileScheduler scheduler{{64, 64, 16}};
  const TileId tile = *scheduler.next(WorkerId{0}, kAny);
  scheduler.give_back(tile);
  EXPECT_EQ(scheduler.next(WorkerId{1}, kAny), tile);
}

TEST(TileScheduler, HandsOutEveryTileOnceWhoeverAsks) {
  for (std::uint32_t seed = 1; seed <= 200; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    std::mt19937 random{seed};
    const TileGrid grid{1 + below(random, 500), 1 + below(random, 500), 1 + below(random, 64)};
    TileScheduler scheduler{grid};
    const std::uint32_t workers = 1 + below(random, 20);
    std::set<TileId> seen;
    while (const auto tile = scheduler.next(WorkerId{below(random, workers)}, kAny)) {
      EXPECT_TRUE(seen.insert(*tile).second);
      ASSERT_EQ(scheduler.pending(), grid.count() - seen.size());
    }
    EXPECT_EQ(seen.size(), grid.count());
  }
}

}  // namespace
}  // namespace preheat
