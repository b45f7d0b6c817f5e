#include "cache/area_models.h"

#include <gtest/gtest.h>

#include <cmath>
#include <iostream>
#include <random>

#include "cache/evaluation.h"
#include "common/math.h"
#include "tests/cache/transport_truth.h"

namespace preheat {
namespace {

using test::CompiledScene;

CompiledScene room() { return test::compile_in_memory(test::make_room(4, /*seed=*/3), 200); }

Prediction predicted(const char* model, const CompiledScene& compiled,
                     const RenderSettings& settings) {
  Result<Prediction> prediction = predict(model, {compiled.tables, compiled.proxy, settings, 1});
  EXPECT_TRUE(prediction.has_value()) << prediction.error().message;
  return *prediction;
}

// Lines of all directions and offsets alike that meet the outer box; the share of them that meets
// the inner one.
double share_of_lines(const Aabb& outer, const Aabb& inner, int lines, std::mt19937& engine) {
  const auto uniform = [&] { return static_cast<float>(engine() >> 8) * 0x1p-24F; };
  const Vec3 centre = 0.5F * (outer.low + outer.high);
  const float radius = 0.5F * glm::length(outer.extent());
  int met = 0;
  int hit = 0;
  while (met < lines) {
    const float z = 2.0F * uniform() - 1.0F;
    const float azimuth = 2.0F * kPi * uniform();
    const float ring = std::sqrt(std::max(0.0F, 1.0F - z * z));
    const Vec3 direction(ring * std::cos(azimuth), ring * std::sin(azimuth), z);
    const OrthonormalFrame frame(direction);
    const float offset = radius * std::sqrt(uniform());
    const float turn = 2.0F * kPi * uniform();
    const Vec3 origin =
        centre - 2.0F * radius * direction +
        offset * (std::cos(turn) * frame.tangent + std::sin(turn) * frame.bitangent);
    const Ray line{origin, direction, 0.0F, 4.0F * radius};
    if (clip(line, outer).is_empty()) { continue; }
    ++met;
    hit += clip(line, inner).is_empty() ? 0 : 1;
  }
  return static_cast<double>(hit) / lines;
}

TEST(AreaModels, SurfaceAreaIsTheShareOfRandomLinesThatMeetAVoxel) {
  constexpr std::uint32_t kSeed = 5;
  constexpr int kLines = 40000;
  std::cout << "seed=" << kSeed << '\n';
  std::mt19937 engine(kSeed);
  const CompiledScene compiled = room();
  const RenderSettings settings = test::room_settings(64, 2);

  const Prediction prediction = predicted("surface-area", compiled, settings);

  Aabb all;
  for (const VoxelEntry& voxel : compiled.tables.voxels) { all.extend(voxel.bounds); }
  for (std::size_t voxel = 0; voxel < compiled.tables.voxels.size(); voxel += 17) {
    const double expected = prediction.rays_camera[voxel] / prediction.camera_total;
    const double counted =
        share_of_lines(all, compiled.tables.voxels[voxel].bounds, kLines, engine);
    const double error = std::sqrt(expected * (1.0 - expected) / kLines);
    EXPECT_NEAR(counted, expected, 5.0 * error + 1e-4) << voxel;
  }
}

TEST(AreaModels, AssumeThatEveryPathLivesAsLongAsTheSettingsAllow) {
  CompiledScene compiled = room();
  RenderSettings settings = test::room_settings(10, 3);
  settings.bounces = 4;

  const Prediction lit = predicted("surface-area", compiled, settings);
  EXPECT_EQ(lit.camera_total, 300.0);
  EXPECT_EQ(lit.scatter_total, 1200.0);  // the last one may find a lamp
  EXPECT_EQ(lit.shadow_total, 1200.0);

  compiled.tables.emissive_triangles.clear();
  compiled.tables.lights.emplace_back();
  const Prediction point_lit = predicted("surface-area", compiled, settings);
  EXPECT_EQ(point_lit.scatter_total, 900.0);
  EXPECT_EQ(point_lit.shadow_total, 1200.0);

  compiled.tables.lights.clear();
  EXPECT_EQ(predicted("surface-area", compiled, settings).shadow_total, 0.0);
}

TEST(AreaModels, TerminationScalesAllVoxelsAlike) {
  const CompiledScene compiled = room();
  const RenderSettings settings = test::room_settings(64, 2);
  const Prediction whole = predicted("surface-area", compiled, settings);

  for (const char* model : {"macdonald-booth", "subramanian-fussell"}) {
    const Prediction shorter = predicted(model, compiled, settings);
    const double factor = shorter.rays(0) / whole.rays(0);
    EXPECT_GT(factor, 0.01) << model;
    EXPECT_LT(factor, 1.0) << model;
    EXPECT_EQ(shorter.rays_total(), whole.rays_total());
  }
  const Prediction shorter = predicted("macdonald-booth", compiled, settings);
  for (std::size_t voxel = 0; voxel < compiled.tables.voxels.size(); ++voxel) {
    EXPECT_NEAR(shorter.rays(voxel) / whole.rays(voxel), shorter.rays(0) / whole.rays(0), 1e-12);
  }
}

TEST(AreaModels, AThinVoxelInALargeCellIsVisitedByItsCellInClearyAndWyvillOnly) {
  CompiledScene compiled = room();
  compiled.tables.voxels[0].bounds = {Vec3(0.0F), Vec3(1e-3F)};
  const RenderSettings settings = test::room_settings(64, 2);

  EXPECT_GT(predicted("cleary-wyvill", compiled, settings).rays(0),
            100.0 * predicted("surface-area", compiled, settings).rays(0));
}

TEST(AreaModels, FlatAndPointSizedScenesHaveFiniteRays) {
  for (const Vec3& extent : {Vec3(0.0F), Vec3(1.0F, 0.0F, 0.0F), Vec3(1.0F, 0.0F, 1.0F)}) {
    CompiledScene compiled;
    compiled.tables.voxels.resize(2);
    for (VoxelEntry& voxel : compiled.tables.voxels) { voxel.bounds = {Vec3(0.0F), extent}; }
    compiled.proxy.cells.assign(2, {Vec3(0.0F), extent});
    for (const char* model :
         {"surface-area", "macdonald-booth", "cleary-wyvill", "subramanian-fussell"}) {
      const Prediction prediction = predicted(model, compiled, test::room_settings(8, 1));
      EXPECT_GT(prediction.rays(0), 0.0) << model;
      EXPECT_LE(prediction.rays_camera[0], prediction.camera_total) << model;
    }
  }
}

TEST(AreaModels, RefuseAProxyOfAnotherScene) {
  CompiledScene compiled = room();
  compiled.proxy.cells.pop_back();
  for (const char* model : {"macdonald-booth", "cleary-wyvill", "subramanian-fussell"}) {
    const auto prediction =
        predict(model, {compiled.tables, compiled.proxy, test::room_settings(8, 1), 1});
    ASSERT_FALSE(prediction.has_value()) << model;
    EXPECT_EQ(prediction.error().code, ExitCode::kStoreDamaged);
  }
}

}  // namespace
}  // namespace preheat
