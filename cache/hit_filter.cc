#include "cache/hit_filter.h"

#include <immintrin.h>

#include <algorithm>
#include <cmath>
#include <optional>

#include "common/aabb.h"

namespace preheat {
namespace {

float half_widened(float t) { return t * (1.0F + 0.5F * kWindowRelative) + 0.5F * kWindowAbsolute; }

// Below this a direction's component is taken as parallel: over a scene's length such a ray leaves
// a face by less than the rounding of a coordinate.
constexpr float kParallelComponent = 9.5367431640625e-07F;

unsigned axes_parallel_to(const Vec3& direction) {
  unsigned axes = 0;
  for (int axis = 0; axis < 3; ++axis) {
    axes |= std::abs(direction[axis]) < kParallelComponent ? 1U << axis : 0U;
  }
  return axes;
}

// A ray that lies exactly in the far face of a box leaves it at t = 0 by Embree's slab test, and a
// hit of a triangle that touches this face is then found or not as the layout has it. So a hit
// counts only if the slab test of the triangle's own box admits it on the parallel axes: every box
// around the triangle then admits it too, as the test is monotone in the box.
bool own_box_admits(const HitSearch& search, const MeshArrays& arrays, std::uint32_t primitive,
                    float t) {
  constexpr float kReciprocalMax = 1e18F;  // Embree's bound on 1 / 0
  const Vec3 a = vertex_at(arrays, primitive, 0);
  const Vec3 b = vertex_at(arrays, primitive, 1);
  const Vec3 c = vertex_at(arrays, primitive, 2);
  for (int axis = 0; axis < 3; ++axis) {
    if ((search.parallel_axes >> axis & 1U) == 0) { continue; }
    const float direction = search.ray.direction[axis];
    const float reciprocal = std::min(1.0F / std::abs(direction), kReciprocalMax) *
                             (std::signbit(direction) ? -1.0F : 1.0F);
    const float origin = search.ray.origin[axis];
    const float t_low = (std::min({a[axis], b[axis], c[axis]}) - origin) * reciprocal;
    const float t_high = (std::max({a[axis], b[axis], c[axis]}) - origin) * reciprocal;
    if (!(std::min(t_low, t_high) <= t && t <= std::max(t_low, t_high))) { return false; }
  }
  return true;
}

// Where the ray enters and leaves the triangle's own box, by the axes that it is not parallel to.
Interval own_box_span(const HitSearch& search, const MeshArrays& arrays, std::uint32_t primitive) {
  const Vec3 a = vertex_at(arrays, primitive, 0);
  const Vec3 b = vertex_at(arrays, primitive, 1);
  const Vec3 c = vertex_at(arrays, primitive, 2);
  const Vec3 low = (glm::min(glm::min(a, b), c) - search.ray.origin) * search.reciprocal;
  const Vec3 high = (glm::max(glm::max(a, b), c) - search.ray.origin) * search.reciprocal;
  Interval span{-kInfinity, kInfinity};
  for (int axis = 0; axis < 3; ++axis) {
    if ((search.parallel_axes >> axis & 1U) != 0) { continue; }
    span.t_enter = std::max(span.t_enter, std::min(low[axis], high[axis]));
    span.t_exit = std::min(span.t_exit, std::max(low[axis], high[axis]));
  }
  return span;
}

// Of a slab test's exit, behind which an entry means a miss: its rounding (pbrt-v4 section 6.1.2: 1
// + 2 gamma(3)). Embree's robust boxes and voxel_kernel_body.h allow for twice as much and more.
constexpr float kSlabRounding = 1.00000036F;

// The t by which a hit is compared; nothing if it does not count. A triangle that a ray grazes or
// passes within its edge's rounding can be met where the ray is not in the triangle's own box, and
// whether larger boxes around it are entered in time is then the layout's choice. So a hit whose
// own box is missed or lies outside the ray's range does not count, and none is nearer than its
// box: whatever counts lies behind the entry of every box around it.
std::optional<float> settled(const HitSearch& search, const MeshArrays& arrays,
                             std::uint32_t primitive, float t) {
  if (search.parallel_axes != 0 && !own_box_admits(search, arrays, primitive, t)) {
    return std::nullopt;
  }
  const Interval span = own_box_span(search, arrays, primitive);
  const float nearest = span.t_enter > half_widened(t) ? span.t_enter : t;
  const Ray& ray = search.ray;
  if (span.t_enter > span.t_exit * kSlabRounding || nearest > ray.t_max ||
      span.t_enter > ray.t_max || span.t_exit < ray.t_min) {
    return std::nullopt;
  }
  return nearest;
}

// The best triangle so far. Looked up when needed, as its line is rarely at hand.
std::uint32_t best_triangle(const HitSearch& search) {
  return search.arrays == nullptr ? search.triangle_before
                                  : search.arrays->triangles[search.primitive];
}

bool is_lowest(const HitSearch& search, const MeshArrays& arrays, std::uint32_t primitive,
               float t) {
  const float t_best = search.t_best;
  return t < t_best || (t == t_best && arrays.triangles[primitive] < best_triangle(search));
}

}  // namespace

HitSearch::HitSearch(const Ray& searched)
    : ray(searched),
      parallel_axes(axes_parallel_to(searched.direction)),
      reciprocal(1.0F / searched.direction) {}

float HitSearch::keep_lowest(const MeshArrays& mesh, std::uint32_t triangle_in_mesh, float t,
                             float hit_u, float hit_v) {
  // What is settled is never nearer.
  if (is_lowest(*this, mesh, triangle_in_mesh, t)) {
    const std::optional<float> t_settled = settled(*this, mesh, triangle_in_mesh, t);
    if (t_settled && is_lowest(*this, mesh, triangle_in_mesh, *t_settled)) {
      t_best = *t_settled;
      arrays = &mesh;
      primitive = triangle_in_mesh;
      u = hit_u;
      v = hit_v;
      // They are likely to be asked for, and their lines are far.
      _mm_prefetch(&mesh.materials[primitive], _MM_HINT_T0);
      _mm_prefetch(&mesh.triangles[primitive], _MM_HINT_T0);
    }
  }
  return std::min(widened(t_best), ray.t_max);
}

bool HitSearch::counts(const MeshArrays& mesh, std::uint32_t triangle_in_mesh, float t) const {
  return settled(*this, mesh, triangle_in_mesh, t).has_value();
}

}  // namespace preheat
