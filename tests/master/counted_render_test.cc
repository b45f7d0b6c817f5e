#include "cache/counted_render.h"

#include <gtest/gtest.h>

#include <fstream>

#include "cache/evaluation.h"
#include "cache/prediction.h"
#include "cache/profile_model.h"
#include "tests/master/lit_scene.h"

namespace preheat {
namespace {

using test::LitScene;

CellAccesses sum_of(const std::vector<CellAccesses>& cells) {
  CellAccesses sum;
  for (const CellAccesses& cell : cells) { sum.add(cell); }
  return sum;
}

// Every ray begins inside a box around everything, so that it is counted there once, as its type.
TEST(CountedRender, CountsEachRayByItsType) {
  const LitScene scene;
  const Store store = scene.open();
  auto tree = std::make_shared<CountingTree>();
  tree->nodes.push_back({{Vec3(-2.0F), Vec3(2.0F)}, 1, 1});
  tree->nodes.push_back({{Vec3(-2.0F), Vec3(2.0F)}, 1, 0});
  tree->cell_count = 2;
  CountedRenderOptions options{2};
  options.counting_tree = tree;

  const auto counted = render_counted(store, LitScene::settings(40, 3), options);

  ASSERT_TRUE(counted.has_value()) << counted.error().message;
  ASSERT_EQ(counted->accesses.size(), 2U);
  EXPECT_EQ(counted->rays.camera, 40U * 40U * 3U);
  EXPECT_GT(counted->rays.scatter, 0U);
  EXPECT_GT(counted->rays.shadow, 0U);
  EXPECT_EQ(counted->accesses[0].total(), 0U);
  EXPECT_EQ(counted->accesses[1].camera, counted->rays.camera);
  EXPECT_EQ(counted->accesses[1].scatter, counted->rays.scatter);
  EXPECT_EQ(counted->accesses[1].shadow, counted->rays.shadow);
}

TEST(CountedRender, CountsTheSameOnAnyNumberOfThreads) {
  const LitScene scene;
  const Store store = scene.open();
  const RenderSettings settings = LitScene::settings(50, 2);
  const auto one = render_counted(store, settings, {1});
  const auto three = render_counted(store, settings, {3});

  ASSERT_EQ(one->accesses.size(), store.tables().voxels.size());
  for (std::size_t voxel = 0; voxel < one->accesses.size(); ++voxel) {
    EXPECT_EQ(one->accesses[voxel].camera, three->accesses[voxel].camera);
    EXPECT_EQ(one->accesses[voxel].scatter, three->accesses[voxel].scatter);
    EXPECT_EQ(one->accesses[voxel].shadow, three->accesses[voxel].shadow);
  }
  EXPECT_GT(one->trace_seconds, 0.0);
}

TEST(CountedRender, CountsNothingWhenNotAsked) {
  const LitScene scene;
  const auto counted =
      render_counted(scene.open(), LitScene::settings(16, 1), {1, AccessCounting::kNone});

  EXPECT_EQ(sum_of(counted->accesses).total(), 0U);
  EXPECT_EQ(counted->rays.camera, 256U);
}

TEST(CountedRender, FindsADamagedBlock) {
  const LitScene scene;
  const auto offset = static_cast<std::streamoff>(4096 + 64);
  std::fstream file(scene.file(), std::ios::in | std::ios::out | std::ios::binary);
  file.seekg(offset);
  const int byte = file.get();
  file.seekp(offset);
  file.put(static_cast<char>(byte ^ 1));
  file.close();

  const auto counted = render_counted(scene.open(), LitScene::settings(16, 1), {1});

  ASSERT_FALSE(counted.has_value());
  EXPECT_EQ(counted.error().code, ExitCode::kStoreDamaged);
}

Prediction predicted(const char* model, const Store& store, const RenderSettings& settings,
                     std::uint32_t pixels = 0) {
  PredictionInput input{store.tables(), store.proxy(), settings, 2, &store};
  input.knobs.profile.pixels = pixels;
  const auto prediction = predict(model, input);
  EXPECT_TRUE(prediction.has_value()) << prediction.error().message;
  return *prediction;
}

TEST(ProfileModel, OracleIsTheRenderItself) {
  const LitScene scene;
  const Store store = scene.open();
  const RenderSettings settings = LitScene::settings(30, 2);
  const auto counted = render_counted(store, settings, {1});

  const Prediction oracle = predicted("oracle", store, settings);

  EXPECT_EQ(oracle.rays_total(), static_cast<double>(counted->rays.total()));
  for (std::size_t voxel = 0; voxel < counted->accesses.size(); ++voxel) {
    EXPECT_EQ(oracle.rays(voxel), static_cast<double>(counted->accesses[voxel].total()));
  }
}

TEST(ProfileModel, ScalesFewPixelsUpToTheImage) {
  const LitScene scene;
  const Store store = scene.open();
  RenderSettings settings = LitScene::settings(96, 4);
  const auto counted = render_counted(store, settings, {2});

  const Prediction profile = predicted("profile", store, settings, /*pixels=*/1024);

  EXPECT_EQ(profile.camera_total, 96.0 * 96.0 * 4.0);
  EXPECT_NEAR(profile.scatter_total / static_cast<double>(counted->rays.scatter), 1.0, 0.1);
  std::vector<double> e;
  std::vector<double> r;
  for (std::size_t voxel = 0; voxel < counted->accesses.size(); ++voxel) {
    e.push_back(profile.rays(voxel));
    r.push_back(static_cast<double>(counted->accesses[voxel].total()));
  }
  const Evaluation evaluation = evaluate(e, r);
  EXPECT_GT(*evaluation.pearson, 0.95);
  EXPECT_NEAR(*evaluation.total_ratio, 1.0, 0.1);
}

// One sample of every pixel, at most: an image smaller than the profile is profiled as it is.
TEST(ProfileModel, NeverRendersMorePixelsThanTheImageHas) {
  const LitScene scene;
  const Store store = scene.open();
  RenderSettings settings = LitScene::settings(9, 1);
  settings.width = 3;

  const Prediction profile = predicted("profile", store, settings);
  const Prediction oracle = predicted("oracle", store, settings);

  for (std::size_t voxel = 0; voxel < store.tables().voxels.size(); ++voxel) {
    EXPECT_EQ(profile.rays(voxel), oracle.rays(voxel));
  }
}

TEST(ProfileModel, NeedsTheTriangles) {
  const LitScene scene;
  const Store store = scene.open();
  for (const char* model : {"profile", "oracle"}) {
    const auto prediction =
        predict(model, {store.tables(), store.proxy(), LitScene::settings(8, 1), 1});
    ASSERT_FALSE(prediction.has_value());
    EXPECT_EQ(prediction.error().code, ExitCode::kUsage);
  }
}

}  // namespace
}  // namespace preheat
