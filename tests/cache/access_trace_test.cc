#include "tests/bench/access_trace.h"

#include <gtest/gtest.h>

#include "cache/counted_render.h"
#include "tests/scenes/scratch_folder.h"
#include "tests/scenes/soups.h"
#include "tests/scenes/store_of_scene.h"

namespace preheat {
namespace {

RenderSettings small_settings() {
  RenderSettings settings;
  settings.view.origin = Vec3(0.0F, 0.0F, 0.95F);
  settings.view.right = Vec3(0.7F, 0.0F, 0.0F);
  settings.view.up = Vec3(0.0F, 0.7F, 0.0F);
  settings.width = 40;
  settings.height = 33;
  settings.spp = 2;
  settings.bounces = 3;
  settings.sky = Vec3(1.0F);
  return settings;
}

class AccessTraceTest : public testing::Test {
 protected:
  test::ScratchFolder folder_;
  Store store_ =
      test::store_of_scene(test::soup(800, 0.12F, 7), 40, folder_.path() / "soup.store").value();
};

TEST_F(AccessTraceTest, HoldsWhatTheRendererCounts) {
  const RenderSettings settings = small_settings();

  const AccessTrace trace = record_accesses(store_, settings, 16).value();

  std::vector<std::uint64_t> entered(store_.tables().voxels.size());
  std::uint64_t rays = 0;
  for (std::size_t step = 0; step < trace.steps().size(); ++step) {
    rays += trace.steps()[step].rays;
    for (const TraceAccess& access : trace.accesses(step)) {
      entered[index_of(access.voxel)] += access.rays;
    }
  }
  const CountedRender counted = render_counted(store_, settings, {}).value();
  EXPECT_GT(counted.rays.shadow + counted.rays.scatter, counted.rays.camera / 10);
  EXPECT_EQ(rays, counted.rays.total());
  for (std::size_t voxel = 0; voxel < entered.size(); ++voxel) {
    EXPECT_EQ(entered[voxel], counted.accesses[voxel].total()) << "voxel " << voxel;
  }
}

TEST_F(AccessTraceTest, ComesBackFromAFile) {
  const AccessTrace trace = record_accesses(store_, small_settings(), 16).value();
  ASSERT_TRUE(trace.save(folder_.path() / "trace").has_value());

  const AccessTrace loaded = AccessTrace::load(folder_.path() / "trace").value();

  ASSERT_EQ(loaded.steps().size(), trace.steps().size());
  EXPECT_EQ(loaded.spp(), 2U);
  EXPECT_EQ(loaded.grid().count(), trace.grid().count());
  for (std::size_t step = 0; step < trace.steps().size(); ++step) {
    EXPECT_EQ(loaded.steps()[step].rays, trace.steps()[step].rays);
    const auto expected = trace.accesses(step);
    const auto found = loaded.accesses(step);
    EXPECT_TRUE(std::equal(found.begin(), found.end(), expected.begin(), expected.end()));
  }
  std::filesystem::resize_file(folder_.path() / "trace", 100);
  EXPECT_FALSE(AccessTrace::load(folder_.path() / "trace").has_value());
}

TEST(WaveSteps, PutTilesTogetherDepthByDepth) {
  AccessTrace trace(16, 64, 1, 16);  // four tiles of 256 paths
  for (std::uint32_t tile = 0; tile < 4; ++tile) {
    const std::vector<TraceAccess> camera{{VoxelId{0}, 200}, {VoxelId{tile + 1}, 56}};
    const std::vector<TraceAccess> scattered{{VoxelId{9}, 10}};
    trace.add_step(TileId{tile}, 0, 256, camera);
    trace.add_step(TileId{tile}, 1, 99, scattered);
  }

  const auto waves = wave_steps(trace, 512, 1);

  ASSERT_EQ(waves.size(), 4U);
  EXPECT_EQ(waves[0],
            (std::vector<TraceAccess>{{VoxelId{0}, 400}, {VoxelId{1}, 56}, {VoxelId{2}, 56}}));
  EXPECT_EQ(waves[1], (std::vector<TraceAccess>{{VoxelId{9}, 20}}));
  EXPECT_EQ(waves[2][1], (TraceAccess{VoxelId{3}, 56}));
  // Of two workers each has every other wave.
  EXPECT_EQ(wave_steps(trace, 256, 2).size(), 4U);
}

}  // namespace
}  // namespace preheat
