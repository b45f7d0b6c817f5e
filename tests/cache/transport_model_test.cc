#include "cache/transport_model.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "tests/cache/transport_truth.h"
#include "tests/scenes/soups.h"

namespace preheat {
namespace {

using test::Agreement;
using test::CompiledScene;

void print(const char* scene, const CompiledScene& compiled, const Prediction& predicted,
           const Prediction& counted, const Agreement& agreement) {
  std::printf(
      "%s: %zu triangles, %zu voxels, %zu leaves, %.1f ms, pearson %.4f slope %.3f total "
      "%.3f rays %.3f/%.3f/%.3f, capture",
      scene, compiled.scene.triangles.size(), compiled.tables.voxels.size(),
      compiled.proxy.records.size(), predicted.seconds * 1e3, agreement.pearson, agreement.slope,
      agreement.total, predicted.camera_total / counted.camera_total,
      predicted.scatter_total / counted.scatter_total,
      predicted.shadow_total / counted.shadow_total);
  for (std::size_t i = 0; i < agreement.capture.size(); ++i) {
    std::printf(" %.4f(%.4f)", agreement.capture[i], agreement.capture_best[i]);
  }
  std::printf("\n");
}

TEST(TransportModel, CountsWhatAPathTracerCountsInARoom) {
  for (const std::uint32_t clutter : {4U, 20U}) {
    const CompiledScene compiled =
        test::compile_in_memory(test::make_room(clutter, /*seed=*/1), clutter == 4 ? 200 : 500);
    const RenderSettings settings = test::room_settings(/*size=*/128, /*spp=*/3);

    const Result<Prediction> predicted =
        predict("transport", {compiled.tables, compiled.proxy, settings, 1});
    ASSERT_TRUE(predicted.has_value()) << predicted.error().message;
    const Prediction counted = test::count_accesses(compiled, settings);
    const Agreement agreement = test::compare(compiled.tables, *predicted, counted);

    print("room", compiled, *predicted, counted, agreement);
    EXPECT_GT(agreement.pearson, 0.99);
    EXPECT_NEAR(agreement.slope, 1.0, 0.06);
    EXPECT_NEAR(agreement.total, 1.0, 0.1);
    for (std::size_t i = 0; i < agreement.capture.size(); ++i) {
      EXPECT_GT(agreement.capture[i], 0.97 * agreement.capture_best[i]);
    }
    EXPECT_EQ(predicted->camera_total, counted.camera_total);
    EXPECT_NEAR(predicted->scatter_total / counted.scatter_total, 1.0, 0.05);
    EXPECT_NEAR(predicted->shadow_total / counted.shadow_total, 1.0, 0.08);
  }
}

TEST(TransportModel, PredictsTheSameOnOneThreadAndOnMany) {
  const CompiledScene compiled = test::compile_in_memory(test::make_room(4, /*seed=*/2), 200);
  const RenderSettings settings = test::room_settings(/*size=*/256, /*spp=*/4);

  const Prediction one = *predict("transport", {compiled.tables, compiled.proxy, settings, 1});
  const Prediction two = *predict("transport", {compiled.tables, compiled.proxy, settings, 2});

  EXPECT_EQ(one.rays_camera, two.rays_camera);
  EXPECT_EQ(one.rays_scatter, two.rays_scatter);
  EXPECT_EQ(one.rays_shadow, two.rays_shadow);
  EXPECT_EQ(one.scatter_total, two.scatter_total);
  EXPECT_EQ(one.shadow_total, two.shadow_total);
}

TEST(TransportModel, StatesAnErrorThatItKeeps) {
  const CompiledScene compiled = test::compile_in_memory(test::make_room(4, /*seed=*/2), 200);
  RenderSettings settings = test::room_settings(/*size=*/256, /*spp=*/4);
  const auto predicted = [&](std::uint32_t paths) {
    PredictionInput input{compiled.tables, compiled.proxy, settings, 2};
    input.knobs.transport.paths = paths;
    return *predict("transport", input);
  };
  const Prediction reference = predicted(1U << 16U);
  const std::size_t hottest = static_cast<std::size_t>(
      std::max_element(reference.rays_camera.begin(), reference.rays_camera.end()) -
      reference.rays_camera.begin());
  double squares = 0.0;
  double squares_stated = 0.0;
  double voxel_squares = 0.0;
  double voxel_squares_stated = 0.0;

  for (settings.seed = 1; settings.seed <= 16; ++settings.seed) {
    const Prediction rough = predicted(512);
    squares += std::pow(rough.rays_total() - reference.rays_total(), 2);
    squares_stated += std::pow(rough.rays_total_error, 2);
    voxel_squares += std::pow(rough.rays(hottest) - reference.rays(hottest), 2);
    voxel_squares_stated += std::pow(rough.rays_error[hottest], 2);
  }

  // Sixteen squares of a normal error exceed twice their expectation once in a hundred times.
  EXPECT_LT(squares, 2.0 * squares_stated);
  EXPECT_LT(voxel_squares, 2.0 * voxel_squares_stated);
  EXPECT_LT(std::sqrt(squares_stated / 16.0), 0.05 * reference.rays_total());
  EXPECT_LT(reference.rays_total_error, 0.2 * std::sqrt(squares_stated / 16.0));
}

TEST(TransportModel, SpendsItsPathsWhereTheImageShowsTheScene) {
  const CompiledScene compiled = test::compile_in_memory(test::make_room(4, /*seed=*/1), 200);
  RenderSettings settings = test::room_settings(/*size=*/256, /*spp=*/2);
  settings.sky = Vec3(1.0F);
  settings.view.origin = Vec3(14.0F, 6.0F, 9.0F);
  settings.view.forward = -glm::normalize(settings.view.origin - Vec3(2.0F, 1.0F, 0.0F));
  for (const bool orthographic : {false, true}) {
    settings.view.orthographic = orthographic;
    const float half = orthographic ? 6.0F : 0.4F;
    settings.view.right =
        half * glm::normalize(glm::cross(settings.view.forward, Vec3(0.0F, 1.0F, 0.0F)));
    settings.view.up =
        half * glm::normalize(glm::cross(settings.view.right, settings.view.forward));

    const Prediction predicted =
        *predict("transport", {compiled.tables, compiled.proxy, settings, 1});
    const Prediction counted = test::count_accesses(compiled, settings);

    // The outside of a closed room hits nothing but itself.
    EXPECT_LT(counted.scatter_total, 0.1 * counted.camera_total);
    EXPECT_GT(counted.scatter_total, 0.0);
    EXPECT_NEAR(predicted.scatter_total / counted.scatter_total, 1.0, 0.05);
    EXPECT_EQ(predicted.camera_total, counted.camera_total);
  }
}

TEST(TransportModel, ExpectsNoRaysFromABallToItself) {
  const CompiledScene compiled = test::compile_in_memory(test::ball(7), 75);
  RenderSettings settings = test::room_settings(/*size=*/128, /*spp=*/1);
  settings.sky = Vec3(1.0F);
  settings.view.origin = Vec3(0.0F, 1.0F, 3.0F);
  settings.view.forward = -glm::normalize(settings.view.origin);
  settings.view.right = Vec3(0.4F, 0.0F, 0.0F);
  settings.view.up = 0.4F * glm::normalize(glm::cross(Vec3(1, 0, 0), settings.view.forward));

  const Prediction predicted =
      *predict("transport", {compiled.tables, compiled.proxy, settings, 1});
  const Prediction counted = test::count_accesses(compiled, settings);
  const Agreement agreement = test::compare(compiled.tables, predicted, counted);

  print("ball", compiled, predicted, counted, agreement);
  EXPECT_NEAR(agreement.total, 1.0, 0.05);
  EXPECT_NEAR(predicted.scatter_total / counted.scatter_total, 1.0, 0.1);
  EXPECT_NEAR(predicted.shadow_total / counted.shadow_total, 1.0, 0.1);
}

// Rays meet the inside of a ball whose normals point outwards at every bounce: from behind.
TEST(TransportModel, KeepsTheWallsOfARoomThatIsSeenFromBehind) {
  for (const bool is_inside_out : {false, true}) {
    const CompiledScene compiled =
        test::compile_in_memory(test::ball(24, 0.9F, is_inside_out), 600);
    RenderSettings settings = test::room_settings(/*size=*/128, /*spp=*/1);
    settings.view.origin = Vec3(-0.2F, 0.1F, 0.3F);

    const Prediction predicted =
        *predict("transport", {compiled.tables, compiled.proxy, settings, 1});
    const Prediction counted = test::count_accesses(compiled, settings);

    EXPECT_GT(counted.scatter_total, counted.camera_total);
    EXPECT_NEAR(predicted.scatter_total / counted.scatter_total, 1.0, 0.05);
  }
}

TEST(TransportModel, ExpectsNothingOfAViewThatShowsNothing) {
  const CompiledScene compiled = test::compile_in_memory(test::make_room(1, /*seed=*/1), 200);
  RenderSettings settings = test::room_settings(/*size=*/64, /*spp=*/2);
  settings.view.origin = Vec3(0.0F, 0.0F, 5.0F);
  settings.view.forward = Vec3(0.0F, 0.0F, 1.0F);

  const Prediction prediction = *predict("transport", {compiled.tables, compiled.proxy, settings});

  EXPECT_EQ(prediction.camera_total, 64.0 * 64.0 * 2.0);
  EXPECT_EQ(prediction.scatter_total + prediction.shadow_total, 0.0);
  for (std::size_t voxel = 0; voxel < prediction.rays_camera.size(); ++voxel) {
    EXPECT_EQ(prediction.rays(voxel), 0.0);
  }
}

TEST(TransportModel, RefusesMorePathsThanItCounts) {
  const CompiledScene compiled = test::compile_in_memory(test::make_room(1, /*seed=*/2), 200);
  const RenderSettings settings = test::room_settings(/*size=*/16, /*spp=*/1);
  PredictionInput input{compiled.tables, compiled.proxy, settings, 1};
  input.knobs.transport.paths = kTransportPathsMax + 1;

  const Result<Prediction> prediction = predict("transport", input);

  ASSERT_FALSE(prediction.has_value());
  EXPECT_EQ(prediction.error().code, ExitCode::kUsage);
}

TEST(TransportModel, ShadesOnlyWhatTheSettingsAllow) {
  const CompiledScene compiled = test::compile_in_memory(test::make_room(4, /*seed=*/2), 200);
  RenderSettings settings = test::room_settings(/*size=*/64, /*spp=*/1);
  settings.bounces = 0;

  const Prediction prediction = *predict("transport", {compiled.tables, compiled.proxy, settings});

  EXPECT_EQ(prediction.camera_total, 64.0 * 64.0);
  EXPECT_EQ(prediction.scatter_total, 0.0);
  EXPECT_EQ(prediction.shadow_total, 0.0);
}

TEST(TransportModel, RefusesAProxyOfAnotherScene) {
  CompiledScene compiled = test::compile_in_memory(test::make_room(4, /*seed=*/2), 200);
  const RenderSettings settings = test::room_settings(/*size=*/64, /*spp=*/1);
  const PredictionInput input{compiled.tables, compiled.proxy, settings, 1};

  compiled.tables.materials.resize(1);
  EXPECT_EQ(predict("transport", input).error().code, ExitCode::kStoreDamaged);
  compiled.tables.materials = compiled.scene.materials;
  compiled.tables.voxel_nodes[0].first = 0;
  EXPECT_EQ(predict("transport", input).error().code, ExitCode::kStoreDamaged);
  compiled.tables.voxels.pop_back();
  EXPECT_EQ(predict("transport", input).error().code, ExitCode::kStoreDamaged);
}

}  // namespace
}  // namespace preheat
