#include "tests/bench/cluster_simulation.h"

#include <gtest/gtest.h>

#include <cmath>

namespace preheat {
namespace {

constexpr double kTileSeconds = 2.0;

// Tiles of one wave that takes kTileSeconds, over `voxel_count` cold voxels of 1000 bytes each.
ClusterWork make_work(std::size_t tiles, std::size_t voxel_count) {
  ClusterWork work;
  work.voxels.assign(voxel_count, {1000, 1000});
  work.is_hot.assign(voxel_count, false);
  work.cold_limit_bytes = 4000 * (voxel_count + 1);
  SimulatedWave wave{kTileSeconds * 1e6, {}};
  for (std::uint32_t voxel = 0; voxel < voxel_count; ++voxel) {
    wave.accesses.push_back({VoxelId{voxel}, 100});
  }
  work.waves = {{wave}};
  work.tiles.assign(tiles, {});
  return work;
}

ClusterOptions make_options(unsigned workers) {
  ClusterOptions options;
  options.workers = workers;
  options.build_seconds_per_byte = 0.0;
  options.double_tiles = false;
  return options;
}

double sum(const ClusterSplit& split) {
  return split.traced + split.preload + split.stalled + split.duplicated + split.idle;
}

TEST(ClusterSimulation, WithoutVoxelsTakesAsManyRoundsAsTilesNeed) {
  const ClusterResult even = simulate_cluster(make_work(12, 0), make_options(4));
  EXPECT_NEAR(even.frame_seconds, 3 * kTileSeconds, 1e-3);
  EXPECT_NEAR(even.efficiency(), 1.0, 1e-3);

  const ClusterResult odd = simulate_cluster(make_work(13, 0), make_options(4));
  EXPECT_NEAR(odd.frame_seconds, 4 * kTileSeconds, 1e-3);
  EXPECT_NEAR(odd.efficiency(), 13.0 / 16.0, 1e-3);
  EXPECT_NEAR(odd.split.idle, 3 * kTileSeconds, 1e-3);
}

TEST(ClusterSimulation, TheOriginSendsEachColdVoxelOnceWhereItHasAHome) {
  const ClusterResult result = simulate_cluster(make_work(40, 6), make_options(4));

  EXPECT_EQ(result.origin_bytes, 6U * 1000U);
  EXPECT_EQ(result.fetches, 4U * 6U);
  // Whose home it is need not ask for it.
  EXPECT_EQ(result.peer_bytes, (4U * 6U - 6U) * 1000U);
}

TEST(ClusterSimulation, TheOriginSendsEveryFetchWhereNoHomeHasRoom) {
  ClusterWork work = make_work(40, 6);
  work.cold_limit_bytes = 12000;
  for (VoxelCache::Size& voxel : work.voxels) { voxel = {6500, 500}; }

  const ClusterResult result = simulate_cluster(work, make_options(4));

  EXPECT_EQ(result.peer_bytes, 0U);
  EXPECT_EQ(result.origin_bytes, result.fetches * 6500U);
}

TEST(ClusterSimulation, ASlowLinkStallsAndTheSplitSaysSo) {
  ClusterOptions options = make_options(2);
  options.link_bytes_per_second = 1000.0;  // a second for each of six voxels, before the first tile
  const ClusterResult result = simulate_cluster(make_work(2, 6), options);

  EXPECT_GT(result.split.stalled, 2.0);
  EXPECT_NEAR(sum(result.split), 2.0 * result.frame_seconds, 1e-9);
  EXPECT_NEAR(result.split.traced, 2 * kTileSeconds, 1e-9);
}

TEST(ClusterSimulation, BuildingOnOneThreadStallsWhereItTakesLongerThanTracing) {
  ClusterOptions options = make_options(1);
  options.build_seconds_per_byte = 1e-3;  // six seconds for the first wave, nothing thereafter

  const ClusterResult result = simulate_cluster(make_work(3, 6), options);

  EXPECT_NEAR(result.split.stalled, 6.0 - kTileSeconds, 0.01);
}

TEST(ClusterSimulation, DoublingTheLastTilesShortensTheTailOfASlowWorker) {
  ClusterWork work = make_work(64, 0);
  ClusterOptions options = make_options(8);
  options.slowness_mean = 1.0;
  const ClusterResult plain = simulate_cluster(work, options);
  options.double_tiles = true;
  const ClusterResult doubled = simulate_cluster(work, options);

  EXPECT_LT(doubled.frame_seconds, plain.frame_seconds);
  EXPECT_GT(doubled.split.duplicated, 0.0);
  EXPECT_EQ(plain.split.duplicated, 0.0);
  EXPECT_NEAR(sum(doubled.split), 8.0 * doubled.frame_seconds, 1e-9);
}

TEST(ClusterSimulation, IsAFunctionOfItsSeed) {
  ClusterOptions options = make_options(7);
  options.slowness_mean = 0.2;
  const ClusterWork work = make_work(50, 5);

  const double first = simulate_cluster(work, options).frame_seconds;
  EXPECT_EQ(simulate_cluster(work, options).frame_seconds, first);
  options.seed = 2;
  EXPECT_NE(simulate_cluster(work, options).frame_seconds, first);
}

TEST(Broadcast, AChainPassesOnWhatATreeWouldSendTwice) {
  ClusterOptions options;
  options.workers = 3;
  options.link_bytes_per_second = 1000.0;
  options.latency_seconds = 0.5;
  options.chunk_bytes = 1000;  // a second each

  options.broadcast_fan_out = 1;
  // Ten chunks; each hop adds a chunk and the latency.
  EXPECT_EQ(broadcast_seconds(10000, options), (std::vector<double>{10.5, 12.0, 13.5}));
  options.broadcast_fan_out = 3;
  EXPECT_EQ(broadcast_seconds(10000, options), (std::vector<double>{28.5, 29.5, 30.5}));
  EXPECT_EQ(broadcast_seconds(0, options), (std::vector<double>{0.0, 0.0, 0.0}));
}

TEST(ScaleFrame, KeepsRaysPerPathAndPlaces) {
  AccessTrace trace(64, 64, 4, 32);  // four tiles
  for (std::uint32_t tile = 0; tile < 4; ++tile) {
    const std::vector<TraceAccess> accesses{{VoxelId{tile}, 5000}};
    trace.add_step(TileId{tile}, 0, 4096, accesses);
    trace.add_step(TileId{tile}, 1, 4096, accesses);
  }
  ClusterWork work;
  work.voxels.assign(4, {1000, 1000});
  FrameScale scale;
  scale.width = 128;
  scale.height = 96;
  scale.spp = 256;

  scale_frame(trace, scale, work);

  ASSERT_EQ(work.tiles.size(), 12U);
  EXPECT_EQ(work.tiles[0].recorded, 0U);
  EXPECT_EQ(work.tiles[3].recorded, 1U);
  EXPECT_EQ(work.tiles[11].recorded, 3U);
  double rays = 0.0;
  for (const SimulatedTile& tile : work.tiles) {
    ASSERT_EQ(work.waves[tile.recorded].size(), 2U);
    for (const SimulatedWave& wave : work.waves[tile.recorded]) {
      rays += wave.rays * tile.rays_share;
      ASSERT_EQ(wave.accesses.size(), 1U);
      EXPECT_EQ(index_of(wave.accesses[0].voxel), tile.recorded);
      // 10,000 recorded accesses stand for 64 times as many in a tile, half of them in a wave.
      EXPECT_NEAR(wave.accesses[0].rays, 320000.0, 6 * std::sqrt(320000.0));
    }
  }
  EXPECT_NEAR(rays, 2.0 * 128 * 96 * 256, 1.0);  // two rays a path were recorded
}

}  // namespace
}  // namespace preheat
