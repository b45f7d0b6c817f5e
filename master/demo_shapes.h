// Shapes that the demo is made of, as triangles of a Scene: boxes, lathed objects, tubes, cloth.
//
// Only + - * / and sqrt are used, sines included, so that the scene is the same to the bit on every
// machine. Lengths are metres, y is up, and every closed shape has its normals outwards.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/scene.h"
#include "common/vec3.h"

namespace preheat {

// Of an angle in full turns.
[[nodiscard]] double sine_of_turns(double turns);
[[nodiscard]] double cosine_of_turns(double turns);

// SplitMix64 (Steele, Lea, Flood 2014).
class DemoRandom {
 public:
  explicit DemoRandom(std::uint64_t seed) : state_(seed) {}
  [[nodiscard]] std::uint64_t next();
  [[nodiscard]] double between(double low, double high);
  [[nodiscard]] std::size_t below(std::size_t count) { return next() % count; }

 private:
  std::uint64_t state_;
};

// Where a shape's own coordinates lie in the room.
struct Placement {
  Vec3d origin{0.0};
  Vec3d x{1.0, 0.0, 0.0};
  Vec3d y{0.0, 1.0, 0.0};
  Vec3d z{0.0, 0.0, 1.0};

  [[nodiscard]] Vec3d operator()(const Vec3d& local) const {
    return origin + x * local.x + y * local.y + z * local.z;
  }
  // A placement within this one.
  [[nodiscard]] Placement operator*(const Placement& inner) const;
};

[[nodiscard]] Placement placed_at(const Vec3d& origin);
// Turned about the vertical axis, and scaled.
[[nodiscard]] Placement turned(const Vec3d& origin, double turns, double scale = 1.0);
// The y axis along `direction`, turned about it by `turns`.
[[nodiscard]] Placement pointing(const Vec3d& origin, const Vec3d& direction, double turns = 0.0);

// Distance from the axis, height along it.
struct ProfilePoint {
  double radius;
  double height;
};
using Profile = std::vector<ProfilePoint>;

// A Catmull-Rom spline through the points, `steps` pieces between each two.
[[nodiscard]] Profile smooth_profile(const Profile& points, std::size_t steps);
[[nodiscard]] std::vector<Vec3d> smooth_path(const std::vector<Vec3d>& points, std::size_t steps);

// Rows of points that neighbours in space; the last column meets the first if `wraps`.
struct SurfaceGrid {
  std::size_t rows = 0;
  std::size_t columns = 0;
  bool wraps = false;
  std::vector<Vec3d> points{};  // [rows * columns]
};

// Adds triangles to a scene. `detail` is how many times finer than at a million triangles a curved
// surface is cut along each side.
class DemoBuilder {
 public:
  DemoBuilder(Scene& scene, double detail) : scene_(scene), detail_(detail) {}

  // A count that grows with the detail.
  [[nodiscard]] std::size_t fine(double count) const;
  [[nodiscard]] std::size_t triangle_count() const { return scene_.triangles.size(); }

  void triangle(const Vec3d& a, const Vec3d& b, const Vec3d& c, std::uint32_t material);
  // Counter-clockwise seen from the side that its normal points to.
  void quad(const Vec3d& a, const Vec3d& b, const Vec3d& c, const Vec3d& d, std::uint32_t material);
  void box(const Placement& placement, const Vec3d& low, const Vec3d& high, std::uint32_t material);
  // Smooth. Rows go along the first tangent, columns along the second; normal = first x second.
  void surface(const SurfaceGrid& grid, const Placement& placement, std::uint32_t material);
  // The profile turned about y. Going up it faces outwards, going down towards the axis.
  void lathe(const Profile& profile, std::size_t segments, const Placement& placement,
             std::uint32_t material);
  void sphere(const Vec3d& centre, double radius, std::size_t segments, std::uint32_t material);
  // A cushion: a box with half extents, its edges rounded off, puffed up in the middle.
  void cushion(const Placement& placement, const Vec3d& half, std::uint32_t material);
  // A tube along a path, its radius going from the first to the second, closed at both ends.
  void tube(std::span<const Vec3d> path, double radius_begin, double radius_end,
            std::size_t segments, std::uint32_t material);
  // A leaf of the given length along y and width along x, folded and bent towards z.
  void leaf(const Placement& placement, double length, double width, double bend,
            std::size_t pieces, std::uint32_t material);

 private:
  std::uint32_t vertex(const Vec3d& position, const Vec3d& normal);
  void indexed_triangle(std::uint32_t a, std::uint32_t b, std::uint32_t c, std::uint32_t material);

  Scene& scene_;
  double detail_;
};

}  // namespace preheat
