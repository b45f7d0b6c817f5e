// A scene as imported: plain arrays in the scene frame. Built by an importer, read by the compiler.
//
// The scene frame is the file's world, rebased and scaled by a power of two to about unit size, so
// that every later stage works on coordinates of magnitude <= 1.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "common/vec3.h"

namespace preheat {

// scene = (file - centre) * 2^scale_exponent. Both steps are done in double, once per vertex.
struct Frame {
  Vec3d centre{0.0};
  std::int32_t scale_exponent = 0;
};

[[nodiscard]] Vec3d scene_from_file(const Frame& frame, const Vec3d& point_file);

// A pinhole. Position in the file's units; right, up and forward are unit length, right-handed
// (right x up = -forward).
struct Camera {
  std::string name{};
  Vec3d position_file{0.0};
  Vec3d right{1.0, 0.0, 0.0};
  Vec3d up{0.0, 1.0, 0.0};
  Vec3d forward{0.0, 0.0, -1.0};
  double vertical_fov_rad = 1.0;  // perspective, in (0, pi)
  bool orthographic = false;
  double height_file = 0.0;  // orthographic only: height of the view in the file's units
};

// glTF metallic-roughness with the extensions that the renderer models. Colours are linear.
struct Material {
  std::string name{};
  Vec3 base_color{0.8F};
  float metallic = 0.0F;      // [0,1]
  float roughness = 1.0F;     // [0,1], perceptual: GGX alpha = roughness^2
  float transmission = 0.0F;  // [0,1], share of the non-metallic base that transmits
  float ior = 1.5F;           // >= 1
  // A thin wall refracts nothing (glTF transmission without volume); otherwise the surface bounds a
  // solid of index `ior`, outside = the side of the geometric normal.
  bool thin_walled = true;
  Vec3 specular_color{1.0F};  // tints the dielectric's reflection; 0 = purely diffuse
  Vec3 emission{0.0F};        // radiance [W/(sr m^2)]
  bool double_sided = true;   // emits and reflects on the back too
};

enum class PunctualLightKind : std::uint8_t { kPoint = 0, kSpot = 1, kDirectional = 2 };

// KHR_lights_punctual in the scene frame.
struct PunctualLight {
  PunctualLightKind kind = PunctualLightKind::kPoint;
  Vec3 position{0.0F};                // point, spot
  Vec3 direction{0.0F, 0.0F, -1.0F};  // the way the light travels, unit; spot, directional
  // Point and spot: radiant intensity times 4^scale_exponent, so that intensity / distance^2 with
  // the distance in scene units is irradiance. Directional: irradiance on a facing surface.
  Vec3 intensity{0.0F};
  float range = 0.0F;      // scene units; 0 = without end. The glTF window function applies.
  float cos_inner = 1.0F;  // spot
  float cos_outer = 0.0F;  // spot
};

struct Triangle {
  std::array<std::uint32_t, 3> vertices{};  // into Scene::positions
  std::uint32_t material = 0;
};

// What the importer did to the file, for the report.
struct ImportReport {
  std::uint64_t triangles_declared = 0;
  std::uint64_t triangles_non_finite = 0;  // dropped
  std::uint64_t triangles_zero_area = 0;   // dropped
  std::vector<std::string> notes{};        // one sentence for each thing left out, e.g. textures
};

struct Scene {
  Frame frame{};
  std::vector<Vec3> positions{};  // [vertex_count], |coordinate| <= 1
  std::vector<Vec3> normals{};    // [vertex_count] unit shading normals, 0 where the file has none
  std::vector<Triangle> triangles{};  // its index is the global triangle id
  std::vector<Material> materials{};  // at least one
  std::vector<PunctualLight> lights{};
  std::vector<Camera> cameras{};
  ImportReport import{};
};

}  // namespace preheat
