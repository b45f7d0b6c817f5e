// A ray: points origin + t * direction for t in [t_min, t_max]. Directions have unit length up to
// rounding, so t is a distance in scene units.
#pragma once

#include <limits>

#include "common/vec3.h"

namespace preheat {

inline constexpr float kInfinity = std::numeric_limits<float>::infinity();

struct Ray {
  Vec3 origin{0.0F};
  Vec3 direction{0.0F};
  float t_min = 0.0F;
  float t_max = kInfinity;
};

}  // namespace preheat
