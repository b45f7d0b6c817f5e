// Seconds that a ray takes on this machine: [P] section 2, C_ray = alpha C_t + beta m C_t.
//
// alpha and beta depend on the machine and the tracer alone, so two small scenes that are made up
// on the spot, and traced by the very renderer that the workers run, are enough to solve for both.
#pragma once

#include <array>

#include "common/result.h"

namespace preheat {

// What the formula knows of a scene: see OctreeStatistics.
struct RayCostScene {
  double traversal_cost = 0.0;    // C_t: leaves that a ray traverses
  double objects_per_leaf = 0.0;  // m: objects in each
};

struct RayCostSample {
  RayCostScene scene{};
  double seconds_per_ray = 0.0;  // measured, > 0
};

struct RayCost {
  double leaf_seconds = 0.0;    // alpha: traversing a leaf
  double object_seconds = 0.0;  // beta: an object of a leaf

  [[nodiscard]] double seconds_per_ray(const RayCostScene& scene) const {
    return scene.traversal_cost * (leaf_seconds + object_seconds * scene.objects_per_leaf);
  }
};

// The alpha and beta that explain both samples. Where that takes a negative one, because timings
// are noisy, it is 0 and the other is the one whose relative errors have the least squares.
// Requires: C_t, m and the seconds of both are positive.
[[nodiscard]] RayCost solve_ray_cost(const std::array<RayCostSample, 2>& samples);

// Renders the two scenes with so many threads, which share the rays: seconds are of the clock.
// Takes well under a second and keeps nothing. An error if the renderer fails.
[[nodiscard]] Result<std::array<RayCostSample, 2>> measure_ray_cost(unsigned threads);
[[nodiscard]] Result<RayCost> calibrate_ray_cost(unsigned threads);

}  // namespace preheat
