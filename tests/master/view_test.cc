#include "master/view.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace preheat {
namespace {

using ::testing::HasSubstr;

// A box of 8 x 4 x 8 file units around (10, 0, 0).
SceneTables box_tables() {
  SceneTables tables;
  tables.frame = {Vec3d(10.0, 0.0, 0.0), -3};
  const Aabb bounds{Vec3(-0.5F, -0.25F, -0.5F), Vec3(0.5F, 0.25F, 0.5F)};
  tables.voxels.push_back(VoxelEntry{bounds});
  tables.voxel_nodes.push_back(VoxelNode{bounds, 0, 0});
  tables.materials.emplace_back();
  return tables;
}

std::vector<Camera> two_cameras() {
  Camera front;
  front.name = "front";
  front.position_file = Vec3d(10.0, 0.0, 20.0);
  Camera side = front;
  side.name = "side";
  side.position_file = Vec3d(30.0, 0.0, 0.0);
  side.forward = Vec3d(-1.0, 0.0, 0.0);
  side.right = Vec3d(0.0, 0.0, -1.0);
  return {front, side};
}

void expect_right_handed(const Camera& camera) {
  EXPECT_NEAR(glm::length(glm::cross(camera.right, camera.up) + camera.forward), 0.0, 1e-12);
  EXPECT_NEAR(glm::length(camera.forward), 1.0, 1e-12);
}

TEST(ResolveView, TakesTheFirstCameraUnlessAnotherIsNamed) {
  EXPECT_EQ(resolve_view(box_tables(), two_cameras(), {})->camera.name, "front");
  ViewOptions options;
  options.camera = "side";
  EXPECT_EQ(resolve_view(box_tables(), two_cameras(), options)->camera.name, "side");
  options.camera = "1";
  EXPECT_EQ(resolve_view(box_tables(), two_cameras(), options)->camera.name, "side");
}

TEST(ResolveView, AnUnknownCameraIsAUsageErrorThatListsTheOthers) {
  ViewOptions options;
  options.camera = "2";

  const auto view = resolve_view(box_tables(), two_cameras(), options);

  ASSERT_FALSE(view.has_value());
  EXPECT_EQ(view.error().code, ExitCode::kUsage);
  EXPECT_THAT(view.error().message, HasSubstr("'front'"));
  EXPECT_THAT(view.error().message, HasSubstr("1 'side'"));
}

TEST(ResolveView, WithoutCameraEveryCornerOfTheSceneIsInView) {
  for (const ImageSize size : {ImageSize{512, 512}, ImageSize{100, 400}, ImageSize{400, 100}}) {
    ViewOptions options;
    options.size = size;

    const auto view = resolve_view(box_tables(), {}, options);

    ASSERT_TRUE(view.has_value());
    expect_right_handed(view->camera);
    const double half_height = std::tan(view->camera.vertical_fov_rad * 0.5);
    const double half_width = half_height * size.width / size.height;
    for (int corner = 0; corner < 8; ++corner) {
      const Vec3d point(10.0 + ((corner & 1) != 0 ? 4.0 : -4.0), (corner & 2) != 0 ? 2.0 : -2.0,
                        (corner & 4) != 0 ? 4.0 : -4.0);
      const Vec3d to = point - view->camera.position_file;
      const double depth = glm::dot(to, view->camera.forward);
      EXPECT_GT(depth, 0.0);
      EXPECT_LE(std::abs(glm::dot(to, view->camera.right)), half_width * depth);
      EXPECT_LE(std::abs(glm::dot(to, view->camera.up)), half_height * depth);
    }
  }
}

TEST(ResolveView, EyeAndLookAtPlaceTheCameraInFileUnits) {
  ViewOptions options;
  options.eye = Vec3d(10.0, 0.0, 16.0);
  options.look_at = Vec3d(10.0, 0.0, 0.0);
  options.fov_deg = 90.0;

  const auto view = resolve_view(box_tables(), two_cameras(), options);

  ASSERT_TRUE(view.has_value());
  EXPECT_EQ(view->settings.view.origin, Vec3(0.0F, 0.0F, 2.0F));
  EXPECT_EQ(view->settings.view.forward, Vec3(0.0F, 0.0F, -1.0F));
  EXPECT_NEAR(view->settings.view.up.y, 1.0F, 1e-6F);
  EXPECT_EQ(view->camera_source, "option");
}

TEST(ResolveView, LooksStraightDownWithoutBeingToldWhatIsUp) {
  ViewOptions options;
  options.eye = Vec3d(10.0, 50.0, 0.0);
  options.look_at = Vec3d(10.0, 0.0, 0.0);

  const auto view = resolve_view(box_tables(), {}, options);

  ASSERT_TRUE(view.has_value());
  expect_right_handed(view->camera);
  EXPECT_NEAR(view->camera.forward.y, -1.0, 1e-12);
}

TEST(ResolveView, RefusesViewsThatHaveNoDirection) {
  ViewOptions options;
  options.eye = Vec3d(1.0, 2.0, 3.0);
  options.look_at = options.eye;
  EXPECT_FALSE(resolve_view(box_tables(), {}, options).has_value());
  options.look_at = Vec3d(1.0, 3.0, 3.0);
  options.up = Vec3d(0.0, 2.0, 0.0);
  EXPECT_FALSE(resolve_view(box_tables(), {}, options).has_value());
  options.up = Vec3d(0.0);
  EXPECT_FALSE(resolve_view(box_tables(), {}, options).has_value());
}

TEST(ResolveView, RefusesViewsFromFartherThanFloatCanSquare) {
  for (const double far : {1e30, -1e39, 1e100}) {
    ViewOptions options;
    options.eye = Vec3d(0.0, 0.0, far);

    const auto view = resolve_view(box_tables(), two_cameras(), options);

    ASSERT_FALSE(view.has_value()) << far;
    EXPECT_EQ(view.error().code, ExitCode::kUsage);
    EXPECT_THAT(view.error().message, HasSubstr("away"));
  }
  ViewOptions options;
  options.eye = Vec3d(0.0, 0.0, 1e12);
  EXPECT_TRUE(resolve_view(box_tables(), two_cameras(), options).has_value());
}

TEST(ResolveView, TheSkyShinesOnlyWhereNothingElseDoes) {
  SceneTables tables = box_tables();
  EXPECT_EQ(resolve_view(tables, {}, {})->settings.sky, Vec3(1.0F));
  EXPECT_THAT(resolve_view(tables, {}, {})->sky_source, HasSubstr("no light"));

  tables.lights.emplace_back();
  EXPECT_EQ(resolve_view(tables, {}, {})->settings.sky, Vec3(0.0F));
  ViewOptions options;
  options.sky = Vec3(0.25F);
  EXPECT_EQ(resolve_view(tables, {}, options)->settings.sky, Vec3(0.25F));
  EXPECT_THAT(resolve_view(tables, {}, options)->sky_source, HasSubstr("option"));
}

}  // namespace
}  // namespace preheat
