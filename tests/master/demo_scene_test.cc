#include "master/demo_scene.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>

namespace preheat {
namespace {

class DemoScene : public ::testing::TestWithParam<std::uint64_t> {};

TEST_P(DemoScene, HasAboutTheTrianglesAskedForAndIsWellFormed) {
  const Scene scene = make_demo_scene(GetParam());

  const auto target = static_cast<double>(GetParam());
  EXPECT_NEAR(static_cast<double>(scene.triangles.size()), target, 0.15 * target);
  ASSERT_EQ(scene.normals.size(), scene.positions.size());
  for (const Vec3& position : scene.positions) {
    for (int axis = 0; axis < 3; ++axis) { ASSERT_LE(std::abs(position[axis]), 1.0F); }
  }
  for (const Vec3& normal : scene.normals) {
    const float length = glm::length(normal);
    ASSERT_TRUE(length == 0.0F || std::abs(length - 1.0F) < 1e-5F) << length;
  }
  for (const Triangle& triangle : scene.triangles) {
    ASSERT_LT(triangle.material, scene.materials.size());
    for (const std::uint32_t vertex : triangle.vertices) {
      ASSERT_LT(vertex, scene.positions.size());
    }
  }
  EXPECT_FALSE(scene.cameras.empty());
}

INSTANTIATE_TEST_SUITE_P(Sizes, DemoScene, ::testing::Values(250'000U, 1'000'000U, 3'000'000U));

TEST(DemoSceneContent, TheSmallestIsStillARoom) {
  const Scene scene = make_demo_scene(kDemoTrianglesMin);

  EXPECT_GT(scene.triangles.size(), kDemoTrianglesMin);
  EXPECT_LT(scene.triangles.size(), 2 * kDemoTrianglesMin);
}

TEST(DemoSceneContent, IsTheSameEveryTime) {
  const Scene first = make_demo_scene(200'000);
  const Scene second = make_demo_scene(200'000);

  ASSERT_EQ(first.positions.size(), second.positions.size());
  EXPECT_EQ(std::memcmp(first.positions.data(), second.positions.data(),
                        first.positions.size() * sizeof(Vec3)),
            0);
}

TEST(DemoSceneContent, HasEmittersALampGlassAndMetal) {
  const Scene scene = make_demo_scene(200'000);
  const auto any = [&](auto property) {
    return std::any_of(scene.triangles.begin(), scene.triangles.end(),
                       [&](const Triangle& t) { return property(scene.materials[t.material]); });
  };

  EXPECT_TRUE(any([](const Material& m) { return m.emission != Vec3(0.0F); }));
  EXPECT_TRUE(any([](const Material& m) { return m.transmission == 1.0F && !m.thin_walled; }));
  EXPECT_TRUE(any([](const Material& m) { return m.metallic == 1.0F && m.roughness == 0.0F; }));
  EXPECT_TRUE(any([](const Material& m) { return m.metallic == 1.0F && m.roughness > 0.0F; }));
  EXPECT_EQ(scene.lights.size(), 1U);
}

}  // namespace
}  // namespace preheat
