#include "master/scene_builder.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "tests/master/scene_files.h"

namespace preheat {
namespace {

class PlainMesh : public WorldMesh {
 public:
  std::vector<Vec3d> positions{};
  std::vector<Vec3d> normals{};
  std::vector<Triangle> triangles{};
  double spacing = 0.0;

  [[nodiscard]] std::string label() const override { return "plain"; }
  [[nodiscard]] std::uint32_t vertex_count() const override {
    return static_cast<std::uint32_t>(positions.size());
  }
  [[nodiscard]] std::uint64_t triangle_count() const override { return triangles.size(); }
  [[nodiscard]] Triangle triangle(std::uint64_t index) const override { return triangles[index]; }
  [[nodiscard]] Vec3d position(std::uint32_t vertex) const override { return positions[vertex]; }
  [[nodiscard]] Vec3d normal(std::uint32_t vertex) const override {
    return normals.empty() ? Vec3d{0.0} : normals[vertex];
  }
  [[nodiscard]] double coordinate_spacing(std::uint32_t) const override { return spacing; }
};

// Consecutive triples of positions are triangles.
std::unique_ptr<PlainMesh> soup(std::vector<Vec3d> positions) {
  auto mesh = std::make_unique<PlainMesh>();
  mesh->positions = std::move(positions);
  for (std::uint32_t i = 0; i + 2 < mesh->positions.size(); i += 3) {
    mesh->triangles.push_back({{i, i + 1, i + 2}, 0});
  }
  return mesh;
}

Result<Scene> build(std::unique_ptr<PlainMesh> mesh, std::vector<WorldLight> lights = {}) {
  SceneDraft draft;
  draft.meshes.push_back(std::move(mesh));
  draft.materials.emplace_back();
  draft.lights = std::move(lights);
  return build_scene(std::move(draft));
}

std::vector<Vec3d> triangle_of_size(double size, const Vec3d& at = Vec3d{0.0}) {
  return {at, at + Vec3d{size, 0.0, 0.0}, at + Vec3d{0.0, size * 0.5, 0.0}};
}

TEST(BuildScene, PutsTheCentreOfTheBoundsAtTheOriginAndScalesByAPowerOfTwo) {
  const auto scene = build(soup(triangle_of_size(12.0, {100.0, 50.0, 7.0})));

  ASSERT_TRUE(scene);
  EXPECT_EQ(scene->frame.centre, (Vec3d{106.0, 53.0, 7.0}));
  EXPECT_EQ(scene->frame.scale_exponent, -3);  // 6 / 8 = 0.75
  EXPECT_EQ(scene->positions[1], (Vec3{0.75F, -0.375F, 0.0F}));
}

TEST(BuildScene, ScalesAnExactPowerOfTwoToOne) {
  const auto scene = build(soup(triangle_of_size(8.0)));

  ASSERT_TRUE(scene);
  EXPECT_EQ(scene->frame.scale_exponent, -2);
  EXPECT_EQ(scene->positions[1].x, 1.0F);
}

TEST(BuildScene, GivesTheSameBitsAtAnyPowerOfTwoOfScale) {
  const auto reference = build(soup(triangle_of_size(1.2345)));
  ASSERT_TRUE(reference);
  for (const int exponent : {-59, -20, 20, 59}) {
    const auto scene = build(soup(triangle_of_size(std::ldexp(1.2345, exponent))));
    ASSERT_TRUE(scene) << exponent;

    EXPECT_EQ(scene->positions, reference->positions);
    EXPECT_EQ(scene->frame.scale_exponent, reference->frame.scale_exponent - exponent);
  }
}

TEST(BuildScene, KeepsDetailFarFromTheOrigin) {
  const auto scene = build(soup(triangle_of_size(1.0, {1e7, -1e7, 1e7})));

  ASSERT_TRUE(scene);
  const Vec3d corner = file_position(*scene, 0, 1);
  EXPECT_NEAR(corner.x, 1e7 + 1.0, 1e-7);
  EXPECT_NEAR(corner.y, -1e7, 1e-7);
}

TEST(BuildScene, RefusesExtentsOutOfBounds) {
  EXPECT_TRUE(is_rejected(build(soup(triangle_of_size(1e20))), "beyond the limit"));
  EXPECT_TRUE(
      is_rejected(build(soup(triangle_of_size(1.0, {3e38, 0.0, 0.0}))), "beyond the limit"));
  EXPECT_TRUE(is_rejected(build(soup(triangle_of_size(1e-40))), "too small"));
  EXPECT_TRUE(is_rejected(build(soup(triangle_of_size(0.0))), "too small"));
}

TEST(BuildScene, DropsAndCountsBrokenTriangles) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double infinity = std::numeric_limits<double>::infinity();
  auto mesh = soup({{0, 0, 0},
                    {1, 0, 0},
                    {0, 1, 0},  // kept
                    {nan, 0, 0},
                    {1, 0, 0},
                    {0, 1, 0},  // NaN
                    {0, 0, 0},
                    {1, 0, 0},
                    {0, infinity, 0},  // infinite
                    {0, 0, 0},
                    {1, 0, 0},
                    {1, 0, 0},  // two corners
                    {0, 0, 0},
                    {1, 0, 0},
                    {0.5, 0, 0}});  // a line

  const auto scene = build(std::move(mesh));

  ASSERT_TRUE(scene);
  EXPECT_EQ(scene->triangles.size(), 1U);
  EXPECT_EQ(scene->positions.size(), 3U);
  EXPECT_EQ(scene->import.triangles_declared, 5U);
  EXPECT_EQ(scene->import.triangles_non_finite, 2U);
  EXPECT_EQ(scene->import.triangles_zero_area, 2U);
  EXPECT_TRUE(has_note(*scene, "4 of 5 triangles"));
}

TEST(BuildScene, RefusesASceneOfBrokenTrianglesOnly) {
  const double nan = std::numeric_limits<double>::quiet_NaN();

  EXPECT_TRUE(is_rejected(build(soup({{nan, 0, 0}, {1, 0, 0}, {0, 1, 0}})), "NaN"));
  EXPECT_TRUE(is_rejected(build(soup({{0, 0, 0}, {1, 0, 0}, {2, 0, 0}})), "area"));
  EXPECT_TRUE(is_rejected(build(soup({})), "no triangles"));
}

TEST(BuildScene, DropsTrianglesWhoseNormalUnderflowsInFloat) {
  std::vector<Vec3d> positions = triangle_of_size(1.0, {-0.5, -0.25, 0.0});
  for (const Vec3d& corner : triangle_of_size(1e-11)) { positions.push_back(corner); }

  const auto scene = build(soup(std::move(positions)));

  ASSERT_TRUE(scene);
  for (const Triangle& triangle : scene->triangles) {
    const Vec3& a = scene->positions[triangle.vertices[0]];
    const Vec3 normal = glm::cross(scene->positions[triangle.vertices[1]] - a,
                                   scene->positions[triangle.vertices[2]] - a);
    EXPECT_TRUE(std::isnormal(glm::dot(normal, normal)));
  }
  EXPECT_EQ(scene->import.triangles_zero_area, 1U);
}

TEST(BuildScene, SharesVerticesWithinAMeshAndStoresNoOthers) {
  auto mesh = soup({{9, 9, 9}, {9, 9, 9}, {9, 9, 9}, {0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}});
  mesh->triangles = {{{3, 4, 5}, 0}, {{3, 5, 6}, 0}};

  const auto scene = build(std::move(mesh));

  ASSERT_TRUE(scene);
  EXPECT_EQ(scene->positions.size(), 4U);
  EXPECT_EQ(scene->frame.centre, (Vec3d{0.5, 0.5, 0.0}));
}

TEST(BuildScene, MakesNormalsUnitOrZero) {
  auto mesh = soup(triangle_of_size(1.0));
  mesh->normals = {{0.0, 0.0, 7.0}, {0.0, 0.0, 0.0}, {std::nan(""), 0.0, 1.0}};

  const auto scene = build(std::move(mesh));

  ASSERT_TRUE(scene);
  EXPECT_EQ(scene->normals[0], (Vec3{0.0F, 0.0F, 1.0F}));
  EXPECT_EQ(scene->normals[1], Vec3{0.0F});
  EXPECT_EQ(scene->normals[2], Vec3{0.0F});
}

TEST(BuildScene, RefusesAnIndexOutOfRange) {
  auto mesh = soup(triangle_of_size(1.0));
  mesh->triangles.push_back({{0, 1, 3}, 0});

  EXPECT_TRUE(is_rejected(build(std::move(mesh)), "triangle 1 has vertex index 3"));
}

TEST(BuildScene, ScalesLightsWithTheScene) {
  WorldLight point;
  point.position_file = {12.0, 6.0, 0.0};
  point.intensity_file = {64.0, 32.0, 0.0};
  point.range_file = 16.0;
  WorldLight sun;
  sun.light.kind = PunctualLightKind::kDirectional;
  sun.intensity_file = {3.0, 3.0, 3.0};

  const auto scene = build(soup(triangle_of_size(12.0)), {point, sun});

  ASSERT_TRUE(scene);
  ASSERT_EQ(scene->frame.scale_exponent, -3);
  EXPECT_EQ(scene->lights[0].position, (Vec3{0.75F, 0.375F, 0.0F}));
  EXPECT_EQ(scene->lights[0].intensity, (Vec3{1.0F, 0.5F, 0.0F}));  // 64 / 8^2
  EXPECT_EQ(scene->lights[0].range, 2.0F);
  EXPECT_EQ(scene->lights[1].intensity, Vec3{3.0F});
}

TEST(BuildScene, NotesCoordinatesThatAreTooCoarse) {
  auto coarse = soup(triangle_of_size(1.0, {1e6, 0.0, 0.0}));
  coarse->spacing = 0.0625;  // of floats at 1e6
  auto fine = soup(triangle_of_size(1.0));
  fine->spacing = 6e-8;

  EXPECT_TRUE(has_note(build(std::move(coarse)).value(), "too coarse for 1 of 1"));
  EXPECT_TRUE(build(std::move(fine)).value().import.notes.empty());
}

// Claims triangles that would not fit into any memory.
class HugeMesh : public PlainMesh {
 public:
  [[nodiscard]] std::uint64_t triangle_count() const override { return std::uint64_t{1} << 40U; }
};

TEST(BuildScene, RefusesMoreTrianglesThanMemoryHoldsBeforeReadingThem) {
  SceneDraft draft;
  draft.meshes.push_back(std::make_unique<HugeMesh>());

  EXPECT_TRUE(is_rejected(build_scene(std::move(draft)), "memory"));
}

}  // namespace
}  // namespace preheat
