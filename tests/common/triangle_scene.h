// A few triangles and a scalar path tracer over them that tries every triangle for every ray:
// drives class Shading exactly as its contract says, with nothing else of the renderer involved.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <optional>
#include <vector>

#include "common/film.h"
#include "common/math.h"
#include "common/path.h"
#include "common/ray_offset.h"

namespace preheat::test {

// Corners in single precision, edge tests that agree between neighbours: the ray through a shared
// edge meets at least one side (as Embree's robust mode; Davidovic et al. 2012).
inline std::optional<SurfaceHit> intersect(const Ray& ray, const std::array<Vec3, 3>& corners) {
  const Vec3 v0 = corners[0] - ray.origin;
  const Vec3 v1 = corners[1] - ray.origin;
  const Vec3 v2 = corners[2] - ray.origin;
  const float u = glm::dot(glm::cross(v2 - v1, v1 + v2), ray.direction);
  const float v = glm::dot(glm::cross(v0 - v2, v2 + v0), ray.direction);
  const float w = glm::dot(glm::cross(v1 - v0, v0 + v1), ray.direction);
  const bool inside =
      (u >= 0.0F && v >= 0.0F && w >= 0.0F) || (u <= 0.0F && v <= 0.0F && w <= 0.0F);
  const float sum = u + v + w;
  const Vec3 cross = glm::cross(corners[1] - corners[0], corners[2] - corners[0]);
  const float slope = glm::dot(cross, ray.direction);
  if (!inside || sum == 0.0F || slope == 0.0F) { return std::nullopt; }
  const float t = glm::dot(v0, cross) / slope;
  if (!(t >= ray.t_min && t <= ray.t_max)) { return std::nullopt; }
  SurfaceHit hit;
  const Vec3 p0 = corners[0] * (u / sum);
  const Vec3 p1 = corners[1] * (v / sum);
  const Vec3 p2 = corners[2] * (w / sum);
  hit.position = p0 + p1 + p2;
  hit.position_error = kPointRounding * max_component(glm::abs(p0) + glm::abs(p1) + glm::abs(p2));
  hit.normal_geometric = glm::normalize(cross);
  hit.normal_shading = hit.normal_geometric;
  hit.distance = t;
  return hit;
}

struct Estimate {
  double mean = 0.0;
  double standard_error = 0.0;
};

class TriangleScene {
 public:
  std::uint32_t add_material(const Material& material) {
    tables_.materials.push_back(material);
    return static_cast<std::uint32_t>(tables_.materials.size() - 1);
  }
  void add_triangle(const Vec3& a, const Vec3& b, const Vec3& c, std::uint32_t material) {
    const auto id = static_cast<std::uint32_t>(triangles_.size());
    triangles_.push_back({{a, b, c}, material});
    if (tables_.materials[material].emission != Vec3(0.0F)) {
      tables_.emissive_triangles.push_back({id, material, {a, b, c}});
    }
    tables_.triangle_count = triangles_.size();
  }
  // Counter-clockwise seen from the side that its normal points to.
  void add_parallelogram(const Vec3& corner, const Vec3& edge_1, const Vec3& edge_2,
                         std::uint32_t material) {
    add_triangle(corner, corner + edge_1, corner + edge_1 + edge_2, material);
    add_triangle(corner, corner + edge_1 + edge_2, corner + edge_2, material);
  }
  // The surface of [low, high], its normals outwards, or inwards for a room.
  void add_box(const Vec3& low, const Vec3& high, std::uint32_t material, bool outwards) {
    const Vec3 size = high - low;
    for (int axis = 0; axis < 3; ++axis) {
      Vec3 first(0.0F);
      Vec3 second(0.0F);
      Vec3 across(0.0F);
      first[(axis + 1) % 3] = size[(axis + 1) % 3];
      second[(axis + 2) % 3] = size[(axis + 2) % 3];
      across[axis] = size[axis];
      add_parallelogram(low, outwards ? second : first, outwards ? first : second, material);
      add_parallelogram(low + across, outwards ? first : second, outwards ? second : first,
                        material);
    }
  }
  // 8 * 4^levels triangles, normals outwards.
  void add_sphere(const Vec3& centre, float radius, int levels, std::uint32_t material) {
    std::vector<std::array<Vec3, 3>> faces;
    for (unsigned octant = 0; octant < 8; ++octant) {
      const Vec3 x((octant & 1U) != 0 ? -1.0F : 1.0F, 0.0F, 0.0F);
      const Vec3 y(0.0F, (octant & 2U) != 0 ? -1.0F : 1.0F, 0.0F);
      const Vec3 z(0.0F, 0.0F, (octant & 4U) != 0 ? -1.0F : 1.0F);
      const bool mirrored = std::popcount(octant) % 2 == 1;
      faces.push_back(mirrored ? std::array{x, z, y} : std::array{x, y, z});
    }
    for (int level = 0; level < levels; ++level) {
      std::vector<std::array<Vec3, 3>> finer;
      for (const auto& [a, b, c] : faces) {
        const Vec3 ab = glm::normalize(a + b);
        const Vec3 bc = glm::normalize(b + c);
        const Vec3 ca = glm::normalize(c + a);
        finer.insert(finer.end(), {{a, ab, ca}, {ab, b, bc}, {ca, bc, c}, {ab, bc, ca}});
      }
      faces = finer;
    }
    for (const auto& [a, b, c] : faces) {
      add_triangle(centre + a * radius, centre + b * radius, centre + c * radius, material);
    }
  }

  [[nodiscard]] SceneTables& tables() { return tables_; }
  [[nodiscard]] const SceneTables& tables() const { return tables_; }

  // Lowest (t, id).
  [[nodiscard]] std::optional<SurfaceHit> closest(const Ray& ray) const {
    std::optional<SurfaceHit> best;
    for (std::uint32_t id = 0; id < triangles_.size(); ++id) {
      std::optional<SurfaceHit> hit = intersect(ray, triangles_[id].corners);
      if (!hit || (best && !(hit->distance < best->distance))) { continue; }
      hit->triangle = id;
      hit->material = triangles_[id].material;
      best = hit;
    }
    return best;
  }
  [[nodiscard]] bool blocked(const Ray& ray) const {
    for (const auto& triangle : triangles_) {
      if (intersect(ray, triangle.corners)) { return true; }
    }
    return false;
  }

  struct Counts {
    std::uint64_t scatter = 0;
    std::uint64_t shadow = 0;
  };

  [[nodiscard]] Vec3 trace(const Shading& shading, std::uint32_t pixel, std::uint32_t sample,
                           Counts& counts) const {
    PathState path;
    Ray ray = shading.start_path(pixel, sample, path);
    for (;;) {
      const std::optional<SurfaceHit> hit = closest(ray);
      if (!hit) {
        shading.shade_miss(ray, path);
        return path.radiance;
      }
      const ShadedVertex vertex = shading.shade_hit(ray, *hit, path);
      counts.shadow += vertex.has_shadow_ray ? 1U : 0U;
      counts.scatter += vertex.has_scatter_ray ? 1U : 0U;
      if (vertex.has_shadow_ray && !blocked(vertex.shadow)) { path.radiance += vertex.direct; }
      if (!vertex.has_scatter_ray) { return path.radiance; }
      ray = vertex.scatter;
    }
  }

  // The image's mean over pixels and colours. Pixels are independent of each other, so where all
  // look at the same thing their spread tells the standard error.
  [[nodiscard]] Estimate render(const RenderSettings& settings, Counts* counts = nullptr) const {
    const Shading shading(tables_, settings);
    const std::uint32_t pixels = settings.width * settings.height;
    double sum = 0.0;
    double sum_of_squares = 0.0;
    Counts own;
    for (std::uint32_t pixel = 0; pixel < pixels; ++pixel) {
      double of_pixel = 0.0;
      for (std::uint32_t sample = 0; sample < settings.spp; ++sample) {
        const Vec3 radiance = trace(shading, pixel, sample, counts != nullptr ? *counts : own);
        of_pixel += static_cast<double>(mean_component(radiance));
      }
      of_pixel /= settings.spp;
      sum += of_pixel;
      sum_of_squares += of_pixel * of_pixel;
    }
    const double n = pixels;
    const double variance = std::max(0.0, sum_of_squares / n - (sum / n) * (sum / n));
    return {sum / n, std::sqrt(variance / (n - 1.0))};
  }

 private:
  struct PlacedTriangle {
    std::array<Vec3, 3> corners{};
    std::uint32_t material = 0;
  };
  SceneTables tables_{};
  std::vector<PlacedTriangle> triangles_{};
};

// A camera at `eye` towards `target`, with half the field of view's tangent in each direction.
inline View look_at(const Vec3& eye, const Vec3& target, float tangent) {
  View view;
  view.origin = eye;
  view.forward = glm::normalize(target - eye);
  const OrthonormalFrame frame(view.forward);
  view.right = frame.tangent * tangent;
  view.up = frame.bitangent * tangent;
  return view;
}

inline Material diffuse(const Vec3& albedo) {
  Material material;
  material.base_color = albedo;
  material.specular_color = Vec3(0.0F);
  return material;
}

inline Material emitter(const Vec3& radiance, const Vec3& albedo = Vec3(0.0F)) {
  Material material = diffuse(albedo);
  material.emission = radiance;
  material.double_sided = false;
  return material;
}

}  // namespace preheat::test
