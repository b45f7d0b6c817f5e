// What a hit filter and shading need of triangles, hot or cold.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "common/packed_indices.h"
#include "common/path.h"
#include "common/vec3.h"

namespace preheat {

// The spans stay valid and in place as long as whoever holds the triangles.
struct MeshArrays {
  std::span<const float> positions{};          // [vertex_count * 3], 4 readable bytes behind
  std::span<const std::uint32_t> normals{};    // [vertex_count] or empty
  PackedIndices indices{};                     // [triangle_count * 3]
  std::span<const std::uint16_t> materials{};  // [triangle_count]
  std::span<const std::uint32_t> triangles{};  // [triangle_count] global ids
};

[[nodiscard]] inline Vec3 vertex_at(const MeshArrays& arrays, std::uint32_t primitive,
                                    unsigned corner) {
  const std::size_t vertex = arrays.indices[std::size_t{primitive} * 3 + corner];
  return {arrays.positions[vertex * 3], arrays.positions[vertex * 3 + 1],
          arrays.positions[vertex * 3 + 2]};
}

// What shading needs of a hit at `t` with the barycentric coordinates u and v of Embree.
[[nodiscard]] SurfaceHit surface_of(const MeshArrays& arrays, std::uint32_t primitive, float t,
                                    float u, float v);

}  // namespace preheat
