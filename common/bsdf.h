// How surfaces scatter: a material prepared for sampling, and its scattering function at one point.
//
// Model, by share:
//   metallic                    GGX with Schlick's Fresnel term from the base colour, and what
//                               single scattering on the microfacets loses (Kulla and Conty 2017).
//   dielectric, opaque          GGX coat with Schlick's Fresnel term from `ior`, tinted by
//                               `specular_color`, over a Lambertian base that gets exactly what the
//                               coat's albedo leaves: base (1 - E(wo)) (1 - E(wi)) / (pi (1 -
//                               E_mean)). specular_color = 0 is pure Lambert.
//   dielectric, transmitting    exact Fresnel equations; GGX microfacets (Walter et al. 2007),
//   without
//                               multiple scattering between them. What is not reflected is
//                               transmitted, tinted by the base colour at each crossing.
//     thin wall                 a sheet with two parallel faces: reflects 2R/(1+R), all
//                               interreflections counted, and transmits the rest straight on;
//                               rough: the reflection's lobe mirrored through the sheet.
//     solid                     refracts; outside is the side of the geometric normal.
// Roughness 0 is a mirror (a delta lobe); above that GGX's alpha is at least kAlphaMin.
// A solid whose index is within kIndexStepMin of 1 bends nothing and is a delta lobe at any
// roughness. Both sides of any surface scatter: back-face culling is a rule for rasterisers, and
// the walls of a closed room have to block light whichever way they are wound.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "common/rng.h"
#include "common/scene.h"
#include "common/vec3.h"

namespace preheat {

// Below this a lobe is narrower than single precision can sample and evaluate alike.
inline constexpr float kAlphaMin = 1e-3F;
inline constexpr float kIndexStepMin = 1e-4F;

// Directional albedo of GGX reflection with Schlick's Fresnel term r0 + (r90 - r0)(1 - cos)^5 is
// r0 (total - grazing) + r90 grazing.
struct MicrofacetAlbedo {
  float total = 1.0F;
  float grazing = 0.0F;
};

// The albedo of one roughness as a function of the cosine, tabulated over its square root, where it
// is smooth; linear between nodes.
class MicrofacetAlbedoTable {
 public:
  MicrofacetAlbedoTable(float alpha, int strata);
  [[nodiscard]] MicrofacetAlbedo at(float cos_normal) const;
  // Mean over the hemisphere, weighted by the cosine, of the interpolant itself.
  [[nodiscard]] MicrofacetAlbedo mean() const { return mean_; }

 private:
  static constexpr std::size_t kNodes = 33;
  std::array<MicrofacetAlbedo, kNodes> nodes_{};
  MicrofacetAlbedo mean_{};
};

// A material with everything that does not depend on directions worked out.
struct PreparedMaterial {
  Vec3 emission{0.0F};
  bool double_sided = true;

  // Opaque share.
  Vec3 specular_r0{0.0F};  // reflectance of a facing and of a grazing microfacet
  Vec3 specular_r90{0.0F};
  float alpha = 0.0F;    // 0 = mirror
  Vec3 base{0.0F};       // factor of the Lambertian lobe under the coat [1/sr]
  float coat_r0 = 0.0F;  // of the coat alone, the largest of its components
  float coat_r90 = 0.0F;
  Vec3 metal_rest{0.0F};     // factor of the lobe of multiply scattered light [1/sr]
  float base_albedo = 0.0F;  // mean over colours, where the coat takes nothing at the viewer's side
  float rest_albedo = 0.0F;
  // Null where alpha is 0 or nothing is specular; shared by the materials of one roughness.
  std::shared_ptr<const MicrofacetAlbedoTable> albedo{};

  // Transmitting share.
  float glass = 0.0F;  // its weight
  Vec3 glass_reflect{1.0F};
  Vec3 glass_transmit{1.0F};
  float ior = 1.5F;
  bool thin_walled = true;

  [[nodiscard]] bool has_specular() const { return specular_r90 != Vec3(0.0F); }
};

// Strata a side of the integrals behind the albedo tables. A table for a render takes about a
// millisecond; a coarse one, within 0.02 of it, a sixteenth of that.
inline constexpr int kAlbedoStrata = 32;
inline constexpr int kAlbedoStrataCoarse = 8;

[[nodiscard]] std::vector<PreparedMaterial> prepare_materials(std::span<const Material> materials,
                                                              int strata = kAlbedoStrata);

// Value times |cos| of the direction, and the density with which sample() draws it.
struct BsdfValue {
  Vec3 value_cos{0.0F};
  float pdf_solid_angle = 0.0F;
};

struct BsdfSample {
  Vec3 direction{0.0F};          // zero: the path ends here
  Vec3 weight{0.0F};             // value * |cos| / density
  float pdf_solid_angle = 0.0F;  // 0: a delta lobe
  // The square of the index that the ray travels in, as far as this surface knows it.
  float index_squared = 1.0F;
};

// How often each lobe is sampled; they add up to 1, or to 0 where nothing scatters.
struct LobeProbabilities {
  float specular = 0.0F;
  float diffuse = 0.0F;
  float glass = 0.0F;
};

// The scattering function at a point seen from one direction. Directions are unit, point away from
// the surface and are local: +z is the shading normal on the viewer's side.
class Bsdf {
 public:
  // `front`: seen from the side of the geometric normal. Requires: out.z > 0. The material must
  // outlive this.
  Bsdf(const PreparedMaterial& material, const Vec3& out, bool front);

  // The order of the lobes along sample()'s `u_lobe`.
  [[nodiscard]] LobeProbabilities probabilities() const {
    return {probability_specular_, probability_diffuse_, probability_glass_};
  }
  [[nodiscard]] const Vec3& out() const { return out_; }

  // Only delta lobes: a shadow ray could not contribute.
  [[nodiscard]] bool is_delta() const;

  // Delta lobes evaluate to zero.
  [[nodiscard]] BsdfValue evaluate(const Vec3& in) const;

  [[nodiscard]] BsdfSample sample(float u_lobe, const RandomPair& u_direction) const;

 private:
  struct GlassShares {
    Vec3 reflect{0.0F};
    Vec3 transmit{0.0F};
    float reflect_probability = 0.0F;
  };

  [[nodiscard]] bool specular_is_delta() const { return material_.alpha == 0.0F; }
  [[nodiscard]] bool glass_is_delta() const;
  [[nodiscard]] GlassShares glass_shares(float cos_facet) const;
  void add_specular(const Vec3& in, BsdfValue& value) const;
  void add_diffuse(const Vec3& in, BsdfValue& value) const;
  void add_glass_reflection(const Vec3& in, BsdfValue& value) const;
  void add_glass_sheet(const Vec3& in, BsdfValue& value) const;
  void add_glass_refraction(const Vec3& in, BsdfValue& value) const;
  [[nodiscard]] Vec3 sample_direction_glass(float u_side, const RandomPair& u) const;
  [[nodiscard]] BsdfSample sample_glass_delta(float u_side) const;
  [[nodiscard]] float index_squared(bool transmitted) const;

  const PreparedMaterial& material_;
  Vec3 out_;
  bool front_;
  float eta_;  // index on the far side over index on the viewer's
  float probability_specular_ = 0.0F;
  float probability_diffuse_ = 0.0F;
  float probability_glass_ = 0.0F;
  float coat_leaves_ = 1.0F;   // 1 - E(out) of the coat
  float metal_leaves_ = 0.0F;  // 1 - E(out) of the microfacets
};

}  // namespace preheat
