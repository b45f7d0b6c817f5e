#include "master/polygon.h"

#include <cmath>
#include <numeric>

namespace preheat {

namespace {

struct Point {
  double x = 0.0;
  double y = 0.0;
};

// Twice the signed area of a triangle.
double cross(const Point& a, const Point& b, const Point& c) {
  return (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
}

// The polygon along the largest axis of its normal, counter-clockwise.
std::vector<Point> project(std::span<const Vec3d> vertices) {
  Vec3d normal{0.0};
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    // Relative to a vertex, so that a polygon far from the origin keeps its digits.
    const Vec3d a = vertices[i] - vertices[0];
    const Vec3d b = vertices[(i + 1) % vertices.size()] - vertices[0];
    normal += glm::cross(a, b);
  }
  const Vec3d size{std::abs(normal.x), std::abs(normal.y), std::abs(normal.z)};
  const int axis = size.x > size.y && size.x > size.z ? 0 : (size.y > size.z ? 1 : 2);
  int u = (axis + 1) % 3;
  int v = (axis + 2) % 3;
  if (normal[axis] < 0.0) { std::swap(u, v); }
  std::vector<Point> points;
  points.reserve(vertices.size());
  for (const Vec3d& vertex : vertices) {
    const Vec3d local = vertex - vertices[0];
    points.push_back({local[u], local[v]});
  }
  return points;
}

bool is_convex(const std::vector<Point>& points) {
  const std::size_t count = points.size();
  for (std::size_t i = 0; i < count; ++i) {
    if (cross(points[i], points[(i + 1) % count], points[(i + 2) % count]) < 0.0) { return false; }
  }
  return true;
}

// Whether the corner at `tip` can be cut off: it turns left and no other vertex lies in it.
bool is_ear(const std::vector<Point>& points, const std::vector<std::uint32_t>& left,
            std::size_t tip) {
  const std::size_t before = (tip + left.size() - 1) % left.size();
  const std::size_t after = (tip + 1) % left.size();
  const Point& a = points[left[before]];
  const Point& b = points[left[tip]];
  const Point& c = points[left[after]];
  if (!(cross(a, b, c) > 0.0)) { return false; }
  for (std::size_t i = 0; i < left.size(); ++i) {
    if (i == before || i == tip || i == after) { continue; }
    const Point& p = points[left[i]];
    if (cross(a, b, p) >= 0.0 && cross(b, c, p) >= 0.0 && cross(c, a, p) >= 0.0) { return false; }
  }
  return true;
}

}  // namespace

bool triangulate_polygon(std::span<const Vec3d> vertices,
                         std::vector<std::array<std::uint32_t, 3>>& triangles) {
  std::vector<std::uint32_t> left(vertices.size());
  std::iota(left.begin(), left.end(), 0U);
  if (vertices.size() > 3) {
    const std::vector<Point> points = project(vertices);
    const bool convex = is_convex(points);
    if (!convex && vertices.size() > kConcavePolygonVerticesMax) { return false; }
    // Once round without an ear: what is left crosses itself and becomes a fan.
    std::size_t tip = 0;
    for (std::size_t tries = 0; !convex && left.size() > 3 && tries < left.size();) {
      tip %= left.size();
      if (!is_ear(points, left, tip)) {
        ++tip;
        ++tries;
        continue;
      }
      const std::size_t before = (tip + left.size() - 1) % left.size();
      const std::size_t after = (tip + 1) % left.size();
      triangles.push_back({left[before], left[tip], left[after]});
      left.erase(left.begin() + static_cast<std::ptrdiff_t>(tip));
      tries = 0;
    }
  }
  for (std::size_t i = 1; i + 1 < left.size(); ++i) {
    triangles.push_back({left[0], left[i], left[i + 1]});
  }
  return true;
}

}  // namespace preheat
