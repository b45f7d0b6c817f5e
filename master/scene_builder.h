// The last step of every importer: world triangles in the file's units -> a Scene in its own frame.
//
// Two passes over the triangles, so that none is held in double: the first finds the bounds and
// with them the frame, the second rounds every vertex to float once. Triangles with a NaN or
// infinite vertex and triangles without area are dropped and counted.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "common/result.h"
#include "common/scene.h"
#include "common/vec3.h"

namespace preheat {

// Vertices of the scene further apart than this, in the file's units, are refused: squares of
// coordinates of that size leave the range of float. Scenes smaller than its inverse likewise.
inline constexpr double kSceneExtentMax = 1e18;
inline constexpr double kSceneExtentMin = 1e-18;

// A mesh as it stands in the file's world, seen through whatever bytes the importer has.
class WorldMesh {
 public:
  WorldMesh() = default;
  WorldMesh(const WorldMesh&) = delete;
  WorldMesh& operator=(const WorldMesh&) = delete;
  virtual ~WorldMesh() = default;

  [[nodiscard]] virtual std::string label() const = 0;  // names the mesh in an error message
  [[nodiscard]] virtual std::uint32_t vertex_count() const = 0;
  [[nodiscard]] virtual std::uint64_t triangle_count() const = 0;
  // Counter-clockwise seen from outside. Its vertices may be out of range: the builder checks them,
  // in each pass anew.
  [[nodiscard]] virtual Triangle triangle(std::uint64_t triangle_index) const = 0;
  // Requires: vertex < vertex_count(), for all three.
  [[nodiscard]] virtual Vec3d position(std::uint32_t vertex) const = 0;
  [[nodiscard]] virtual Vec3d normal(std::uint32_t vertex) const = 0;  // of any length; 0 = none
  // Distance between neighbouring values of the stored coordinates, in world units; 0 = unknown.
  [[nodiscard]] virtual double coordinate_spacing(std::uint32_t vertex) const = 0;
};

// A light with its lengths in the file's units; `light` holds the rest.
struct WorldLight {
  PunctualLight light{};
  Vec3d position_file{0.0};
  Vec3d intensity_file{0.0};
  double range_file = 0.0;
};

// What an importer found in its file.
struct SceneDraft {
  std::vector<std::unique_ptr<WorldMesh>> meshes{};
  std::vector<Material> materials{};  // Triangle::material counts these
  std::vector<WorldLight> lights{};
  std::vector<Camera> cameras{};
  std::vector<std::string> notes{};
};

// Refused: an index out of range, no triangle left, an extent out of bounds, more than memory
// holds.
[[nodiscard]] Result<Scene> build_scene(SceneDraft draft);

}  // namespace preheat
