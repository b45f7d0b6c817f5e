// One light path, advanced a vertex at a time: unidirectional path tracing with next-event
// estimation and multiple importance sampling (Veach 1997, power heuristic).
//
// Pure: no I/O, no clock, no state beside PathState. What a call returns is a function of its
// arguments alone and uses only + - * / sqrt and the polynomials of common/math.h, so every process
// computes the same bits. The caller traces the rays; shading never sees an octree, a voxel or a
// cache. Order per vertex: the caller resolves both rays of a ShadedVertex, in any order, then adds
// `direct` to PathState::radiance if the shadow ray is unblocked, and only then shades the next
// vertex; so radiance is summed in path order.
#pragma once

#include <cstdint>
#include <vector>

#include "common/bsdf.h"
#include "common/lights.h"
#include "common/ray.h"
#include "common/render_settings.h"
#include "common/rng.h"
#include "common/scene_tables.h"
#include "common/vec3.h"

namespace preheat {

// Where a ray met a surface. Filled from the voxel's block by the residency.
struct SurfaceHit {
  Vec3 position{0.0F};          // by barycentric interpolation, scene frame
  float position_error = 0.0F;  // bound on each coordinate's absolute error (pbrt-v4 section 6.8.1)
  Vec3 normal_geometric{0.0F};  // unit, by the winding
  Vec3 normal_shading{0.0F};    // unit, on the side of normal_geometric
  float distance = 0.0F;        // along the ray
  std::uint32_t triangle = 0;   // global triangle id
  std::uint32_t material = 0;
};

struct PathState {
  std::uint32_t pixel = 0;  // y * width + x
  std::uint32_t sample = 0;
  std::uint32_t bounce = 0;  // scattering events so far
  // Solid-angle density [1/sr] with which the current ray's direction was sampled; 0 where light
  // sampling could not have found it (camera rays, mirrors), so that its emission counts in full.
  float pdf_solid_angle = 0.0F;
  // The environment's share under multiple importance sampling, should the current ray meet
  // nothing.
  float sky_weight = 1.0F;
  Vec3 throughput{1.0F};
  Vec3 radiance{0.0F};
};

// What follows from a hit.
struct ShadedVertex {
  bool has_shadow_ray = false;
  bool has_scatter_ray = false;
  Ray shadow{};
  Vec3 direct{0.0F};  // added to radiance if `shadow` is unblocked
  Ray scatter{};
};

// Lights and materials ready to sample; read-only and shared by all threads.
class Shading {
 public:
  // Copies what it needs of the tables. Sampling tables exist only for the light classes present.
  Shading(const SceneTables& tables, const RenderSettings& settings,
          int albedo_strata = kAlbedoStrata);

  // The camera ray of a pixel's sample, and its fresh path.
  [[nodiscard]] Ray start_path(std::uint32_t pixel, std::uint32_t sample, PathState& path) const;

  // The path's ray left the scene.
  void shade_miss(const Ray& ray, PathState& path) const;

  // The path's ray met a surface: adds its emission, samples one light and one direction.
  [[nodiscard]] ShadedVertex shade_hit(const Ray& ray, const SurfaceHit& hit,
                                       PathState& path) const;

 private:
  void add_emission(const SurfaceHit& hit, const PreparedMaterial& material, float cos_geometric,
                    PathState& path) const;

  RenderSettings settings_;
  std::vector<PreparedMaterial> materials_;
  Lights lights_;
  Rng rng_;
};

}  // namespace preheat
