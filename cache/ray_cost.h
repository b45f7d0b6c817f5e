// Seconds that a ray takes on this machine, after [P] section 2: C_ray = alpha C_t + beta m C_t.
//
// [P] takes C_t, the leaves that a ray traverses, from rays that come from everywhere, and an
// octree is what it traverses. Here a frame's own rays are known from the prediction, and they
// descend binary trees, about log2(1 + T) levels in a voxel of T triangles:
//   C_ray = gamma + delta L,  L = sum over voxels of rays(v) log2(1 + T(v)) / rays,
// where gamma is what a ray costs that enters no voxel. Both are multiples of the time that a ray
// takes in two rooms made up on the spot and traced by the renderer of the workers: that time is
// all that is measured, and all that depends on the machine. Over 28 scenes of 2 to 2.4 million
// triangles, each forecast from the others, [P]'s form with the same calibration is wrong by a
// factor of e^0.42 (root mean square), this by e^0.15; the rooms themselves are timed to 6 %.
#pragma once

#include "cache/prediction.h"
#include "common/result.h"
#include "common/scene_tables.h"

namespace preheat {

// Relative standard error of seconds_per_ray(), where the prediction of rays is right.
inline constexpr double kRayCostError = 0.16;

// L; 0 where no rays are expected.
[[nodiscard]] double levels_per_ray(const SceneTables& tables, const Prediction& prediction);

// Where everything is hot. `room_seconds` is what measure_room_ray() returns.
[[nodiscard]] double seconds_per_ray(double room_seconds, double levels);

// Renders the rooms with so many threads, which share the rays: mean seconds of the clock for a
// ray. Takes well under a second and keeps nothing. An error if the renderer fails.
[[nodiscard]] Result<double> measure_room_ray(unsigned threads);

}  // namespace preheat
