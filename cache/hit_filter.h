// Which hits of a ray count and which of them is the nearest, whatever the layout of the BVH that
// reports them: the lowest (t, global triangle id) among all candidates.
//
// Whoever traces keeps the candidates' window a little open behind the best hit, as an acceleration
// structure may skip a triangle whose box begins a rounding error behind it.
#pragma once

#include <cstdint>

#include "cache/mesh_arrays.h"
#include "common/ray.h"
#include "common/vec3.h"

namespace preheat {

inline constexpr std::uint32_t kNoTriangle = UINT32_MAX;

// The window: 16 ulp of t for the rounding of t itself, and 2^-21 scene units for that of
// coordinates of magnitude 1.
inline constexpr float kWindowRelative = 1.9073486328125e-06F;
inline constexpr float kWindowAbsolute = 4.76837158203125e-07F;

[[nodiscard]] inline float widened(float t) {
  return t * (1.0F + kWindowRelative) + kWindowAbsolute;
}

// A search along one ray for its nearest hit, or for any.
struct HitSearch {
  explicit HitSearch(const Ray& searched);  // which outlives this

  // Keeps the hit at t with the barycentric coordinates u and v if it counts and is the lowest.
  // Returns how far candidates may lie from now on. `mesh` outlives the search.
  float keep_lowest(const MeshArrays& mesh, std::uint32_t triangle_in_mesh, float t, float hit_u,
                    float hit_v);

  // Whether a hit at t counts.
  [[nodiscard]] bool counts(const MeshArrays& mesh, std::uint32_t triangle_in_mesh, float t) const;

  const Ray& ray;
  float t_best = kInfinity;
  std::uint32_t triangle_before = kNoTriangle;  // of t_best while `arrays` is nullptr
  unsigned parallel_axes = 0;  // bit i: the ray runs (almost) parallel to the faces of axis i
  Vec3 reciprocal;             // of the direction on the other axes
  // The best hit's place.
  const MeshArrays* arrays = nullptr;
  std::uint32_t primitive = 0;
  float u = 0.0F;
  float v = 0.0F;
};

}  // namespace preheat
