#include "common/path.h"

#include <cmath>

#include "common/math.h"
#include "common/path_rules.h"
#include "common/ray_offset.h"

namespace preheat {
namespace {

// A shadow ray stops this much short of its light, relative to its length: the rounding of a
// distance.
constexpr float kShadowReach = 1.0F - 0x1p-20F;

// Interpolated normals that face away from the viewer, or nearly so, are turned towards it until
// the cosine is about this.
constexpr float kShadingCosMin = 1.0F / 128.0F;

// Power heuristic (Veach 1997, section 9.2.4) for one sample of each: the weight of the technique
// with density `pdf` > 0. As a ratio, it holds for an infinite `pdf_other` too.
float mis_weight(float pdf, float pdf_other) {
  const float ratio = pdf_other / pdf;
  return 1.0F / (1.0F + ratio * ratio);
}

bool carries_light(const Vec3& value) { return max_component(value) > 0.0F && is_finite(value); }

// The shading normal on the viewer's side. Moving it towards the viewer keeps it continuous.
Vec3 shading_normal_towards(const Vec3& normal, const Vec3& out) {
  const float cos_out = glm::dot(normal, out);
  if (cos_out >= kShadingCosMin) { return normal; }
  return glm::normalize(normal + out * (kShadingCosMin - cos_out));
}

// A point on a surface, turned so that its normals are on the viewer's side.
struct Vertex {
  const SurfaceHit& hit;
  Vec3 normal_geometric;
  OrthonormalFrame frame;
  bool is_visible;  // false where rounding leaves no side to see: the path ends
  Bsdf bsdf;

  // A direction is used only where the true surface and the shading normal agree on its side;
  // otherwise light would leak through.
  [[nodiscard]] bool sides_agree(const Vec3& direction, float cos_shading) const {
    const float cos_geometric = glm::dot(normal_geometric, direction);
    return cos_geometric * cos_shading > 0.0F;
  }

  // Whether the light lies in the surface's own plane as far as rounding can tell, as the next
  // panel of a lit ceiling does: on which side of it is then chance, and it lights nothing.
  [[nodiscard]] bool may_hold(const LightSample& light) const {
    if (light.infinitely_far) { return false; }
    const Vec3 normal = glm::abs(normal_geometric);
    const float reach =
        (hit.position_error + light.position_error) * (normal.x + normal.y + normal.z);
    return std::abs(glm::dot(normal_geometric, light.point - hit.position)) <= reach;
  }
};

Vertex make_vertex(const SurfaceHit& hit, const PreparedMaterial& material, const Vec3& out) {
  const float cos_geometric = glm::dot(hit.normal_geometric, out);
  const bool front = cos_geometric > 0.0F;
  const float side = front ? 1.0F : -1.0F;
  const OrthonormalFrame frame(shading_normal_towards(hit.normal_shading * side, out));
  const Vec3 out_local = frame.local_from_scene(out);
  return {hit, hit.normal_geometric * side, frame,
          std::abs(cos_geometric) > 0.0F && out_local.z > 0.0F, Bsdf(material, out_local, front)};
}

void sample_light(const Vertex& vertex, const Lights& lights, std::uint32_t u_choice,
                  const RandomPair& u, const Vec3& throughput, ShadedVertex& result) {
  const SurfaceHit& hit = vertex.hit;
  const LightSample light = lights.sample(hit.position, vertex.frame.normal, u_choice, u);
  if (!(light.pdf_solid_angle > 0.0F) || !std::isfinite(light.pdf_solid_angle)) { return; }
  if (vertex.may_hold(light)) { return; }
  const Vec3 in = vertex.frame.local_from_scene(light.direction);
  if (!vertex.sides_agree(light.direction, in.z)) { return; }
  const BsdfValue bsdf = vertex.bsdf.evaluate(in);
  const float weight =
      light.punctual ? 1.0F : mis_weight(light.pdf_solid_angle, bsdf.pdf_solid_angle);
  const Vec3 direct =
      throughput * bsdf.value_cos * light.radiance * (weight / light.pdf_solid_angle);
  if (!carries_light(direct)) { return; }

  Ray shadow;
  shadow.origin =
      offset_origin(hit.position, hit.position_error, vertex.normal_geometric, light.direction);
  shadow.direction = light.direction;
  if (!light.infinitely_far) {
    const Vec3 to_light = light.point - shadow.origin;
    const float distance = std::sqrt(glm::dot(to_light, to_light));
    if (!(distance > 0.0F)) { return; }
    shadow.direction = to_light * (1.0F / distance);
    shadow.t_max = distance * kShadowReach;
  }
  result.has_shadow_ray = true;
  result.shadow = shadow;
  result.direct = direct;
}

}  // namespace

Shading::Shading(const SceneTables& tables, const RenderSettings& settings, int albedo_strata)
    : settings_(settings),
      materials_(prepare_materials(tables.materials, albedo_strata)),
      lights_(tables, materials_, settings.sky),
      rng_(settings.seed) {}

Ray Shading::start_path(std::uint32_t pixel, std::uint32_t sample, PathState& path) const {
  path = PathState{};
  path.pixel = pixel;
  path.sample = sample;
  const RandomPair jitter = rng_.pair(pixel, sample, 0, Dimension::kCamera);
  const float x = static_cast<float>(pixel % settings_.width) + jitter.x();
  const float y = static_cast<float>(pixel / settings_.width) + jitter.y();
  const View& view = settings_.view;
  const Vec3 across = view.right * (2.0F * x / static_cast<float>(settings_.width) - 1.0F) -
                      view.up * (2.0F * y / static_cast<float>(settings_.height) - 1.0F);
  Ray ray;
  ray.origin = view.orthographic ? view.origin + across : view.origin;
  ray.direction = view.orthographic ? view.forward : glm::normalize(view.forward + across);
  return ray;
}

void Shading::shade_miss(const Ray& /*ray*/, PathState& path) const {
  path.radiance += path.throughput * lights_.sky() * path.sky_weight;
}

void Shading::add_emission(const SurfaceHit& hit, const PreparedMaterial& material,
                           float cos_geometric, PathState& path) const {
  if (material.emission == Vec3(0.0F)) { return; }
  if (!(cos_geometric > 0.0F) && !material.double_sided) { return; }
  float weight = 1.0F;
  if (path.pdf_solid_angle > 0.0F) {
    const float pdf_light =
        lights_.pdf_triangle(hit.triangle, hit.distance, std::abs(cos_geometric));
    weight = mis_weight(path.pdf_solid_angle, pdf_light);
  }
  path.radiance += path.throughput * material.emission * weight;
}

ShadedVertex Shading::shade_hit(const Ray& ray, const SurfaceHit& hit, PathState& path) const {
  ShadedVertex result;
  const Vec3 out = -ray.direction;
  const PreparedMaterial& material = materials_[hit.material];
  add_emission(hit, material, glm::dot(hit.normal_geometric, out), path);
  if (!may_scatter(path.bounce, settings_.bounces)) { return result; }
  const Vertex vertex = make_vertex(hit, material, out);
  if (!vertex.is_visible) { return result; }

  const auto random = [&](Dimension dimension) {
    return rng_.pair(path.pixel, path.sample, path.bounce, dimension);
  };
  const RandomPair choice = random(Dimension::kChoice);
  if (!lights_.empty() && !vertex.bsdf.is_delta()) {
    sample_light(vertex, lights_, choice.x_bits, random(Dimension::kLight), path.throughput,
                 result);
  }
  if (!may_continue(path.bounce, settings_.bounces, lights_.emission_can_be_met())) {
    return result;
  }

  const BsdfSample scattered = vertex.bsdf.sample(choice.y(), random(Dimension::kDirection));
  const Vec3 direction = vertex.frame.scene_from_local(scattered.direction);
  if (!vertex.sides_agree(direction, scattered.direction.z)) { return result; }
  const Vec3 throughput = path.throughput * scattered.weight;
  if (!carries_light(throughput)) { return result; }
  const float survival = roulette_survival(path.bounce + 1, throughput * scattered.index_squared);
  if (survival < 1.0F && random(Dimension::kRoulette).x() >= survival) { return result; }

  result.has_scatter_ray = true;
  result.scatter.origin =
      offset_origin(hit.position, hit.position_error, vertex.normal_geometric, direction);
  result.scatter.direction = glm::normalize(direction);
  path.throughput = throughput / survival;
  path.pdf_solid_angle = scattered.pdf_solid_angle;
  path.sky_weight = 1.0F;
  if (scattered.pdf_solid_angle > 0.0F) {
    path.sky_weight = mis_weight(scattered.pdf_solid_angle, lights_.pdf_sky(scattered.direction.z));
  }
  ++path.bounce;
  return result;
}

}  // namespace preheat
