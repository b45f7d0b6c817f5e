#include "master/polygon.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

namespace preheat {
namespace {

using Triangles = std::vector<std::array<std::uint32_t, 3>>;

Vec3d twice_area(const std::vector<Vec3d>& vertices, const std::array<std::uint32_t, 3>& triangle) {
  const Vec3d& a = vertices[triangle[0]];
  return glm::cross(vertices[triangle[1]] - a, vertices[triangle[2]] - a);
}

// Of the polygon, by the triangles that its edges form with the origin.
Vec3d twice_area(const std::vector<Vec3d>& vertices) {
  Vec3d sum{0.0};
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    sum += glm::cross(vertices[i], vertices[(i + 1) % vertices.size()]);
  }
  return sum;
}

void expect_tiles_the_polygon(const std::vector<Vec3d>& vertices, const Triangles& triangles) {
  const Vec3d area = twice_area(vertices);
  ASSERT_EQ(triangles.size(), vertices.size() - 2);
  double sum = 0.0;
  for (const auto& triangle : triangles) {
    // Along the polygon's normal, so that a triangle that is turned over counts against the sum.
    EXPECT_GE(glm::dot(twice_area(vertices, triangle), area), -1e-12 * glm::dot(area, area));
    sum += glm::length(twice_area(vertices, triangle));
  }
  EXPECT_NEAR(sum, glm::length(area), 1e-9 * glm::length(area));
}

TEST(TriangulatePolygon, KeepsATriangle) {
  Triangles triangles;

  ASSERT_TRUE(triangulate_polygon(std::vector<Vec3d>{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}, triangles));

  EXPECT_EQ(triangles, (Triangles{{0, 1, 2}}));
}

TEST(TriangulatePolygon, CutsADartAtItsInnerCorner) {
  const std::vector<Vec3d> dart{{0, 0, 0}, {4, 2, 0}, {0, 4, 0}, {1, 2, 0}};
  Triangles triangles;

  ASSERT_TRUE(triangulate_polygon(dart, triangles));

  expect_tiles_the_polygon(dart, triangles);
}

TEST(TriangulatePolygon, TilesStarsInAnyPlane) {
  const std::uint32_t seed = std::random_device{}();
  SCOPED_TRACE(seed);
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  std::uniform_real_distribution<double> radius(0.2, 1.0);
  for (int round = 0; round < 200; ++round) {
    const Vec3d normal = glm::normalize(Vec3d{unit(random), unit(random), unit(random) + 1e-3});
    const Vec3d u = glm::normalize(glm::cross(normal, Vec3d{unit(random), 1.0, unit(random)}));
    const Vec3d v = glm::cross(normal, u);
    const Vec3d centre = Vec3d{unit(random), unit(random), unit(random)} * 10.0;
    std::vector<Vec3d> star;
    const int corners = 3 + round % 40;
    for (int i = 0; i < corners; ++i) {
      const double angle = 6.283185307179586 * i / corners;
      star.push_back(centre + (u * std::cos(angle) + v * std::sin(angle)) * radius(random));
    }
    Triangles triangles;

    ASSERT_TRUE(triangulate_polygon(star, triangles));

    expect_tiles_the_polygon(star, triangles);
  }
}

std::vector<Vec3d> regular_polygon(int corners) {
  std::vector<Vec3d> polygon;
  for (int i = 0; i < corners; ++i) {
    const double angle = 6.283185307179586 * i / corners;
    polygon.emplace_back(std::cos(angle), std::sin(angle), 0.0);
  }
  return polygon;
}

TEST(TriangulatePolygon, FansAConvexPolygonOfAnySize) {
  Triangles triangles;

  ASSERT_TRUE(triangulate_polygon(regular_polygon(1'000'000), triangles));

  EXPECT_EQ(triangles.size(), 999'998U);
}

TEST(TriangulatePolygon, RefusesAConcavePolygonThatWouldTakeTooLong) {
  std::vector<Vec3d> polygon = regular_polygon(kConcavePolygonVerticesMax + 1);
  polygon[7] = Vec3d{0.0};
  Triangles triangles;

  EXPECT_FALSE(triangulate_polygon(polygon, triangles));
  EXPECT_TRUE(triangles.empty());
}

TEST(TriangulatePolygon, EndsOnPolygonsThatAreNone) {
  const double nan = std::nan("");
  const std::vector<std::vector<Vec3d>> polygons{
      {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}, {0, 0, 0}},             // a point
      {{0, 0, 0}, {1, 0, 0}, {2, 0, 0}, {3, 0, 0}, {1, 0, 0}},  // a line
      {{0, 0, 0}, {1, 1, 0}, {1, 0, 0}, {0, 1, 0}},             // a bow tie
      {{0, 0, 0}, {nan, 1, 0}, {1, 0, nan}, {0, 1, 0}, {2, 2, 2}},
  };
  for (const auto& polygon : polygons) {
    Triangles triangles;

    EXPECT_TRUE(triangulate_polygon(polygon, triangles));

    EXPECT_EQ(triangles.size(), polygon.size() - 2);
  }
}

}  // namespace
}  // namespace preheat
