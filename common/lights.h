// The scene's lights, and how one of them is chosen and sampled for a point.
//
// One light is chosen with a probability proportional to its power: emissive triangles (both sides
// where they emit on both), punctual lights, and the constant environment, which gets at most
// kEnvironmentProbabilityMax where there are other lights, as rays that scatter find it anyway.
// What is not in the scene is not in the table. Read-only once built.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/bsdf.h"
#include "common/scene.h"
#include "common/scene_tables.h"
#include "common/vec3.h"

namespace preheat {

inline constexpr float kEnvironmentProbabilityMax = 0.5F;

// A choice among indices with given weights. The 2^32 values of a random number are dealt out to
// the entries, and an entry's probability is its share of them, so it is exact; an entry with a
// positive weight has at least one value. Increasing numbers give non-decreasing indices, so
// stratified numbers give stratified choices. Finds an entry in constant expected time by a guide
// table.
class DiscreteChoice {
 public:
  DiscreteChoice() = default;
  // Weights finite and >= 0; not all 0; fewer than 2^31.
  explicit DiscreteChoice(std::span<const double> weights);

  [[nodiscard]] bool empty() const { return ends_.empty(); }
  [[nodiscard]] std::uint32_t choose(std::uint32_t u) const;
  [[nodiscard]] float probability(std::uint32_t index) const;

 private:
  std::vector<std::uint64_t> ends_{};   // [count] cumulative, the last is 2^32
  std::vector<std::uint32_t> guide_{};  // [2^k] first entry that ends beyond i << guide_shift_
  unsigned guide_shift_ = 32;
};

// Where a light is seen from a point, before visibility.
struct LightSample {
  Vec3 direction{0.0F};  // unit, from the surface
  // Where a shadow ray ends: lifted off the light's surface by its rounding, so that the ray does
  // not meet it. Unused where the light is infinitely far away.
  Vec3 point{0.0F};
  float position_error = 0.0F;  // bound on each coordinate of `point`, the lifting included
  bool infinitely_far = false;
  Vec3 radiance{0.0F};           // radiance, or irradiance at normal incidence of a punctual light
  float pdf_solid_angle = 0.0F;  // 0: this light does not reach here; punctual: the choice's own
  bool punctual = false;         // no scattered ray can find it
};

class Lights {
 public:
  Lights(const SceneTables& tables, std::span<const PreparedMaterial> materials, const Vec3& sky);

  [[nodiscard]] bool empty() const { return choice_.empty(); }
  // A ray can meet one: a triangle or the sky.
  [[nodiscard]] bool emission_can_be_met() const { return emission_can_be_met_; }
  [[nodiscard]] const Vec3& sky() const { return sky_; }

  // Chooses a light by `u_choice` and a point on it by `u`, as seen from `position` with the unit
  // normal `normal` towards the viewer.
  [[nodiscard]] LightSample sample(const Vec3& position, const Vec3& normal, std::uint32_t u_choice,
                                   const RandomPair& u) const;

  // The density [1/sr] with which sample() at `from` would have found the point of `triangle` at
  // this distance, seen under |cos|; 0 if the triangle is no light.
  [[nodiscard]] float pdf_triangle(std::uint32_t triangle, float distance, float cos_light) const;

  // The same for the environment in a direction under this cosine to `normal`.
  [[nodiscard]] float pdf_sky(float cos_normal) const;

 private:
  struct TriangleLight {
    Vec3 corner{0.0F};
    Vec3 edge_1{0.0F};
    Vec3 edge_2{0.0F};
    Vec3 normal{0.0F};
    Vec3 emission{0.0F};
    float area = 0.0F;
    float position_error = 0.0F;  // of a sampled point, each coordinate
    bool double_sided = false;
  };

  [[nodiscard]] LightSample sample_triangle(const TriangleLight& light, const Vec3& position,
                                            const RandomPair& u) const;
  [[nodiscard]] LightSample sample_punctual(const PunctualLight& light, const Vec3& position) const;
  [[nodiscard]] LightSample sample_sky(const Vec3& normal, const RandomPair& u) const;

  // Indices of the choice: triangles, then punctual lights, then the sky.
  std::vector<TriangleLight> triangles_{};
  std::vector<std::uint32_t> triangle_ids_{};  // [triangles_.size()], increasing
  std::vector<PunctualLight> punctual_{};
  Vec3 sky_{0.0F};
  DiscreteChoice choice_{};
  float sky_probability_ = 0.0F;
  bool emission_can_be_met_ = false;
};

// Of a spot light: 1 inside the inner cone, 0 outside the outer one (KHR_lights_punctual).
[[nodiscard]] float spot_factor(const PunctualLight& light, float cos_axis);

// Of a light of limited range: KHR_lights_punctual's window without the inverse square.
[[nodiscard]] float range_factor(float range, float distance);

}  // namespace preheat
