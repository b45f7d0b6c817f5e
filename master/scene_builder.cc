#include "master/scene_builder.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

namespace preheat {

namespace {

// Compiling needs at least this much per triangle: the scene, and the octree's references.
constexpr std::uint64_t kTriangleBytes = 64;
constexpr std::uint64_t kTrianglesMax = 0xFFFFFFFEU;  // triangle ids are 32 bits wide
// A coordinate grid coarser than this share of a triangle's longest edge begins to show in its
// normal. A tenth of it already holds for half of an ordinary meeting room's triangles.
constexpr double kSpacingShareMax = 1e-3;

tl::unexpected<Error> rejected(std::string message) {
  return fail(ExitCode::kSceneRejected, std::move(message));
}

bool is_finite(const Vec3d& v) {
  return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z);
}

double length_squared(const Vec3d& v) { return v.x * v.x + v.y * v.y + v.z * v.z; }

// What the first pass learns.
struct Survey {
  Vec3d low{std::numeric_limits<double>::infinity()};
  Vec3d high{-std::numeric_limits<double>::infinity()};
  std::uint64_t triangles = 0;  // with finite vertices
  std::uint64_t coarse = 0;     // of these, with too coarse a coordinate grid
};

Result<std::array<Vec3d, 3>> corners(const WorldMesh& mesh, std::uint64_t index,
                                     const Triangle& triangle) {
  for (const std::uint32_t vertex : triangle.vertices) {
    if (vertex >= mesh.vertex_count()) {
      return rejected(fmt::format("{}: triangle {} has vertex index {}, but there are {} vertices",
                                  mesh.label(), index, vertex, mesh.vertex_count()));
    }
  }
  return std::array<Vec3d, 3>{mesh.position(triangle.vertices[0]),
                              mesh.position(triangle.vertices[1]),
                              mesh.position(triangle.vertices[2])};
}

Result<void> survey_mesh(const WorldMesh& mesh, Survey& survey) {
  const std::uint64_t count = mesh.triangle_count();
  for (std::uint64_t i = 0; i < count; ++i) {
    const Triangle triangle = mesh.triangle(i);
    const auto points = corners(mesh, i, triangle);
    if (!points) { return tl::unexpected(points.error()); }
    const auto& [a, b, c] = *points;
    if (!is_finite(a) || !is_finite(b) || !is_finite(c)) { continue; }
    ++survey.triangles;
    for (const Vec3d& point : *points) {
      for (int axis = 0; axis < 3; ++axis) {
        survey.low[axis] = std::min(survey.low[axis], point[axis]);
        survey.high[axis] = std::max(survey.high[axis], point[axis]);
      }
    }
    const double edge_squared =
        std::max({length_squared(b - a), length_squared(c - b), length_squared(a - c)});
    const double spacing = mesh.coordinate_spacing(triangle.vertices[0]);
    const double limit_squared = kSpacingShareMax * kSpacingShareMax * edge_squared;
    if (edge_squared > 0.0 && spacing * spacing > limit_squared) { ++survey.coarse; }
  }
  return {};
}

// Scales the longest half-extent into (0.5, 1]. A power of two changes no mantissa.
Result<Frame> choose_frame(const Survey& survey) {
  double half_extent = 0.0;
  Frame frame;
  for (int axis = 0; axis < 3; ++axis) {
    half_extent = std::max(half_extent, survey.high[axis] * 0.5 - survey.low[axis] * 0.5);
    frame.centre[axis] = survey.low[axis] * 0.5 + survey.high[axis] * 0.5;
    const double farthest = std::max(std::abs(survey.low[axis]), std::abs(survey.high[axis]));
    if (farthest > kSceneExtentMax) {
      return rejected(fmt::format("a coordinate of {:.3g} is beyond the limit of {:.0e} units",
                                  farthest, kSceneExtentMax));
    }
  }
  if (half_extent * 2.0 < kSceneExtentMin) {
    return rejected(fmt::format("the scene's extent of {:.3g} units is too small: at least {:.0e}",
                                half_extent * 2.0, kSceneExtentMin));
  }
  int exponent = 0;
  const double mantissa = std::frexp(half_extent, &exponent);
  frame.scale_exponent = mantissa == 0.5 ? 1 - exponent : -exponent;
  return frame;
}

// Fills the scene's vertex and triangle arrays. A mesh's vertices are shared by its triangles and
// only those that a kept triangle uses are stored.
class Emitter {
 public:
  Emitter(Scene& scene, std::uint64_t triangle_count) : scene_(scene) {
    scene_.triangles.reserve(triangle_count);
  }

  Result<void> emit(const WorldMesh& mesh) {
    ++mesh_number_;
    slots_.resize(std::max<std::size_t>(slots_.size(), mesh.vertex_count()));
    const std::uint64_t count = mesh.triangle_count();
    for (std::uint64_t i = 0; i < count; ++i) {
      const Triangle triangle = mesh.triangle(i);
      const auto points = corners(mesh, i, triangle);
      if (!points) { return tl::unexpected(points.error()); }
      add(mesh, triangle, *points);
    }
    return {};
  }

 private:
  // Where a vertex of the current mesh went. The mesh's number saves clearing all slots for each.
  struct Slot {
    std::uint32_t mesh_number = 0;
    std::uint32_t vertex = 0;
  };

  void add(const WorldMesh& mesh, const Triangle& triangle, const std::array<Vec3d, 3>& points) {
    std::array<Vec3, 3> rounded{};
    for (std::size_t corner = 0; corner < 3; ++corner) {
      if (!is_finite(points[corner])) {
        ++scene_.import.triangles_non_finite;
        return;
      }
      rounded[corner] = to_scene(points[corner]);
    }
    if (!has_area(rounded)) {
      ++scene_.import.triangles_zero_area;
      return;
    }
    Triangle& added = scene_.triangles.emplace_back();
    added.material = triangle.material;
    for (std::size_t corner = 0; corner < 3; ++corner) {
      Slot& slot = slots_[triangle.vertices[corner]];
      if (slot.mesh_number != mesh_number_) {
        slot = {mesh_number_, static_cast<std::uint32_t>(scene_.positions.size())};
        scene_.positions.push_back(rounded[corner]);
        scene_.normals.push_back(unit_or_zero(mesh.normal(triangle.vertices[corner])));
      }
      added.vertices[corner] = slot.vertex;
    }
  }

  [[nodiscard]] Vec3 to_scene(const Vec3d& point_file) const {
    Vec3d point = scene_from_file(scene_.frame, point_file);
    // The centre is rounded, so the farthest vertex may be a last bit beyond 1.
    for (int axis = 0; axis < 3; ++axis) { point[axis] = std::clamp(point[axis], -1.0, 1.0); }
    return Vec3(point);
  }

  // Whether the normal that shading computes in float is one: its square must not underflow.
  static bool has_area(const std::array<Vec3, 3>& points) {
    const Vec3 normal = glm::cross(points[1] - points[0], points[2] - points[0]);
    return glm::dot(normal, normal) >= std::numeric_limits<float>::min();
  }

  static Vec3 unit_or_zero(const Vec3d& normal) {
    const double length = std::sqrt(length_squared(normal));
    if (!std::isfinite(length) || length == 0.0) { return Vec3(0.0F); }
    return Vec3(normal / length);
  }

  Scene& scene_;
  std::vector<Slot> slots_;
  std::uint32_t mesh_number_ = 0;
};

Result<std::uint64_t> count_triangles(const SceneDraft& draft) {
  const auto memory_bytes = static_cast<std::uint64_t>(::sysconf(_SC_PHYS_PAGES)) *
                            static_cast<std::uint64_t>(::sysconf(_SC_PAGESIZE));
  const std::uint64_t limit = std::min(kTrianglesMax, memory_bytes / kTriangleBytes);
  std::uint64_t count = 0;
  for (const auto& mesh : draft.meshes) {
    count += mesh->triangle_count();
    if (count > limit) {
      return rejected(
          fmt::format("more than {} triangles: more than this machine's memory holds", limit));
    }
  }
  if (count == 0) { return rejected("the scene holds no triangles"); }
  return count;
}

Result<PunctualLight> light_in_frame(const WorldLight& source, const Frame& frame) {
  PunctualLight light = source.light;
  Vec3d intensity = source.intensity_file;
  if (light.kind != PunctualLightKind::kDirectional) {
    light.position = Vec3(scene_from_file(frame, source.position_file));
    light.range = static_cast<float>(std::ldexp(source.range_file, frame.scale_exponent));
    intensity *= std::ldexp(1.0, 2 * frame.scale_exponent);
  }
  light.intensity = Vec3(intensity);
  for (int axis = 0; axis < 3; ++axis) {
    if (!std::isfinite(light.intensity[axis]) || !std::isfinite(light.position[axis])) {
      return rejected("a light's intensity or position leaves the range of float");
    }
  }
  return light;
}

void add_counted_notes(const Survey& survey, Scene& scene) {
  ImportReport& report = scene.import;
  if (survey.coarse * 2 > survey.triangles) {
    report.notes.push_back(fmt::format(
        "the file's coordinates are too coarse for {} of {} triangles: floats that far from the "
        "origin are more than {:.0e} of an edge apart",
        survey.coarse, survey.triangles, kSpacingShareMax));
  }
  const std::uint64_t dropped = report.triangles_non_finite + report.triangles_zero_area;
  if (dropped * 2 > report.triangles_declared) {
    report.notes.push_back(fmt::format("{} of {} triangles have no area or a NaN vertex", dropped,
                                       report.triangles_declared));
  }
}

}  // namespace

Result<Scene> build_scene(SceneDraft draft) {
  const auto triangle_count = count_triangles(draft);
  if (!triangle_count) { return tl::unexpected(triangle_count.error()); }
  Survey survey;
  for (const auto& mesh : draft.meshes) {
    if (auto done = survey_mesh(*mesh, survey); !done) { return tl::unexpected(done.error()); }
  }
  if (survey.triangles == 0) { return rejected("every triangle has a NaN or infinite vertex"); }
  const auto frame = choose_frame(survey);
  if (!frame) { return tl::unexpected(frame.error()); }

  Scene scene;
  scene.frame = *frame;
  scene.materials = std::move(draft.materials);
  scene.cameras = std::move(draft.cameras);
  scene.import.triangles_declared = *triangle_count;
  scene.import.notes = std::move(draft.notes);
  Emitter emitter(scene, *triangle_count);
  for (const auto& mesh : draft.meshes) {
    if (auto done = emitter.emit(*mesh); !done) { return tl::unexpected(done.error()); }
  }
  if (scene.triangles.empty()) { return rejected("no triangle has an area"); }
  for (const WorldLight& source : draft.lights) {
    auto light = light_in_frame(source, scene.frame);
    if (!light) { return tl::unexpected(light.error()); }
    scene.lights.push_back(*light);
  }
  add_counted_notes(survey, scene);
  return scene;
}

}  // namespace preheat
