// The part of a triangle inside a box.
#pragma once

#include <array>
#include <cstddef>
#include <span>

#include "common/aabb.h"
#include "common/vec3.h"

namespace preheat {

struct ClippedTriangle {
  static constexpr std::size_t kVerticesMax = 3 + 6;  // each plane adds at most one

  std::array<Vec3d, kVerticesMax> corners{};
  std::size_t count = 0;  // 0: nothing is left; below 3: a point or an edge

  [[nodiscard]] std::span<const Vec3d> vertices() const { return {corners.data(), count}; }
};

// Clips to the box's six planes in turn (Sutherland and Hodgman 1974), the closed box: what touches
// it stays. A vertex that a plane adds lies in that plane exactly.
[[nodiscard]] ClippedTriangle clip_to_box(const std::array<Vec3d, 3>& triangle, const Aabb& box);

}  // namespace preheat
