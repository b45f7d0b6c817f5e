#include "master/view.h"

#include <fmt/format.h>

#include <charconv>
#include <cmath>
#include <optional>

namespace preheat {
namespace {

constexpr double kPi = 3.14159265358979323846;

struct Sphere {
  Vec3d centre{0.0};
  double radius = 1.0;
};

// Around the scene's voxels, in the file's units.
Sphere sphere_around(const SceneTables& tables) {
  if (tables.voxel_nodes.empty()) { return {tables.frame.centre, 1.0}; }
  const Aabb& bounds = tables.voxel_nodes[0].bounds;
  const double file_from_scene = std::ldexp(1.0, -tables.frame.scale_exponent);
  const Vec3d low = Vec3d(bounds.low) * file_from_scene + tables.frame.centre;
  const Vec3d high = Vec3d(bounds.high) * file_from_scene + tables.frame.centre;
  return {(low + high) * 0.5, glm::length(high - low) * 0.5};
}

// Turns the camera to `forward`, as upright as `up` says.
bool orient(Camera& camera, const Vec3d& forward, const Vec3d& up) {
  const double distance = glm::length(forward);
  const Vec3d right = glm::cross(forward, up);
  const double sine = glm::length(right);
  if (!(distance > 0.0) || !(sine > 1e-9 * distance * glm::length(up))) { return false; }
  camera.forward = forward / distance;
  camera.right = right / sine;
  camera.up = glm::cross(camera.right, camera.forward);
  return true;
}

// Sees the whole scene, from the front, the right and above.
Camera framing_camera(const SceneTables& tables, double aspect) {
  const Sphere sphere = sphere_around(tables);
  Camera camera;
  camera.name = "framed";
  camera.vertical_fov_rad = 40.0 * kPi / 180.0;
  orient(camera, -Vec3d(0.5, 0.4, 1.0), Vec3d(0.0, 1.0, 0.0));
  const double half_narrow =
      std::atan(std::tan(camera.vertical_fov_rad * 0.5) * std::min(aspect, 1.0));
  camera.position_file = sphere.centre - camera.forward * (sphere.radius / std::sin(half_narrow));
  return camera;
}

std::optional<std::size_t> find_camera(const std::vector<Camera>& cameras,
                                       const std::string& wanted) {
  for (std::size_t index = 0; index < cameras.size(); ++index) {
    if (cameras[index].name == wanted) { return index; }
  }
  std::size_t index = 0;
  const char* const end = wanted.data() + wanted.size();
  const auto [rest, error] = std::from_chars(wanted.data(), end, index);
  if (error != std::errc{} || rest != end || index >= cameras.size()) { return std::nullopt; }
  return index;
}

tl::unexpected<Error> unknown_camera(const std::vector<Camera>& cameras,
                                     const std::string& wanted) {
  std::string known;
  for (std::size_t index = 0; index < cameras.size(); ++index) {
    known += fmt::format("{}{} '{}'", index == 0 ? "" : ", ", index, cameras[index].name);
  }
  return fail(ExitCode::kUsage, fmt::format("--camera {}: the scene has {}", wanted,
                                            known.empty() ? "no camera" : known));
}

// Applies --eye, --look-at, --up and --fov to the camera that was found.
Result<void> adjust(Camera& camera, bool is_framed, const Vec3d& centre,
                    const ViewOptions& options) {
  if (options.fov_deg) {
    camera.vertical_fov_rad = *options.fov_deg * kPi / 180.0;
    camera.orthographic = false;
  }
  if (options.eye) { camera.position_file = *options.eye; }
  if (!options.eye && !options.look_at && !options.up) { return {}; }

  Vec3d forward = camera.forward;
  if (options.look_at) {
    forward = *options.look_at - camera.position_file;
  } else if (options.eye && is_framed) {
    forward = centre - camera.position_file;
  }
  if (orient(camera, forward, options.up.value_or(Vec3d(0.0, 1.0, 0.0)))) { return {}; }
  if (!(glm::length(forward) > 0.0)) {
    return fail(ExitCode::kUsage, "--eye and the point looked at are the same");
  }
  // Straight up or down: any other upward direction will do, unless one was asked for.
  if (!options.up && orient(camera, forward, Vec3d(0.0, 0.0, -1.0))) { return {}; }
  return fail(ExitCode::kUsage, "--up is zero or points along the view");
}

// From farther away a coordinate's square is none in float, and no ray would meet anything.
constexpr float kOriginMax = 1e18F;

bool is_in_reach(const View& view) {
  const Vec3 distance = glm::abs(view.origin);
  return distance.x <= kOriginMax && distance.y <= kOriginMax && distance.z <= kOriginMax;
}

std::string color_text(const Vec3& color) {
  return fmt::format("{},{},{}", color.x, color.y, color.z);
}

}  // namespace

Result<ResolvedView> resolve_view(const SceneTables& tables, const std::vector<Camera>& cameras,
                                  const ViewOptions& options) {
  const double aspect =
      static_cast<double>(options.size.width) / static_cast<double>(options.size.height);
  ResolvedView resolved;
  std::optional<std::size_t> chosen;
  if (!cameras.empty()) { chosen = 0; }
  if (options.camera) {
    chosen = find_camera(cameras, *options.camera);
    if (!chosen) { return unknown_camera(cameras, *options.camera); }
  }
  resolved.camera = chosen ? cameras[*chosen] : framing_camera(tables, aspect);
  resolved.camera_source = chosen ? fmt::format("camera {} '{}'", *chosen, cameras[*chosen].name)
                                  : std::string("framed: the scene has no camera");
  if (auto adjusted =
          adjust(resolved.camera, !chosen.has_value(), sphere_around(tables).centre, options);
      !adjusted) {
    return tl::unexpected(adjusted.error());
  }
  if (options.eye || options.look_at) { resolved.camera_source = "option"; }

  RenderSettings& settings = resolved.settings;
  settings.width = options.size.width;
  settings.height = options.size.height;
  settings.spp = options.spp;
  settings.bounces = options.bounces;
  settings.seed = options.seed;
  settings.view = make_view(resolved.camera, tables.frame, settings.width, settings.height);
  if (!is_in_reach(settings.view)) {
    return fail(ExitCode::kUsage,
                fmt::format("the camera ({}) is more than {:.0e} times the scene's size away",
                            resolved.camera_source, static_cast<double>(kOriginMax)));
  }
  const bool has_light = !tables.emissive_triangles.empty() || !tables.lights.empty();
  settings.sky = options.sky.value_or(Vec3(has_light ? 0.0F : 1.0F));
  resolved.sky_source = options.sky ? "option: " + color_text(settings.sky)
                        : has_light ? "none: the scene has lights of its own"
                                    : "1,1,1: the scene has no light";
  return resolved;
}

}  // namespace preheat
