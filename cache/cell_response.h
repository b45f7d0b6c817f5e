// What leaves a cell when rays come in: the distribution of outgoing rays of [P] sections 4 and 5.
//
// How the sentences of [P] are read:
// - "Each object in the voxel is tested in turn": every object answers, each for its share of the
//   incoming rays. The paper counts all of them for every object; here the shares add up to one, in
//   proportion to the area that an object shows to the rays, so that a ray is one ray however
//   finely its surface is cut into triangles.
// - How many rays follow from one: what the renderer traces (common/path_rules.h), one scattered
//   ray, and one shadow ray to a light chosen by power, where the material is not all mirrors. So
//   the "shadow rays" of the paper, one to each light, become one that is spread over the lights.
// - "Specular reflection and refraction": the renderer's own scattering functions (common/bsdf.h)
//   say how often each happens and where it goes. Mirrors and coats send one ray, rough metals a
//   few, stratified, and glass some that reflect and some that pass.
// - "Diffuse reflection": as a cosine lobe over the bins on the viewer's side of the surface.
// - All objects lie in the cell's centre: lights are looked at from there. A shadow ray to a light
//   inside the cell stays in it, and half of the surfaces face that light. The light of the sky is
//   a cosine lobe too, as the renderer samples it.
// What the scene lacks does not exist here: no lights, no shadow rays; no bounce left, no rays.
// Threads: immutable; any thread may respond, each with its own `Scratch`.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "cache/cell_surfaces.h"
#include "cache/direction_bins.h"
#include "common/bsdf.h"
#include "common/lights.h"
#include "common/render_settings.h"
#include "common/scene_tables.h"

namespace preheat {

struct IncomingRays {
  Vec3 direction{0.0F};  // the way they travel, unit
  double rays = 0.0;
};

// The lights as one cell sees them: shares of a shadow ray, which add up to one less what reaches
// no light at all.
struct CellLights {
  struct Towards {
    Vec3 direction{0.0F};  // unit, a bin's mean
    std::uint32_t bin = 0;
    double share = 0.0;
  };
  std::vector<Towards> outside{};
  double inside = 0.0;
  double sky = 0.0;
};

struct CellContent {
  std::vector<SurfaceGroup> surfaces{};
  CellLights lights{};
};

// Of one cell, after one step.
struct OutgoingRays {
  std::span<double> scatter{};  // [bins]
  std::span<double> shadow{};   // [bins]
  double shadow_inside = 0.0;   // that end at lights in the cell itself
  // What is left of a path's light on its way, for Russian roulette: a mean over `scatter`.
  double throughput = 1.0;
};

class CellResponse {
 public:
  CellResponse(const SceneTables& tables, const RenderSettings& settings,
               const DirectionBins& bins);

  // `number` tells cells apart, so that not all look at the same points of a large light.
  [[nodiscard]] CellLights look_at_lights(const Aabb& cell, std::uint32_t number) const;

  struct Scratch {
    std::vector<double> lobes{};   // [2 * surfaces] rays that scatter diffusely, by side
    std::vector<double> lit{};     // [2 * surfaces] vertices that sample a light, by side
    std::vector<double> shares{};  // [surfaces]
  };

  // Adds to `outgoing`, whose arrays are zero before, what rays leave after `bounce` earlier
  // scattering events, with `throughput` left.
  void respond(const CellContent& cell, std::span<const IncomingRays> incoming,
               std::uint32_t bounce, double throughput, Scratch& scratch,
               OutgoingRays& outgoing) const;

 private:
  struct Vertex;

  void answer(const CellContent& cell, const IncomingRays& incoming, std::uint32_t bounce,
              double throughput, Scratch& scratch, OutgoingRays& outgoing,
              double& throughput_sum) const;
  // The lobes that are no cosine. As in the renderer, a ray whose direction is impossible ends.
  void add_lobes(const Vertex& vertex, double rays, OutgoingRays& outgoing) const;
  void add_direction(const Vertex& vertex, const Vec3& local, double rays,
                     OutgoingRays& outgoing) const;
  // A cosine lobe of `rays` around `normal`.
  void add_cosine(const Vec3& normal, double rays, std::span<double> bins) const;
  void add_shadows(const CellContent& cell, const Scratch& scratch, OutgoingRays& outgoing) const;

  const DirectionBins& bins_;
  std::uint32_t bounces_;
  std::vector<PreparedMaterial> materials_;
  std::vector<double> albedos_{};  // [materials] what a path keeps in its brightest colour
  Lights lights_;
};

}  // namespace preheat
