// An axis-aligned box [low, high], closed. A default box is empty: extending it by a point gives
// that point.
#pragma once

#include <algorithm>
#include <array>
#include <limits>

#include "common/ray.h"
#include "common/vec3.h"

namespace preheat {

struct Aabb {
  Vec3 low{std::numeric_limits<float>::infinity()};
  Vec3 high{-std::numeric_limits<float>::infinity()};

  [[nodiscard]] bool is_empty() const {
    return !(low.x <= high.x && low.y <= high.y && low.z <= high.z);
  }
  void extend(const Vec3& point) {
    for (int axis = 0; axis < 3; ++axis) {
      low[axis] = std::min(low[axis], point[axis]);
      high[axis] = std::max(high[axis], point[axis]);
    }
  }
  void extend(const Aabb& box) {
    for (int axis = 0; axis < 3; ++axis) {
      low[axis] = std::min(low[axis], box.low[axis]);
      high[axis] = std::max(high[axis], box.high[axis]);
    }
  }
  [[nodiscard]] Vec3 extent() const { return high - low; }
};

struct Interval {
  float t_enter = 0.0F;
  float t_exit = 0.0F;
  [[nodiscard]] bool is_empty() const { return !(t_enter <= t_exit); }
};

// The part of the ray inside the box, conservatively: the exit is moved outwards by the rounding of
// a slab test (pbrt-v4 section 6.1.2: 1 + 2 gamma(3)), so that no ray that touches the box is lost.
// A ray that lies in a slab's face has 0 * inf = NaN there, which the order of the arguments of min
// and max turns into "no constraint". Empty when the ray misses.
[[nodiscard]] inline Interval clip(const Ray& ray, const Aabb& box) {
  float enter = ray.t_min;
  float exit = ray.t_max;
  for (int axis = 0; axis < 3; ++axis) {
    const float reciprocal = 1.0F / ray.direction[axis];
    const float t_low = (box.low[axis] - ray.origin[axis]) * reciprocal;
    const float t_high = (box.high[axis] - ray.origin[axis]) * reciprocal;
    const float t_near = reciprocal < 0.0F ? t_high : t_low;
    const float t_far = (reciprocal < 0.0F ? t_low : t_high) * 1.00000036F;
    enter = enter < t_near ? t_near : enter;  // false for NaN: keeps the old bound
    exit = t_far < exit ? t_far : exit;
  }
  return {enter, exit};
}

}  // namespace preheat
