// Where a ray that leaves a surface starts: off the surface by as much as the point may be wrong.
#pragma once

#include "common/math.h"
#include "common/vec3.h"

namespace preheat {

// Bound on a coordinate's error, relative to the sum of the magnitudes of the three corners'
// weighted coordinates, of a point on a triangle by interpolation: gamma(7) of pbrt-v4
// section 6.8.1, rounded up to a power of two.
inline constexpr float kPointRounding = 0x1p-21F;

// The point moved along the unit normal to the side that `direction` leaves for, out of the box of
// half width `error` that holds the true point, and then by one rounding more (pbrt-v4 section
// 6.8.6). No constant length is involved: scaling a scene by a power of two scales the result and
// changes no other bit.
[[nodiscard]] inline Vec3 offset_origin(const Vec3& point, float error, const Vec3& normal,
                                        const Vec3& direction) {
  const float reach = error * (std::abs(normal.x) + std::abs(normal.y) + std::abs(normal.z));
  const Vec3 offset = normal * (glm::dot(normal, direction) < 0.0F ? -reach : reach);
  const Vec3 moved = point + offset;
  return {next_float_towards(moved.x, offset.x), next_float_towards(moved.y, offset.y),
          next_float_towards(moved.z, offset.z)};
}

}  // namespace preheat
