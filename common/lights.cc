#include "common/lights.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "common/check.h"
#include "common/math.h"
#include "common/ray_offset.h"

namespace preheat {

DiscreteChoice::DiscreteChoice(std::span<const double> weights) {
  constexpr std::uint64_t kValues = std::uint64_t{1} << 32U;
  double sum = 0.0;
  std::uint64_t positive = 0;
  for (const double weight : weights) {
    sum += weight;
    positive += weight > 0.0 ? 1U : 0U;
  }
  CHECK(sum > 0.0 && std::isfinite(sum) && weights.size() < (std::size_t{1} << 31U));

  // One value for each positive weight, the others in proportion.
  const double spare = static_cast<double>(kValues - positive);
  double before = 0.0;
  std::uint64_t positive_before = 0;
  std::size_t last_positive = 0;
  ends_.reserve(weights.size());
  for (const double weight : weights) {
    before += weight;
    if (weight > 0.0) {
      ++positive_before;
      last_positive = ends_.size();
    }
    ends_.push_back(positive_before + static_cast<std::uint64_t>(before / sum * spare));
  }
  for (std::size_t i = last_positive; i < ends_.size(); ++i) { ends_[i] = kValues; }

  const std::size_t guide_size = std::bit_ceil(weights.size());
  guide_shift_ = 32U - static_cast<unsigned>(std::countr_zero(guide_size));
  guide_.reserve(guide_size);
  std::uint32_t entry = 0;
  for (std::size_t i = 0; i < guide_size; ++i) {
    while (ends_[entry] <= static_cast<std::uint64_t>(i) << guide_shift_) { ++entry; }
    guide_.push_back(entry);
  }
}

std::uint32_t DiscreteChoice::choose(std::uint32_t u) const {
  std::uint32_t entry = guide_[static_cast<std::uint64_t>(u) >> guide_shift_];
  while (ends_[entry] <= u) { ++entry; }
  return entry;
}

float DiscreteChoice::probability(std::uint32_t index) const {
  const std::uint64_t begin = index == 0 ? 0 : ends_[index - 1];
  return static_cast<float>(static_cast<double>(ends_[index] - begin) * 0x1p-32);
}

float spot_factor(const PunctualLight& light, float cos_axis) {
  const float width = std::max(1e-3F, light.cos_inner - light.cos_outer);
  const float ramp = std::clamp((cos_axis - light.cos_outer) / width, 0.0F, 1.0F);
  return ramp * ramp;
}

float range_factor(float range, float distance) {
  if (!(range > 0.0F)) { return 1.0F; }
  const float ratio = distance / range;
  const float ratio_squared = ratio * ratio;
  return std::clamp(1.0F - ratio_squared * ratio_squared, 0.0F, 1.0F);
}

namespace {

// Radiant power up to the common factor pi, in a scene of unit radius.
double power(const PunctualLight& light) {
  const double intensity = std::max(0.0, luminance(light.intensity));
  if (light.kind == PunctualLightKind::kPoint) { return 4.0 * intensity; }
  if (light.kind == PunctualLightKind::kDirectional) { return intensity; }
  const double cos_mean =
      0.5 * (static_cast<double>(light.cos_inner) + static_cast<double>(light.cos_outer));
  return 2.0 * intensity * std::max(0.0, 1.0 - cos_mean);
}

double sky_power(const Vec3& sky, double others) {
  const double whole = 4.0 * kPiDouble * luminance(sky);
  constexpr double kShare = static_cast<double>(kEnvironmentProbabilityMax);
  return others > 0.0 ? std::min(whole, others * kShare / (1.0 - kShare)) : whole;
}

}  // namespace

Lights::Lights(const SceneTables& tables, std::span<const PreparedMaterial> materials,
               const Vec3& sky)
    : sky_(glm::max(sky, Vec3(0.0F))) {
  const std::size_t emitter_count = tables.emissive_triangles.size();
  std::vector<double> weights;
  weights.reserve(emitter_count + tables.lights.size() + 1);
  triangles_.reserve(emitter_count);
  triangle_ids_.reserve(emitter_count);
  double sum = 0.0;
  const auto add_weight = [&](double weight) {
    weights.push_back(std::isfinite(weight) ? weight : 0.0);
    sum += weights.back();
  };
  for (const EmissiveTriangle& emitter : tables.emissive_triangles) {
    const PreparedMaterial& material = materials[emitter.material];
    TriangleLight light;
    light.corner = emitter.vertices[0];
    light.edge_1 = emitter.vertices[1] - emitter.vertices[0];
    light.edge_2 = emitter.vertices[2] - emitter.vertices[0];
    const Vec3d cross = glm::cross(Vec3d(light.edge_1), Vec3d(light.edge_2));
    const double twice_area = std::sqrt(glm::dot(cross, cross));
    emission_can_be_met_ |= material.emission != Vec3(0.0F);
    light.area = static_cast<float>(0.5 * twice_area);
    // An area that a float cannot hold gives no usable density; such a triangle is met by rays
    // only.
    if (!(light.area >= std::numeric_limits<float>::min())) { continue; }
    light.normal = Vec3(cross / twice_area);
    // Three products and their sum: at most five roundings of terms this large (pbrt-v4
    // section 6.8.1).
    light.position_error =
        max_component(glm::abs(light.corner) + glm::abs(light.edge_1) + glm::abs(light.edge_2)) *
        kPointRounding;
    light.emission = material.emission;
    light.double_sided = material.double_sided;
    const double sides = light.double_sided ? 2.0 : 1.0;
    triangles_.push_back(light);
    triangle_ids_.push_back(emitter.triangle);
    add_weight(luminance(light.emission) * 0.5 * twice_area * sides);
  }
  for (const PunctualLight& light : tables.lights) {
    punctual_.push_back(light);
    add_weight(power(light));
  }
  const double others = sum;
  if (sky_ != Vec3(0.0F)) {
    emission_can_be_met_ = true;
    add_weight(sky_power(sky_, others));
  }
  if (sum > 0.0) { choice_ = DiscreteChoice(weights); }
  if (sky_ != Vec3(0.0F) && !choice_.empty()) {
    sky_probability_ = choice_.probability(static_cast<std::uint32_t>(weights.size() - 1));
  }
}

LightSample Lights::sample(const Vec3& position, const Vec3& normal, std::uint32_t u_choice,
                           const RandomPair& u) const {
  const std::uint32_t index = choice_.choose(u_choice);
  const float probability = choice_.probability(index);
  LightSample sample;
  if (index < triangles_.size()) {
    sample = sample_triangle(triangles_[index], position, u);
  } else if (index - triangles_.size() < punctual_.size()) {
    sample = sample_punctual(punctual_[index - triangles_.size()], position);
  } else {
    sample = sample_sky(normal, u);
  }
  sample.pdf_solid_angle *= probability;
  return sample;
}

LightSample Lights::sample_triangle(const TriangleLight& light, const Vec3& position,
                                    const RandomPair& u) const {
  // Uniform barycentrics by folding the square along its diagonal (Heitz 2019).
  const float x = u.x();
  const float y = u.y();
  const float b1 = x < y ? 0.5F * x : x - 0.5F * y;
  const float b2 = x < y ? y - 0.5F * x : 0.5F * y;
  LightSample sample;
  const Vec3 point = light.corner + light.edge_1 * b1 + light.edge_2 * b2;
  const Vec3 to_light = point - position;
  const float distance_squared = glm::dot(to_light, to_light);
  if (!(distance_squared > 0.0F)) { return {}; }
  sample.direction = to_light * (1.0F / std::sqrt(distance_squared));
  const float cos_light = -glm::dot(light.normal, sample.direction);
  if (cos_light == 0.0F || (cos_light < 0.0F && !light.double_sided)) { return {}; }
  sample.point = offset_origin(point, light.position_error, light.normal, -sample.direction);
  sample.position_error = 3.0F * light.position_error;  // its own, the lifting and one rounding
  sample.radiance = light.emission;
  sample.pdf_solid_angle = distance_squared / (std::abs(cos_light) * light.area);
  return sample;
}

LightSample Lights::sample_punctual(const PunctualLight& light, const Vec3& position) const {
  LightSample sample;
  sample.punctual = true;
  sample.pdf_solid_angle = 1.0F;
  if (light.kind == PunctualLightKind::kDirectional) {
    sample.direction = -light.direction;
    sample.infinitely_far = true;
    sample.radiance = light.intensity;
    return sample;
  }
  const Vec3 to_light = light.position - position;
  const float distance_squared = glm::dot(to_light, to_light);
  if (!(distance_squared > 0.0F)) { return {}; }
  const float distance = std::sqrt(distance_squared);
  sample.point = light.position;
  sample.direction = to_light * (1.0F / distance);
  float factor = range_factor(light.range, distance);
  if (light.kind == PunctualLightKind::kSpot) {
    factor *= spot_factor(light, -glm::dot(light.direction, sample.direction));
  }
  sample.radiance = light.intensity * (factor / distance_squared);
  return sample;
}

LightSample Lights::sample_sky(const Vec3& normal, const RandomPair& u) const {
  const Vec3 local = cosine_direction(u.x(), u.y());
  LightSample sample;
  sample.direction = OrthonormalFrame(normal).scene_from_local(local);
  sample.infinitely_far = true;
  sample.radiance = sky_;
  sample.pdf_solid_angle = local.z * kInversePi;
  return sample;
}

float Lights::pdf_triangle(std::uint32_t triangle, float distance, float cos_light) const {
  if (choice_.empty()) { return 0.0F; }
  const auto found = std::lower_bound(triangle_ids_.begin(), triangle_ids_.end(), triangle);
  if (found == triangle_ids_.end() || *found != triangle || !(cos_light > 0.0F)) { return 0.0F; }
  const auto index = static_cast<std::uint32_t>(found - triangle_ids_.begin());
  return choice_.probability(index) * distance * distance / (cos_light * triangles_[index].area);
}

float Lights::pdf_sky(float cos_normal) const {
  return cos_normal > 0.0F ? sky_probability_ * cos_normal * kInversePi : 0.0F;
}

}  // namespace preheat
