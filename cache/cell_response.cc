#include "cache/cell_response.h"

#include <algorithm>
#include <cmath>

#include "common/math.h"
#include "common/path_rules.h"
#include "common/rng.h"

namespace preheat {
namespace {

// Shadow rays with which a cell looks for its lights, stratified by power.
constexpr std::uint32_t kLightLooks = 128;

// Rays that stand for a lobe. Up to this roughness (GGX alpha) one is enough, as the lobe is
// narrower than a bin, and where fewer than this share of the rays take the lobe, as a coat's do.
constexpr float kNarrowAlpha = 0.1F;
constexpr float kCoatShare = 0.25F;
constexpr std::uint32_t kWideLobeRays = 4;
constexpr std::uint32_t kGlassRays = 8;

// As in the renderer, no surface is seen flatter than this.
constexpr float kCosMin = 1.0F / 128.0F;

[[nodiscard]] bool lies_in(const Vec3& point, const Aabb& cell) {
  bool inside = true;
  for (int axis = 0; axis < 3; ++axis) {
    inside = inside && point[axis] >= cell.low[axis] && point[axis] <= cell.high[axis];
  }
  return inside;
}

// The i-th point of an additive sequence that fills the square evenly, by the powers of the
// inverse of 1.3247..., the plastic number.
[[nodiscard]] RandomPair spread_pair(std::uint32_t i) {
  return {(i + 1) * 3242174889U, (i + 1) * 2447445414U};
}

// The mean of what scattering leaves, in the brightest colour, over both sides and the rays that go
// on. Seen at 45 degrees: only Russian roulette wants it.
[[nodiscard]] double albedo_of(const PreparedMaterial& material) {
  constexpr std::uint32_t kRays = 32;
  const float diagonal = std::sqrt(0.5F);
  double sum = 0.0;
  std::uint32_t count = 0;
  for (std::uint32_t i = 0; i < kRays; ++i) {
    const Bsdf bsdf(material, Vec3(diagonal, 0.0F, diagonal), i % 2 == 0);
    const float lobe = (static_cast<float>(i / 2) + 0.5F) / (0.5F * kRays);
    const BsdfSample sample = bsdf.sample(lobe, spread_pair(i));
    const float kept = max_component(sample.weight) * sample.index_squared;
    if (!(kept > 0.0F)) { continue; }
    sum += static_cast<double>(std::min(1.0F, kept));
    ++count;
  }
  return count > 0 ? sum / count : 0.0;
}

}  // namespace

// A surface group as rays of one direction meet it.
struct CellResponse::Vertex {
  Vertex(const PreparedMaterial& prepared, const SurfaceGroup& group, const Vec3& direction)
      : material(prepared),
        is_front(glm::dot(group.normal, direction) <= 0.0F),
        frame(is_front ? group.normal : -group.normal),
        bsdf(prepared, out_of(frame, direction), is_front) {}

  [[nodiscard]] static Vec3 out_of(const OrthonormalFrame& frame, const Vec3& direction) {
    Vec3 out = frame.local_from_scene(-direction);
    out.z = std::max(out.z, kCosMin);
    return glm::normalize(out);
  }

  const PreparedMaterial& material;
  bool is_front;
  OrthonormalFrame frame;
  Bsdf bsdf;
};

CellResponse::CellResponse(const SceneTables& tables, const RenderSettings& settings,
                           const DirectionBins& bins)
    : bins_(bins),
      bounces_(settings.bounces),
      materials_(prepare_materials(tables.materials, kAlbedoStrataCoarse)),
      lights_(tables, materials_, settings.sky) {
  for (const PreparedMaterial& material : materials_) { albedos_.push_back(albedo_of(material)); }
}

CellLights CellResponse::look_at_lights(const Aabb& cell, std::uint32_t number) const {
  CellLights seen;
  if (lights_.empty()) { return seen; }
  const Vec3 centre = 0.5F * (cell.low + cell.high);
  const Rng rng(0);
  std::vector<Vec3d> sums(bins_.size(), Vec3d(0.0));
  std::vector<std::uint32_t> counts(bins_.size(), 0);
  std::uint32_t inside = 0;
  std::uint32_t sky = 0;
  for (std::uint32_t look = 0; look < kLightLooks; ++look) {
    const std::uint32_t choice = look * (~0U / kLightLooks) + (~0U / kLightLooks) / 2;
    const LightSample light = lights_.sample(centre, Vec3(0.0F, 0.0F, 1.0F), choice,
                                             rng.pair(number, look, 0, Dimension::kLight));
    if (!(light.pdf_solid_angle > 0.0F) || !(max_component(light.radiance) > 0.0F)) { continue; }
    if (light.infinitely_far && !light.punctual) {
      ++sky;
    } else if (!light.infinitely_far && lies_in(light.point, cell)) {
      ++inside;
    } else if (const auto bin = bins_.bin_of(Vec3d(light.direction))) {
      sums[*bin] += Vec3d(light.direction);
      ++counts[*bin];
    }
  }
  const auto share = [](std::uint32_t count) { return count / static_cast<double>(kLightLooks); };
  for (std::uint32_t bin = 0; bin < bins_.size(); ++bin) {
    if (counts[bin] == 0) { continue; }
    seen.outside.push_back({Vec3(glm::normalize(sums[bin])), bin, share(counts[bin])});
  }
  seen.inside = share(inside);
  seen.sky = share(sky);
  return seen;
}

void CellResponse::add_cosine(const Vec3& normal, double rays, std::span<double> bins) const {
  double sum = 0.0;
  for (std::uint32_t bin = 0; bin < bins_.size(); ++bin) {
    sum += std::max(0.0, glm::dot(Vec3d(normal), bins_.flux(bin)));
  }
  // A single bin has no flux in any direction: it takes all.
  if (!(sum > 1e-9)) {
    for (double& bin : bins) { bin += rays / static_cast<double>(bins.size()); }
    return;
  }
  for (std::uint32_t bin = 0; bin < bins_.size(); ++bin) {
    bins[bin] += rays / sum * std::max(0.0, glm::dot(Vec3d(normal), bins_.flux(bin)));
  }
}

void CellResponse::add_direction(const Vertex& vertex, const Vec3& local, double rays,
                                 OutgoingRays& outgoing) const {
  if (const auto bin = bins_.bin_of(Vec3d(vertex.frame.scene_from_local(local)))) {
    outgoing.scatter[*bin] += rays;
  }
}

void CellResponse::add_lobes(const Vertex& vertex, double rays, OutgoingRays& outgoing) const {
  const LobeProbabilities lobes = vertex.bsdf.probabilities();
  if (lobes.specular > 0.0F) {
    const double of_lobe = rays * static_cast<double>(lobes.specular);
    if (vertex.material.alpha <= kNarrowAlpha || lobes.specular < kCoatShare) {
      const Vec3 out = vertex.bsdf.out();
      add_direction(vertex, Vec3(-out.x, -out.y, out.z), of_lobe, outgoing);
    } else {
      for (std::uint32_t i = 0; i < kWideLobeRays; ++i) {
        const BsdfSample sample = vertex.bsdf.sample(0.5F * lobes.specular, spread_pair(i));
        add_direction(vertex, sample.direction, of_lobe / kWideLobeRays, outgoing);
      }
    }
  }
  if (lobes.glass > 0.0F) {
    const double of_ray = rays * static_cast<double>(lobes.glass) / kGlassRays;
    for (std::uint32_t i = 0; i < kGlassRays; ++i) {
      const float side = (static_cast<float>(i) + 0.5F) / static_cast<float>(kGlassRays);
      const float lobe = lobes.specular + lobes.diffuse + side * lobes.glass;
      const BsdfSample sample = vertex.bsdf.sample(lobe, spread_pair(i));
      add_direction(vertex, sample.direction, of_ray, outgoing);
    }
  }
}

void CellResponse::answer(const CellContent& cell, const IncomingRays& incoming,
                          std::uint32_t bounce, double throughput, Scratch& scratch,
                          OutgoingRays& outgoing, double& throughput_sum) const {
  double shown = 0.0;
  double area = 0.0;
  for (std::size_t i = 0; i < cell.surfaces.size(); ++i) {
    const SurfaceGroup& group = cell.surfaces[i];
    scratch.shares[i] =
        group.area * static_cast<double>(std::abs(glm::dot(group.normal, incoming.direction)));
    shown += scratch.shares[i];
    area += group.area;
  }
  const bool scatters = may_continue(bounce, bounces_, lights_.emission_can_be_met());
  for (std::size_t i = 0; i < cell.surfaces.size(); ++i) {
    const SurfaceGroup& group = cell.surfaces[i];
    // All edge-on: nothing tells the surfaces apart but their size.
    const double share = shown > 0.0 ? scratch.shares[i] / shown : group.area / area;
    const double rays = incoming.rays * share;
    if (!(rays > 0.0)) { continue; }
    const Vertex vertex(materials_[group.material], group, incoming.direction);
    const std::size_t side = 2 * i + (vertex.is_front ? 0 : 1);
    if (!lights_.empty() && !vertex.bsdf.is_delta()) {
      scratch.lit[side] += rays * kLightSamplesPerVertex;
    }
    if (!scatters) { continue; }
    const double kept = throughput * albedos_[group.material];
    if (!(kept > 0.0)) { continue; }
    const float survival = roulette_survival(bounce + 1, Vec3(static_cast<float>(kept)));
    const double going_on = rays * static_cast<double>(survival);
    scratch.lobes[side] += going_on * static_cast<double>(vertex.bsdf.probabilities().diffuse);
    add_lobes(vertex, going_on, outgoing);
    throughput_sum += going_on * kept / static_cast<double>(survival);
  }
}

void CellResponse::add_shadows(const CellContent& cell, const Scratch& scratch,
                               OutgoingRays& outgoing) const {
  constexpr double kFacingInside = 0.5;
  for (std::size_t side = 0; side < scratch.lit.size(); ++side) {
    const double rays = scratch.lit[side];
    if (!(rays > 0.0)) { continue; }
    const SurfaceGroup& group = cell.surfaces[side / 2];
    const Vec3 normal = side % 2 == 0 ? group.normal : -group.normal;
    const PreparedMaterial& material = materials_[group.material];
    const bool passes_light = material.glass > 0.0F && material.alpha > 0.0F;
    for (const CellLights::Towards& light : cell.lights.outside) {
      if (passes_light || glm::dot(normal, light.direction) > 0.0F) {
        outgoing.shadow[light.bin] += rays * light.share;
      }
    }
    outgoing.shadow_inside += rays * cell.lights.inside * kFacingInside;
    if (cell.lights.sky > 0.0) { add_cosine(normal, rays * cell.lights.sky, outgoing.shadow); }
  }
}

void CellResponse::respond(const CellContent& cell, std::span<const IncomingRays> incoming,
                           std::uint32_t bounce, double throughput, Scratch& scratch,
                           OutgoingRays& outgoing) const {
  if (!may_scatter(bounce, bounces_) || cell.surfaces.empty()) { return; }
  scratch.lobes.assign(2 * cell.surfaces.size(), 0.0);
  scratch.lit.assign(2 * cell.surfaces.size(), 0.0);
  scratch.shares.assign(cell.surfaces.size(), 0.0);
  double throughput_sum = 0.0;
  for (const IncomingRays& rays : incoming) {
    answer(cell, rays, bounce, throughput, scratch, outgoing, throughput_sum);
  }
  for (std::size_t side = 0; side < scratch.lobes.size(); ++side) {
    if (!(scratch.lobes[side] > 0.0)) { continue; }
    const Vec3& normal = cell.surfaces[side / 2].normal;
    add_cosine(side % 2 == 0 ? normal : -normal, scratch.lobes[side], outgoing.scatter);
  }
  add_shadows(cell, scratch, outgoing);
  double sent = 0.0;
  for (const double rays : outgoing.scatter) { sent += rays; }
  outgoing.throughput = sent > 0.0 ? std::min(1.0, throughput_sum / sent) : 1.0;
}

}  // namespace preheat
