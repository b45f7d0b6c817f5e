// Cuts a polygon in space into triangles that keep its winding.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "common/vec3.h"

namespace preheat {

// Ear clipping takes time in the square of the vertices, and in the cube where someone tries.
inline constexpr std::size_t kConcavePolygonVerticesMax = 1024;

// Appends vertices.size() - 2 triangles of indices into `vertices`: a fan where the polygon is
// convex in the plane of its normal (Newell's), else ears. A polygon that crosses itself gives some
// triangles over its vertices. False, with nothing appended: concave with too many vertices.
// Requires: at least 3 vertices.
[[nodiscard]] bool triangulate_polygon(std::span<const Vec3d> vertices,
                                       std::vector<std::array<std::uint32_t, 3>>& triangles);

}  // namespace preheat
