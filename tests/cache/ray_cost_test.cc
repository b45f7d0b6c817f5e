#include "cache/ray_cost.h"

#include <gtest/gtest.h>

#include <cstdio>

namespace preheat {
namespace {

// Three voxels of 1, 3 and 7 triangles.
SceneTables small_tables() {
  SceneTables tables;
  for (const std::uint32_t triangles : {1U, 3U, 7U}) {
    VoxelEntry entry;
    entry.triangle_count = triangles;
    tables.voxels.push_back(entry);
  }
  return tables;
}

Prediction of_rays(const std::vector<double>& camera, const std::vector<double>& shadow) {
  Prediction prediction;
  prediction.rays_camera = camera;
  prediction.rays_scatter.assign(camera.size(), 0.0);
  prediction.rays_shadow = shadow;
  return prediction;
}

TEST(RayCost, CountsTheLevelsOfTheVoxelsThatRaysEnter) {
  Prediction prediction = of_rays({10.0, 15.0, 0.0}, {0.0, 5.0, 5.0});
  prediction.camera_total = 60.0;
  prediction.shadow_total = 40.0;

  // 10 * 1 + 20 * 2 + 5 * 3 levels for 100 rays.
  EXPECT_DOUBLE_EQ(levels_per_ray(small_tables(), prediction), 0.65);
}

TEST(RayCost, IsOfNoLevelsWhereNoRayIsExpected) {
  EXPECT_EQ(levels_per_ray(small_tables(), of_rays({0.0, 0.0, 0.0}, {0.0, 0.0, 0.0})), 0.0);
}

TEST(RayCost, IsLinearInTheLevelsAndInTheMachine) {
  const double none = seconds_per_ray(1e-6, 0.0);

  EXPECT_GT(none, 0.0);
  EXPECT_GT(seconds_per_ray(1e-6, 1.0), none);
  EXPECT_NEAR(seconds_per_ray(1e-6, 20.0) - none, 2.0 * (seconds_per_ray(1e-6, 10.0) - none),
              1e-15);
  EXPECT_DOUBLE_EQ(seconds_per_ray(3e-6, 20.0), 3.0 * seconds_per_ray(1e-6, 20.0));
}

TEST(RayCost, IsMeasuredOnTheRendererItself) {
  for (const unsigned threads : {1U, 2U}) {
    const Result<double> seconds = measure_room_ray(threads);

    ASSERT_TRUE(seconds.has_value()) << seconds.error().message;
    std::printf("%u threads: %.0f ns a ray of the rooms\n", threads, *seconds * 1e9);
    EXPECT_GT(*seconds, 0.0);
  }
}

}  // namespace
}  // namespace preheat
