#include "master/demo_shapes.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace preheat {
namespace {

constexpr double kTwoPi = 6.28318530717958647692;

// The perpendicular that is furthest from being parallel to one of the axes.
Vec3d any_perpendicular(const Vec3d& unit) {
  const Vec3d axis = std::abs(unit.y) < 0.9 ? Vec3d(0.0, 1.0, 0.0) : Vec3d(1.0, 0.0, 0.0);
  return glm::normalize(glm::cross(axis, unit));
}

Vec3d catmull_rom(const std::array<Vec3d, 4>& p, double t) {
  const double t2 = t * t;
  const double t3 = t2 * t;
  return 0.5 *
         (2.0 * p[1] + (p[2] - p[0]) * t + (2.0 * p[0] - 5.0 * p[1] + 4.0 * p[2] - p[3]) * t2 +
          (3.0 * p[1] - p[0] - 3.0 * p[2] + p[3]) * t3);
}

// Sign-keeping power by whole halves: |v|^(n/2).
double soft_power(double value) {
  const double magnitude = std::sqrt(std::abs(value));
  return value < 0.0 ? -magnitude : magnitude;
}

// Vertex normals of a grid by central differences; a row that is one point takes its neighbour's.
std::vector<Vec3d> grid_normals(const SurfaceGrid& grid) {
  std::vector<Vec3d> normals(grid.points.size());
  const auto at = [&](std::size_t row, std::size_t column) {
    return grid.points[row * grid.columns + column];
  };
  for (std::size_t row = 0; row < grid.rows; ++row) {
    const std::size_t above = std::min(row + 1, grid.rows - 1);
    const std::size_t below = row == 0 ? 0 : row - 1;
    for (std::size_t column = 0; column < grid.columns; ++column) {
      const std::size_t last = grid.columns - 1;
      const std::size_t next = column < last ? column + 1 : grid.wraps ? 0 : last;
      const std::size_t previous = column > 0 ? column - 1 : grid.wraps ? last : 0;
      const Vec3d along = at(above, column) - at(below, column);
      const std::size_t around_row = at(row, next) != at(row, previous) ? row
                                     : row == 0                         ? above
                                                                        : below;
      const Vec3d around = at(around_row, next) - at(around_row, previous);
      const Vec3d normal = glm::cross(along, around);
      const double length = glm::length(normal);
      normals[row * grid.columns + column] = length > 0.0 ? normal / length : Vec3d(0.0);
    }
  }
  return normals;
}

}  // namespace

double sine_of_turns(double turns) {
  const double nearest = std::floor(turns + 0.5);
  double angle = (turns - nearest) * kTwoPi;  // in [-pi, pi]
  if (angle > kTwoPi / 4.0) { angle = kTwoPi / 2.0 - angle; }
  if (angle < -kTwoPi / 4.0) { angle = -kTwoPi / 2.0 - angle; }
  const double square = angle * angle;
  double term = angle;
  double sum = angle;
  for (int n = 1; n < 11; ++n) {
    term *= -square / static_cast<double>((2 * n) * (2 * n + 1));
    sum += term;
  }
  return sum;
}

double cosine_of_turns(double turns) { return sine_of_turns(turns + 0.25); }

std::uint64_t DemoRandom::next() {
  state_ += 0x9e3779b97f4a7c15U;
  std::uint64_t z = state_;
  z = (z ^ (z >> 30U)) * 0xbf58476d1ce4e5b9U;
  z = (z ^ (z >> 27U)) * 0x94d049bb133111ebU;
  return z ^ (z >> 31U);
}

double DemoRandom::between(double low, double high) {
  return low + (high - low) * static_cast<double>(next() >> 11U) * 0x1p-53;
}

Placement Placement::operator*(const Placement& inner) const {
  const auto rotate = [this](const Vec3d& v) { return x * v.x + y * v.y + z * v.z; };
  return {(*this)(inner.origin), rotate(inner.x), rotate(inner.y), rotate(inner.z)};
}

Placement placed_at(const Vec3d& origin) { return {origin}; }

Placement turned(const Vec3d& origin, double turns, double scale) {
  const double c = cosine_of_turns(turns) * scale;
  const double s = sine_of_turns(turns) * scale;
  return {origin, Vec3d(c, 0.0, -s), Vec3d(0.0, scale, 0.0), Vec3d(s, 0.0, c)};
}

Placement pointing(const Vec3d& origin, const Vec3d& direction, double turns) {
  const Vec3d y = glm::normalize(direction);
  const Vec3d side = any_perpendicular(y);
  const Vec3d x = side * cosine_of_turns(turns) + glm::cross(y, side) * sine_of_turns(turns);
  return {origin, x, y, glm::cross(x, y)};
}

std::vector<Vec3d> smooth_path(const std::vector<Vec3d>& points, std::size_t steps) {
  std::vector<Vec3d> path;
  const std::size_t last = points.size() - 1;
  for (std::size_t span = 0; span < last; ++span) {
    const std::array<Vec3d, 4> near = {points[span == 0 ? 0 : span - 1], points[span],
                                       points[span + 1], points[std::min(span + 2, last)]};
    for (std::size_t step = 0; step < steps; ++step) {
      path.push_back(catmull_rom(near, static_cast<double>(step) / static_cast<double>(steps)));
    }
  }
  path.push_back(points[last]);
  return path;
}

Profile smooth_profile(const Profile& points, std::size_t steps) {
  std::vector<Vec3d> path;
  for (const ProfilePoint& point : points) { path.emplace_back(point.radius, point.height, 0.0); }
  Profile profile;
  for (const Vec3d& point : smooth_path(path, steps)) {
    profile.push_back({std::max(0.0, point.x), point.y});
  }
  return profile;
}

std::size_t DemoBuilder::fine(double count) const {
  return static_cast<std::size_t>(std::max(3.0, count * detail_ + 0.5));
}

std::uint32_t DemoBuilder::vertex(const Vec3d& position, const Vec3d& normal) {
  scene_.positions.push_back(Vec3(scene_from_file(scene_.frame, position)));
  scene_.normals.push_back(Vec3(normal));
  return static_cast<std::uint32_t>(scene_.positions.size() - 1);
}

void DemoBuilder::indexed_triangle(std::uint32_t a, std::uint32_t b, std::uint32_t c,
                                   std::uint32_t material) {
  const auto at = [this](std::uint32_t index) { return Vec3d(scene_.positions[index]); };
  const Vec3d cross = glm::cross(at(b) - at(a), at(c) - at(a));
  if (!(glm::dot(cross, cross) > 0.0)) { return; }  // at a pole
  scene_.triangles.push_back({{a, b, c}, material});
}

void DemoBuilder::triangle(const Vec3d& a, const Vec3d& b, const Vec3d& c, std::uint32_t material) {
  const std::uint32_t first = vertex(a, Vec3d(0.0));
  vertex(b, Vec3d(0.0));
  vertex(c, Vec3d(0.0));
  indexed_triangle(first, first + 1, first + 2, material);
}

void DemoBuilder::quad(const Vec3d& a, const Vec3d& b, const Vec3d& c, const Vec3d& d,
                       std::uint32_t material) {
  const std::uint32_t first = vertex(a, Vec3d(0.0));
  vertex(b, Vec3d(0.0));
  vertex(c, Vec3d(0.0));
  vertex(d, Vec3d(0.0));
  indexed_triangle(first, first + 1, first + 2, material);
  indexed_triangle(first, first + 2, first + 3, material);
}

void DemoBuilder::box(const Placement& placement, const Vec3d& low, const Vec3d& high,
                      std::uint32_t material) {
  std::array<Vec3d, 8> corner{};
  for (std::size_t index = 0; index < corner.size(); ++index) {
    corner[index] =
        placement(Vec3d((index & 1U) != 0 ? high.x : low.x, (index & 2U) != 0 ? high.y : low.y,
                        (index & 4U) != 0 ? high.z : low.z));
  }
  constexpr std::size_t kFaces[6][4] = {{0, 4, 6, 2}, {1, 3, 7, 5}, {0, 1, 5, 4},
                                        {2, 6, 7, 3}, {0, 2, 3, 1}, {4, 5, 7, 6}};
  for (const auto& face : kFaces) {
    quad(corner[face[0]], corner[face[1]], corner[face[2]], corner[face[3]], material);
  }
}

void DemoBuilder::surface(const SurfaceGrid& grid, const Placement& placement,
                          std::uint32_t material) {
  SurfaceGrid in_room = grid;
  for (Vec3d& point : in_room.points) { point = placement(point); }
  const std::vector<Vec3d> normals = grid_normals(in_room);
  const auto first = static_cast<std::uint32_t>(scene_.positions.size());
  for (std::size_t index = 0; index < normals.size(); ++index) {
    vertex(in_room.points[index], normals[index]);
  }
  const std::size_t column_quads = grid.wraps ? grid.columns : grid.columns - 1;
  const auto at = [&](std::size_t row, std::size_t column) {
    return first + static_cast<std::uint32_t>(row * grid.columns + column % grid.columns);
  };
  for (std::size_t row = 0; row + 1 < grid.rows; ++row) {
    for (std::size_t column = 0; column < column_quads; ++column) {
      indexed_triangle(at(row, column), at(row + 1, column), at(row, column + 1), material);
      indexed_triangle(at(row + 1, column), at(row + 1, column + 1), at(row, column + 1), material);
    }
  }
}

void DemoBuilder::lathe(const Profile& profile, std::size_t segments, const Placement& placement,
                        std::uint32_t material) {
  SurfaceGrid grid{profile.size(), segments, true, {}};
  for (const ProfilePoint& point : profile) {
    for (std::size_t segment = 0; segment < segments; ++segment) {
      const double turns = static_cast<double>(segment) / static_cast<double>(segments);
      grid.points.emplace_back(point.radius * cosine_of_turns(turns), point.height,
                               point.radius * sine_of_turns(turns));
    }
  }
  surface(grid, placement, material);
}

void DemoBuilder::sphere(const Vec3d& centre, double radius, std::size_t segments,
                         std::uint32_t material) {
  Profile profile;
  const std::size_t rows = std::max<std::size_t>(segments / 2, 3);
  for (std::size_t row = 0; row <= rows; ++row) {
    const double turns = 0.5 * static_cast<double>(row) / static_cast<double>(rows);
    const bool is_pole = row == 0 || row == rows;
    profile.push_back(
        {is_pole ? 0.0 : radius * sine_of_turns(turns), -radius * cosine_of_turns(turns)});
  }
  lathe(profile, segments, placed_at(centre), material);
}

void DemoBuilder::cushion(const Placement& placement, const Vec3d& half, std::uint32_t material) {
  SurfaceGrid grid{fine(24), fine(48), true, {}};
  for (std::size_t row = 0; row < grid.rows; ++row) {
    const double v = 0.5 * static_cast<double>(row) / static_cast<double>(grid.rows - 1);
    const bool is_pole = row == 0 || row + 1 == grid.rows;
    const double ring = is_pole ? 0.0 : soft_power(sine_of_turns(v));
    const double height = -soft_power(cosine_of_turns(v));
    for (std::size_t column = 0; column < grid.columns; ++column) {
      const double u = static_cast<double>(column) / static_cast<double>(grid.columns);
      const double x = ring * soft_power(cosine_of_turns(u));
      const double z = ring * soft_power(sine_of_turns(u));
      const double puff = 0.8 + 0.2 * (1.0 - x * x) * (1.0 - z * z);
      grid.points.emplace_back(half.x * x, half.y * height * puff, half.z * z);
    }
  }
  surface(grid, placement, material);
}

void DemoBuilder::tube(std::span<const Vec3d> path, double radius_begin, double radius_end,
                       std::size_t segments, std::uint32_t material) {
  SurfaceGrid grid{path.size() + 2, segments, true, {}};
  Vec3d side = any_perpendicular(glm::normalize(path[1] - path[0]));
  const auto add_ring = [&](const Vec3d& centre, const Vec3d& tangent, double radius) {
    const Vec3d other = glm::cross(tangent, side);
    for (std::size_t segment = 0; segment < segments; ++segment) {
      // Against the lathe's sense: here the path, there the profile is the first tangent.
      const double turns = -static_cast<double>(segment) / static_cast<double>(segments);
      grid.points.push_back(
          centre + (side * cosine_of_turns(turns) + other * sine_of_turns(turns)) * radius);
    }
  };
  for (std::size_t index = 0; index < path.size(); ++index) {
    const Vec3d tangent = glm::normalize(path[std::min(index + 1, path.size() - 1)] -
                                         path[index == 0 ? 0 : index - 1]);
    // Carried along the path, so that the tube does not twist.
    side = glm::normalize(side - tangent * glm::dot(side, tangent));
    const double share = static_cast<double>(index) / static_cast<double>(path.size() - 1);
    if (index == 0) { add_ring(path[0], tangent, 0.0); }
    add_ring(path[index], tangent, radius_begin + (radius_end - radius_begin) * share);
    if (index + 1 == path.size()) { add_ring(path[index], tangent, 0.0); }
  }
  surface(grid, Placement{}, material);
}

void DemoBuilder::leaf(const Placement& placement, double length, double width, double bend,
                       std::size_t pieces, std::uint32_t material) {
  SurfaceGrid grid{pieces + 1, 3, false, {}};
  for (std::size_t row = 0; row <= pieces; ++row) {
    const double t = static_cast<double>(row) / static_cast<double>(pieces);
    // Widest at two fifths; a point at both ends.
    const double half = width * 0.5 * 2.95 * t * (1.0 - t) * (1.5 - t) + (row == 0 ? 1e-4 : 0.0);
    const double droop = bend * length * t * t;
    const double y = length * t * (1.0 - 0.3 * bend * t);
    grid.points.emplace_back(-half, y, -droop + 0.35 * half);
    grid.points.emplace_back(0.0, y, -droop);
    grid.points.emplace_back(half, y, -droop + 0.35 * half);
  }
  surface(grid, placement, material);
}

}  // namespace preheat
