#include "common/bsdf.h"

#include <cmath>
#include <map>

#include "common/math.h"

namespace preheat {
namespace {

// Roughness is rounded to this many steps for the albedo tables, so that a scene with many
// materials builds a bounded number of them; the albedo changes by less than 3e-4 over half a step.
constexpr float kRoughnessSteps = 1024.0F;

float square(float x) { return x * x; }

float schlick_weight(float cos_facet) {
  const float rest = std::max(0.0F, 1.0F - cos_facet);
  return square(square(rest)) * rest;
}

Vec3 schlick(const Vec3& r0, const Vec3& r90, float cos_facet) {
  return r0 + (r90 - r0) * schlick_weight(cos_facet);
}

struct Fresnel {
  float reflectance = 1.0F;
  float cos_transmitted = 0.0F;  // 0 under total internal reflection
};

// Unpolarised light; `eta` = index on the far side over index on the near side.
Fresnel fresnel_dielectric(float cos_near, float eta) {
  if (eta == 1.0F) { return {0.0F, cos_near}; }
  const float sin_squared = std::max(0.0F, 1.0F - cos_near * cos_near) / (eta * eta);
  if (!(sin_squared < 1.0F)) { return {}; }
  const float cos_far = std::sqrt(1.0F - sin_squared);
  const float parallel = (eta * cos_near - cos_far) / (eta * cos_near + cos_far);
  const float perpendicular = (cos_near - eta * cos_far) / (cos_near + eta * cos_far);
  return {std::min(1.0F, 0.5F * (parallel * parallel + perpendicular * perpendicular)), cos_far};
}

// GGX (Trowbridge and Reitz). The form in x and y keeps its digits near the normal, where 1 - z^2
// would lose them.
float ggx_density(const Vec3& facet, float alpha) {
  const float a2 = alpha * alpha;
  const float t = (facet.x * facet.x + facet.y * facet.y) / a2 + facet.z * facet.z;
  return 1.0F / (kPi * a2 * t * t);
}

// Smith's auxiliary function: masking is 1 / (1 + lambda(out)), masking and shadowing
// 1 / (1 + lambda(out) + lambda(in)).
float ggx_lambda(const Vec3& w, float alpha) {
  const float tan_squared = (w.x * w.x + w.y * w.y) / (w.z * w.z);
  return 0.5F * (std::sqrt(1.0F + alpha * alpha * tan_squared) - 1.0F);
}

// A facet normal with the density of those visible from `out` (Dupuy and Benyoub 2023).
Vec3 sample_visible_facet(const Vec3& out, float alpha, float u, float v) {
  const Vec3 standard = glm::normalize(Vec3(out.x * alpha, out.y * alpha, out.z));
  const float z = (1.0F - v) * (1.0F + standard.z) - standard.z;
  const float sin_polar = std::sqrt(std::max(0.0F, 1.0F - z * z));
  const SinCos azimuth = sin_cos_turns(u);
  const Vec3 half = Vec3(sin_polar * azimuth.cos, sin_polar * azimuth.sin, z) + standard;
  return glm::normalize(Vec3(half.x * alpha, half.y * alpha, std::max(0.0F, half.z)));
}

Vec3 reflect(const Vec3& out, const Vec3& facet) {
  return facet * (2.0F * glm::dot(out, facet)) - out;
}

MicrofacetAlbedo albedo_at(const PreparedMaterial& material, float cos_normal) {
  if (material.albedo != nullptr) { return material.albedo->at(cos_normal); }
  return {1.0F, schlick_weight(cos_normal)};
}

MicrofacetAlbedo albedo_mean(const PreparedMaterial& material) {
  if (material.albedo != nullptr) { return material.albedo->mean(); }
  return {1.0F, 1.0F / 21.0F};
}

float coat_albedo(const PreparedMaterial& material, const MicrofacetAlbedo& albedo) {
  return material.coat_r0 * (albedo.total - albedo.grazing) + material.coat_r90 * albedo.grazing;
}

// What facets reflect of light from `out`. Half a turn of azimuths is enough by symmetry; the polar
// strata crowd where facets are steep, as all that a smooth surface loses is lost there.
MicrofacetAlbedo integrate_albedo(float cos_normal, float alpha, int strata) {
  const auto side = static_cast<float>(strata);
  const Vec3 out(std::sqrt(std::max(0.0F, 1.0F - cos_normal * cos_normal)), 0.0F, cos_normal);
  const float lambda_out = ggx_lambda(out, alpha);
  double total = 0.0;
  double grazing = 0.0;
  for (int i = 0; i < strata * strata; ++i) {
    const float u = (static_cast<float>(i % strata) + 0.5F) / (2.0F * side);
    const float low = static_cast<float>(i / strata) / side;
    const float high = static_cast<float>(i / strata + 1) / side;
    const float steep = 0.5F * (low + high);
    const float stratum = (high * square(high) - low * square(low)) / side;
    const Vec3 facet = sample_visible_facet(out, alpha, u, 1.0F - steep * square(steep));
    const Vec3 in = reflect(out, facet);
    if (!(in.z > 0.0F)) { continue; }
    const float seen = (1.0F + lambda_out) / (1.0F + lambda_out + ggx_lambda(in, alpha));
    total += static_cast<double>(stratum * seen);
    grazing += static_cast<double>(stratum * seen * schlick_weight(glm::dot(out, facet)));
  }
  return {static_cast<float>(std::min(1.0, total)), static_cast<float>(grazing)};
}

}  // namespace

MicrofacetAlbedoTable::MicrofacetAlbedoTable(float alpha, int strata) {
  constexpr float kCosMin = 1e-5F;  // the first node stands for the limit at the horizon
  for (std::size_t i = 0; i < kNodes; ++i) {
    const float root = static_cast<float>(i) / static_cast<float>(kNodes - 1);
    nodes_[i] = integrate_albedo(std::max(kCosMin, root * root), alpha, strata);
  }
  // The integral of 2 cos E over cos in [0,1] is that of 4 s^3 E over s = sqrt(cos); E is linear in
  // s between nodes, so three Gauss points a cell are exact.
  constexpr std::array<double, 3> kPoints{0.1127016653792583, 0.5, 0.8872983346207417};
  constexpr std::array<double, 3> kWeights{5.0 / 18.0, 8.0 / 18.0, 5.0 / 18.0};
  constexpr double kCell = 1.0 / static_cast<double>(kNodes - 1);
  double total = 0.0;
  double grazing = 0.0;
  for (std::size_t i = 0; i + 1 < kNodes; ++i) {
    for (std::size_t g = 0; g < kPoints.size(); ++g) {
      const double f = kPoints[g];
      const double s = (static_cast<double>(i) + f) * kCell;
      const double weight = 4.0 * s * s * s * kWeights[g] * kCell;
      const MicrofacetAlbedo& a = nodes_[i];
      const MicrofacetAlbedo& b = nodes_[i + 1];
      total +=
          weight * ((1.0 - f) * static_cast<double>(a.total) + f * static_cast<double>(b.total));
      grazing += weight *
                 ((1.0 - f) * static_cast<double>(a.grazing) + f * static_cast<double>(b.grazing));
    }
  }
  mean_ = {static_cast<float>(total), static_cast<float>(grazing)};
}

MicrofacetAlbedo MicrofacetAlbedoTable::at(float cos_normal) const {
  constexpr float kCells = static_cast<float>(kNodes - 1);
  const float place = std::sqrt(std::clamp(cos_normal, 0.0F, 1.0F)) * kCells;
  const std::size_t cell = std::min(static_cast<std::size_t>(place), kNodes - 2);
  const float f = place - static_cast<float>(cell);
  const MicrofacetAlbedo& a = nodes_[cell];
  const MicrofacetAlbedo& b = nodes_[cell + 1];
  return {a.total + (b.total - a.total) * f, a.grazing + (b.grazing - a.grazing) * f};
}

namespace {

using AlbedoTables = std::map<float, std::shared_ptr<const MicrofacetAlbedoTable>>;

std::shared_ptr<const MicrofacetAlbedoTable> albedo_table(float roughness, int strata,
                                                          AlbedoTables& tables) {
  const auto step = static_cast<std::int32_t>(roughness * kRoughnessSteps + 0.5F);
  const float rounded = static_cast<float>(step) / kRoughnessSteps;
  std::shared_ptr<const MicrofacetAlbedoTable>& table = tables[rounded];
  if (table == nullptr) {
    table = std::make_shared<const MicrofacetAlbedoTable>(std::max(kAlphaMin, rounded * rounded),
                                                          strata);
  }
  return table;
}

// What the microfacets of the metal scatter more than once, as a lobe (1-E(out)) (1-E(in)) whose
// colour is that of the repeated reflections (Kulla and Conty 2017; Fresnel mean of Schlick's
// term).
Vec3 multiple_scattering(const Vec3& r0, float albedo_total_mean) {
  constexpr float kLostMin = 1e-4F;
  const float lost = 1.0F - albedo_total_mean;
  if (lost < kLostMin) { return Vec3(0.0F); }
  const Vec3 mean = r0 + (Vec3(1.0F) - r0) * (1.0F / 21.0F);
  const Vec3 colour = mean * mean * albedo_total_mean / (Vec3(1.0F) - mean * lost);
  return colour * (kInversePi / lost);
}

PreparedMaterial prepare(const Material& material, int strata, AlbedoTables& tables) {
  const float metal = std::clamp(material.metallic, 0.0F, 1.0F);
  const float transmission = std::clamp(material.transmission, 0.0F, 1.0F);
  const float roughness = std::clamp(material.roughness, 0.0F, 1.0F);
  const float opaque = (1.0F - metal) * (1.0F - transmission);
  const Vec3 base_color = glm::clamp(material.base_color, 0.0F, 1.0F);
  const Vec3 tint = glm::clamp(material.specular_color, 0.0F, 1.0F);
  const float ior = std::max(1.0F, material.ior);
  const float r0 = square((ior - 1.0F) / (ior + 1.0F));

  PreparedMaterial prepared;
  prepared.emission = glm::max(material.emission, Vec3(0.0F));
  prepared.double_sided = material.double_sided;
  prepared.alpha = roughness > 0.0F ? std::max(kAlphaMin, roughness * roughness) : 0.0F;
  prepared.specular_r0 = base_color * metal + tint * (r0 * opaque);
  prepared.specular_r90 = Vec3(metal) + tint * opaque;
  prepared.glass = (1.0F - metal) * transmission;
  prepared.glass_reflect = tint;
  prepared.glass_transmit = base_color;
  prepared.ior = ior - 1.0F < kIndexStepMin ? 1.0F : ior;
  prepared.thin_walled = material.thin_walled;
  if (prepared.alpha > 0.0F && prepared.has_specular()) {
    prepared.albedo = albedo_table(roughness, strata, tables);
  }

  const MicrofacetAlbedo mean = albedo_mean(prepared);
  prepared.coat_r0 = max_component(tint) * r0;
  prepared.coat_r90 = max_component(tint);
  // Never 0: the coat's mean is at most r0 + (1 - r0)/21 with r0 < 1 for a finite index.
  const float base_share = 1.0F - coat_albedo(prepared, mean);
  if (base_share > 0.0F) { prepared.base = base_color * (opaque * kInversePi / base_share); }
  prepared.base_albedo = mean_component(base_color) * opaque;
  prepared.metal_rest = multiple_scattering(base_color, mean.total) * metal;
  prepared.rest_albedo = mean_component(prepared.metal_rest) * kPi * (1.0F - mean.total);
  return prepared;
}

}  // namespace

std::vector<PreparedMaterial> prepare_materials(std::span<const Material> materials, int strata) {
  AlbedoTables tables;
  std::vector<PreparedMaterial> prepared;
  prepared.reserve(materials.size());
  for (const Material& material : materials) {
    prepared.push_back(prepare(material, strata, tables));
  }
  return prepared;
}

Bsdf::Bsdf(const PreparedMaterial& material, const Vec3& out, bool front)
    : material_(material),
      out_(out),
      front_(front),
      eta_(front || material.thin_walled ? material.ior : 1.0F / material.ior) {
  float specular = 0.0F;
  if (material.has_specular()) {
    const MicrofacetAlbedo albedo = albedo_at(material, out.z);
    coat_leaves_ = 1.0F - coat_albedo(material, albedo);
    metal_leaves_ = 1.0F - albedo.total;
    specular = mean_component(material.specular_r0) * (albedo.total - albedo.grazing) +
               mean_component(material.specular_r90) * albedo.grazing;
  }
  const float diffuse = material.base_albedo * coat_leaves_ + material.rest_albedo * metal_leaves_;
  const float sum = specular + diffuse + material.glass;
  if (!(sum > 0.0F)) { return; }
  probability_specular_ = specular / sum;
  probability_diffuse_ = diffuse / sum;
  probability_glass_ = material.glass / sum;
}

bool Bsdf::glass_is_delta() const {
  return material_.alpha == 0.0F || (!material_.thin_walled && material_.ior == 1.0F);
}

bool Bsdf::is_delta() const {
  return !(probability_diffuse_ > 0.0F) &&
         (!(probability_specular_ > 0.0F) || specular_is_delta()) &&
         (!(probability_glass_ > 0.0F) || glass_is_delta());
}

Bsdf::GlassShares Bsdf::glass_shares(float cos_facet) const {
  float reflectance = fresnel_dielectric(cos_facet, eta_).reflectance;
  if (material_.thin_walled) { reflectance = 2.0F * reflectance / (1.0F + reflectance); }
  GlassShares shares;
  shares.reflect = material_.glass_reflect * reflectance;
  shares.transmit = material_.glass_transmit * (1.0F - reflectance);
  const float sum = mean_component(shares.reflect) + mean_component(shares.transmit);
  if (sum > 0.0F) { shares.reflect_probability = mean_component(shares.reflect) / sum; }
  return shares;
}

float Bsdf::index_squared(bool transmitted) const {
  const bool inside = material_.glass > 0.0F && !material_.thin_walled && transmitted == front_;
  return inside ? square(material_.ior) : 1.0F;
}

void Bsdf::add_specular(const Vec3& in, BsdfValue& value) const {
  const Vec3 facet = glm::normalize(out_ + in);
  const float density = ggx_density(facet, material_.alpha) / (4.0F * out_.z);
  const float lambda_out = ggx_lambda(out_, material_.alpha);
  const float lambda_in = ggx_lambda(in, material_.alpha);
  value.value_cos += schlick(material_.specular_r0, material_.specular_r90, glm::dot(out_, facet)) *
                     (density / (1.0F + lambda_out + lambda_in));
  value.pdf_solid_angle += probability_specular_ * density / (1.0F + lambda_out);
}

void Bsdf::add_diffuse(const Vec3& in, BsdfValue& value) const {
  Vec3 factor = material_.base;
  if (material_.has_specular()) {
    const MicrofacetAlbedo albedo = albedo_at(material_, in.z);
    factor = material_.base * (coat_leaves_ * (1.0F - coat_albedo(material_, albedo))) +
             material_.metal_rest * (metal_leaves_ * (1.0F - albedo.total));
  }
  value.value_cos += factor * in.z;
  value.pdf_solid_angle += probability_diffuse_ * in.z * kInversePi;
}

void Bsdf::add_glass_reflection(const Vec3& in, BsdfValue& value) const {
  const Vec3 facet = glm::normalize(out_ + in);
  const float density = ggx_density(facet, material_.alpha) / (4.0F * out_.z);
  const float lambda_out = ggx_lambda(out_, material_.alpha);
  const float lambda_in = ggx_lambda(in, material_.alpha);
  const GlassShares shares = glass_shares(glm::dot(out_, facet));
  value.value_cos += shares.reflect * (material_.glass * density / (1.0F + lambda_out + lambda_in));
  value.pdf_solid_angle +=
      probability_glass_ * shares.reflect_probability * density / (1.0F + lambda_out);
}

void Bsdf::add_glass_sheet(const Vec3& in, BsdfValue& value) const {
  const Vec3 mirrored(in.x, in.y, -in.z);
  const Vec3 facet = glm::normalize(out_ + mirrored);
  const float density = ggx_density(facet, material_.alpha) / (4.0F * out_.z);
  const float lambda_out = ggx_lambda(out_, material_.alpha);
  const float lambda_in = ggx_lambda(mirrored, material_.alpha);
  const GlassShares shares = glass_shares(glm::dot(out_, facet));
  value.value_cos +=
      shares.transmit * (material_.glass * density / (1.0F + lambda_out + lambda_in));
  value.pdf_solid_angle +=
      probability_glass_ * (1.0F - shares.reflect_probability) * density / (1.0F + lambda_out);
}

// Walter et al. 2007, equation 21, for radiance: smaller by eta^2 in the denser medium.
void Bsdf::add_glass_refraction(const Vec3& in, BsdfValue& value) const {
  Vec3 facet = out_ + in * eta_;
  const float length_squared = glm::dot(facet, facet);
  if (!(length_squared > 0.0F)) { return; }
  facet *= (facet.z < 0.0F ? -1.0F : 1.0F) / std::sqrt(length_squared);
  const float cos_out = glm::dot(out_, facet);
  const float cos_in = glm::dot(in, facet);
  if (!(cos_out > 0.0F && cos_in < 0.0F)) { return; }
  const float lambda_out = ggx_lambda(out_, material_.alpha);
  const float lambda_in = ggx_lambda(in, material_.alpha);
  const GlassShares shares = glass_shares(cos_out);
  const float jacobian = -cos_in / square(cos_in + cos_out / eta_);
  const float visible = ggx_density(facet, material_.alpha) * cos_out / out_.z * jacobian;
  value.value_cos += shares.transmit *
                     (material_.glass * visible / ((1.0F + lambda_out + lambda_in) * eta_ * eta_));
  value.pdf_solid_angle +=
      probability_glass_ * (1.0F - shares.reflect_probability) * visible / (1.0F + lambda_out);
}

BsdfValue Bsdf::evaluate(const Vec3& in) const {
  BsdfValue value;
  if (in.z > 0.0F) {
    if (probability_specular_ > 0.0F && !specular_is_delta()) { add_specular(in, value); }
    if (probability_diffuse_ > 0.0F) { add_diffuse(in, value); }
    if (probability_glass_ > 0.0F && !glass_is_delta()) { add_glass_reflection(in, value); }
  } else if (in.z < 0.0F && probability_glass_ > 0.0F && !glass_is_delta()) {
    if (material_.thin_walled) {
      add_glass_sheet(in, value);
    } else {
      add_glass_refraction(in, value);
    }
  }
  return value;
}

Vec3 Bsdf::sample_direction_glass(float u_side, const RandomPair& u) const {
  const Vec3 facet = sample_visible_facet(out_, material_.alpha, u.x(), u.y());
  const float cos_out = glm::dot(out_, facet);
  if (!(cos_out > 0.0F)) { return Vec3(0.0F); }
  const bool reflects = u_side < glass_shares(cos_out).reflect_probability;
  if (reflects || material_.thin_walled) {
    const Vec3 in = reflect(out_, facet);
    if (!(in.z > 0.0F)) { return Vec3(0.0F); }
    return reflects ? in : Vec3(in.x, in.y, -in.z);
  }
  const Fresnel fresnel = fresnel_dielectric(cos_out, eta_);
  const Vec3 in = facet * (cos_out / eta_ - fresnel.cos_transmitted) - out_ / eta_;
  return in.z < 0.0F ? in : Vec3(0.0F);
}

BsdfSample Bsdf::sample_glass_delta(float u_side) const {
  const GlassShares shares = glass_shares(out_.z);
  BsdfSample sample;
  if (u_side < shares.reflect_probability) {
    sample.direction = Vec3(-out_.x, -out_.y, out_.z);
    sample.weight =
        shares.reflect * (material_.glass / (probability_glass_ * shares.reflect_probability));
    sample.index_squared = index_squared(false);
    return sample;
  }
  const float scale = material_.glass / (probability_glass_ * (1.0F - shares.reflect_probability));
  sample.index_squared = index_squared(true);
  if (material_.thin_walled) {
    sample.direction = -out_;
    sample.weight = shares.transmit * scale;
    return sample;
  }
  const float cos_far = fresnel_dielectric(out_.z, eta_).cos_transmitted;
  sample.direction = Vec3(-out_.x / eta_, -out_.y / eta_, -cos_far);
  sample.weight = shares.transmit * (scale / (eta_ * eta_));
  return sample;
}

BsdfSample Bsdf::sample(float u_lobe, const RandomPair& u_direction) const {
  BsdfSample sample;
  const float before_glass = probability_specular_ + probability_diffuse_;
  if (probability_glass_ > 0.0F && u_lobe >= before_glass) {
    const float u_side = (u_lobe - before_glass) / probability_glass_;
    if (glass_is_delta()) { return sample_glass_delta(u_side); }
    sample.direction = sample_direction_glass(u_side, u_direction);
  } else if (probability_diffuse_ > 0.0F && u_lobe >= probability_specular_) {
    sample.direction = cosine_direction(u_direction.x(), u_direction.y());
  } else if (probability_specular_ > 0.0F && specular_is_delta()) {
    sample.direction = Vec3(-out_.x, -out_.y, out_.z);
    sample.weight =
        schlick(material_.specular_r0, material_.specular_r90, out_.z) / probability_specular_;
    return sample;
  } else if (probability_specular_ > 0.0F) {
    sample.direction = reflect(
        out_, sample_visible_facet(out_, material_.alpha, u_direction.x(), u_direction.y()));
    if (!(sample.direction.z > 0.0F)) { return {}; }
  }
  const BsdfValue value = evaluate(sample.direction);
  if (!(value.pdf_solid_angle > 0.0F) || !std::isfinite(value.pdf_solid_angle)) { return {}; }
  sample.weight = value.value_cos * (1.0F / value.pdf_solid_angle);
  sample.pdf_solid_angle = value.pdf_solid_angle;
  sample.index_squared = index_squared(sample.direction.z < 0.0F);
  return sample;
}

}  // namespace preheat
