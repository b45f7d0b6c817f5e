#include "master/demo_shapes.h"

#include <gtest/gtest.h>

#include <cmath>

namespace preheat {
namespace {

// Volume inside a closed surface by the divergence theorem: positive if its normals are outwards.
double signed_volume(const Scene& scene) {
  double volume = 0.0;
  for (const Triangle& triangle : scene.triangles) {
    const Vec3d a(scene.positions[triangle.vertices[0]]);
    const Vec3d b(scene.positions[triangle.vertices[1]]);
    const Vec3d c(scene.positions[triangle.vertices[2]]);
    volume += glm::dot(a, glm::cross(b, c)) / 6.0;
  }
  return volume;
}

void expect_shading_normals_on_the_outside(const Scene& scene) {
  for (const Triangle& triangle : scene.triangles) {
    const Vec3d a(scene.positions[triangle.vertices[0]]);
    const Vec3d b(scene.positions[triangle.vertices[1]]);
    const Vec3d c(scene.positions[triangle.vertices[2]]);
    const Vec3d outside = glm::cross(b - a, c - a);
    for (const std::uint32_t vertex : triangle.vertices) {
      EXPECT_GT(glm::dot(outside, Vec3d(scene.normals[vertex])), 0.0);
    }
  }
}

TEST(DemoShapes, SinesAreThoseOfTheLibraryToTheirLastDigits) {
  for (int step = -4000; step <= 4000; ++step) {
    const double turns = step / 1000.0;
    const double angle = turns * 2.0 * std::acos(-1.0);
    EXPECT_NEAR(sine_of_turns(turns), std::sin(angle), 1e-14) << turns;
    EXPECT_NEAR(cosine_of_turns(turns), std::cos(angle), 1e-14) << turns;
  }
}

TEST(DemoShapes, ABoxIsClosedAndFacesOutwards) {
  Scene scene;
  DemoBuilder(scene, 1.0).box(turned({1, 2, 3}, 0.1), {-1, -2, -3}, {1, 2, 3}, 0);

  EXPECT_EQ(scene.triangles.size(), 12U);
  EXPECT_NEAR(signed_volume(scene), 48.0, 1e-4);
}

TEST(DemoShapes, ASphereIsClosedAndFacesOutwards) {
  Scene scene;
  DemoBuilder(scene, 1.0).sphere({0.1, 0.2, 0.3}, 0.5, 128, 0);

  EXPECT_NEAR(signed_volume(scene), 4.0 / 3.0 * std::acos(-1.0) * 0.125, 1e-3);
  expect_shading_normals_on_the_outside(scene);
}

TEST(DemoShapes, ATubeIsClosedAndFacesOutwards) {
  Scene scene;
  const std::vector<Vec3d> path = smooth_path({{0, 0, 0}, {0, 1, 0}, {0.5, 2, 0}}, 16);
  DemoBuilder(scene, 1.0).tube(path, 0.1, 0.1, 64, 0);

  double length = 0.0;
  for (std::size_t i = 1; i < path.size(); ++i) { length += glm::length(path[i] - path[i - 1]); }
  EXPECT_NEAR(signed_volume(scene), length * std::acos(-1.0) * 0.01, 0.01 * signed_volume(scene));
}

TEST(DemoShapes, ACushionFacesOutwards) {
  Scene scene;
  DemoBuilder(scene, 1.0).cushion(Placement{}, {0.4, 0.1, 0.3}, 0);

  EXPECT_GT(signed_volume(scene), 0.4 * 0.1 * 0.3 * 4.0);
  EXPECT_LT(signed_volume(scene), 0.4 * 0.1 * 0.3 * 8.0);
}

TEST(DemoShapes, APointingPlacementIsARotation) {
  DemoRandom random(7);
  for (int i = 0; i < 1000; ++i) {
    const Vec3d direction(random.between(-1, 1), random.between(-1, 1), random.between(-1, 1));
    const Placement place = pointing({}, direction, random.between(0, 1));
    EXPECT_NEAR(glm::dot(glm::cross(place.x, place.y), place.z), 1.0, 1e-12);
    EXPECT_NEAR(glm::dot(place.y, glm::normalize(direction)), 1.0, 1e-12);
  }
}

TEST(DemoShapes, ASmoothProfilePassesThroughItsPoints) {
  const Profile points = {{0.0, 0.0}, {1.0, 0.5}, {0.5, 1.0}};

  const Profile smooth = smooth_profile(points, 4);

  ASSERT_EQ(smooth.size(), 9U);
  for (std::size_t i = 0; i < points.size(); ++i) {
    EXPECT_DOUBLE_EQ(smooth[4 * i].radius, points[i].radius);
    EXPECT_DOUBLE_EQ(smooth[4 * i].height, points[i].height);
  }
}

}  // namespace
}  // namespace preheat
