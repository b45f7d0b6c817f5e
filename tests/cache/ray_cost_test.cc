#include "cache/ray_cost.h"

#include <gtest/gtest.h>

#include <cstdio>

namespace preheat {
namespace {

TEST(RayCost, IsTheSumThatThePaperGives) {
  // [P] section 2: C_ray = alpha C_t + beta m C_t.
  const RayCost cost{/*leaf_seconds=*/3.0, /*object_seconds=*/0.5};

  EXPECT_DOUBLE_EQ(cost.seconds_per_ray({/*traversal_cost=*/4.0, /*objects_per_leaf=*/10.0}),
                   3.0 * 4.0 + 0.5 * 10.0 * 4.0);
}

TEST(RayCost, IsSolvedFromTwoScenes) {
  const RayCost truth{/*leaf_seconds=*/2e-8, /*object_seconds=*/3e-9};
  const RayCostScene coarse{/*traversal_cost=*/5.0, /*objects_per_leaf=*/4.0};
  const RayCostScene fine{/*traversal_cost=*/40.0, /*objects_per_leaf=*/16.0};

  const RayCost solved = solve_ray_cost(
      {{{coarse, truth.seconds_per_ray(coarse)}, {fine, truth.seconds_per_ray(fine)}}});

  EXPECT_NEAR(solved.leaf_seconds, truth.leaf_seconds, 1e-14);
  EXPECT_NEAR(solved.object_seconds, truth.object_seconds, 1e-15);
}

TEST(RayCost, IsNeverNegative) {
  // More leaves and more objects in less time: no positive pair explains that.
  for (const double seconds_fine : {1e-9, 1e-7, 1e-5}) {
    for (const double objects_fine : {4.0, 8.0}) {
      const RayCost solved =
          solve_ray_cost({{{{5.0, 4.0}, 1e-7}, {{40.0, objects_fine}, seconds_fine}}});

      EXPECT_GE(solved.leaf_seconds, 0.0);
      EXPECT_GE(solved.object_seconds, 0.0);
      EXPECT_GT(solved.leaf_seconds + solved.object_seconds, 0.0);
    }
  }
}

TEST(RayCost, IsMeasuredOnTheRendererItself) {
  for (const unsigned threads : {1U, 2U}) {
    const auto samples = measure_ray_cost(threads);

    ASSERT_TRUE(samples.has_value()) << samples.error().message;
    for (const RayCostSample& sample : *samples) {
      std::printf("%u threads: C_t %.2f, m %.2f, %.0f ns a ray\n", threads,
                  sample.scene.traversal_cost, sample.scene.objects_per_leaf,
                  sample.seconds_per_ray * 1e9);
      EXPECT_GT(sample.scene.traversal_cost, 0.0);
      EXPECT_GT(sample.scene.objects_per_leaf, 0.0);
      EXPECT_GT(sample.seconds_per_ray, 0.0);
    }
    // The fine scene is the larger one in what the formula reads.
    EXPECT_GT((*samples)[1].scene.traversal_cost * (*samples)[1].scene.objects_per_leaf,
              (*samples)[0].scene.traversal_cost * (*samples)[0].scene.objects_per_leaf);
    const RayCost cost = solve_ray_cost(*samples);
    for (const RayCostSample& sample : *samples) {
      EXPECT_GT(cost.seconds_per_ray(sample.scene), 0.0);
    }
  }
}

}  // namespace
}  // namespace preheat
