#include "cache/mesh_arrays.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "common/voxel_block.h"

namespace preheat {
namespace {

Vec3 shading_normal(const MeshArrays& arrays, std::uint32_t primitive,
                    const std::array<float, 3>& weights, const Vec3& normal_geometric) {
  if (arrays.normals.empty()) { return normal_geometric; }
  Vec3 sum(0.0F);
  for (unsigned corner = 0; corner < 3; ++corner) {
    const std::uint32_t code = arrays.normals[arrays.indices[std::size_t{primitive} * 3 + corner]];
    if (code == 0) { return normal_geometric; }
    sum += decode_normal(code) * weights[corner];
  }
  const float length_squared = glm::dot(sum, sum);
  if (!(length_squared > 1e-12F)) { return normal_geometric; }
  const Vec3 normal = sum / std::sqrt(length_squared);
  return glm::dot(normal, normal_geometric) < 0.0F ? -normal : normal;
}

}  // namespace

// Error bounds as pbrt-v4 section 6.8.4, equation 6.25: gamma(7) times the sum of magnitudes.
SurfaceHit surface_of(const MeshArrays& arrays, std::uint32_t primitive, float t, float u,
                      float v) {
  const std::array<float, 3> weights{1.0F - u - v, u, v};
  const Vec3 a = vertex_at(arrays, primitive, 0);
  const Vec3 b = vertex_at(arrays, primitive, 1);
  const Vec3 c = vertex_at(arrays, primitive, 2);
  SurfaceHit surface;
  surface.position = a * weights[0] + b * weights[1] + c * weights[2];
  const Vec3 magnitude =
      glm::abs(a * weights[0]) + glm::abs(b * weights[1]) + glm::abs(c * weights[2]);
  constexpr float kGamma7 = 4.1723277e-07F;
  surface.position_error = kGamma7 * std::max({magnitude.x, magnitude.y, magnitude.z});
  // In double, as the cross product of small edges would lose its bits or underflow in float.
  const Vec3d normal = glm::cross(Vec3d(b) - Vec3d(a), Vec3d(c) - Vec3d(a));
  const double length = std::sqrt(glm::dot(normal, normal));
  surface.normal_geometric = Vec3(normal / length);
  surface.normal_shading = shading_normal(arrays, primitive, weights, surface.normal_geometric);
  surface.distance = t;
  surface.triangle = arrays.triangles[primitive];
  surface.material = arrays.materials[primitive];
  return surface;
}

}  // namespace preheat
