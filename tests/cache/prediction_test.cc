#include "cache/prediction.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <numeric>

#include "cache/preload_plan.h"
#include "tests/cache/transport_truth.h"

namespace preheat {
namespace {

using testing::Each;
using testing::HasSubstr;
using testing::SizeIs;

SceneTables tables_of_sizes(const std::vector<std::uint64_t>& resident_bytes) {
  SceneTables tables;
  for (const std::uint64_t bytes : resident_bytes) {
    tables.voxels.emplace_back();
    tables.voxels.back().resident_bytes = bytes;
  }
  return tables;
}

Prediction predicted(const std::string& model, const SceneTables& tables, std::uint64_t seed = 0) {
  const Proxy proxy;
  RenderSettings settings;
  settings.seed = seed;
  Result<Prediction> prediction = predict(model, {tables, proxy, settings, 1});
  EXPECT_TRUE(prediction.has_value());
  return *prediction;
}

TEST(Prediction, RefusesAnUnknownModelAndListsTheKnown) {
  const SceneTables tables;
  const Proxy proxy;
  const RenderSettings settings;

  const Result<Prediction> prediction = predict("tarot", {tables, proxy, settings, 1});

  ASSERT_FALSE(prediction.has_value());
  EXPECT_EQ(prediction.error().code, ExitCode::kUsage);
  for (const char* name : {"tarot", "none", "random", "uniform", "transport"}) {
    EXPECT_THAT(prediction.error().message, HasSubstr(name));
  }
}

TEST(Prediction, EveryModelAnswersForAnEmptyScene) {
  const SceneTables tables;
  for (const std::string& model : prediction_models()) {
    if (model == "paper" || model == "profile" || model == "oracle") { continue; }  // read a store
    SCOPED_TRACE(model);
    const Prediction prediction = predicted(model, tables);
    EXPECT_EQ(prediction.model, model);
    EXPECT_THAT(prediction.rays_camera, SizeIs(0));
    EXPECT_EQ(prediction.camera_total, 512.0 * 512.0 * 16.0);
    EXPECT_GE(prediction.seconds, 0.0);
  }
}

TEST(Prediction, NoneExpectsNothing) {
  const Prediction prediction = predicted("none", tables_of_sizes({10, 20, 30}));

  EXPECT_THAT(prediction.rays_camera, Each(0.0));
  EXPECT_THAT(prediction.rays_scatter, Each(0.0));
  EXPECT_THAT(prediction.rays_shadow, Each(0.0));
}

TEST(Prediction, UniformMakesEveryByteAsHot) {
  const std::vector<std::uint64_t> sizes{7, 131, 3, 1000003};

  const Prediction prediction = predicted("uniform", tables_of_sizes(sizes));

  const double ratio = prediction.rays(0) / 7.0;
  EXPECT_GT(ratio, 0.0);
  for (std::size_t voxel = 0; voxel < sizes.size(); ++voxel) {
    EXPECT_EQ(prediction.rays(voxel) / static_cast<double>(sizes[voxel]), ratio);
  }
}

TEST(Prediction, RandomDependsOnTheSeedAlone) {
  const SceneTables tables = tables_of_sizes(std::vector<std::uint64_t>(100, 10));

  const Prediction first = predicted("random", tables, 1);

  EXPECT_EQ(first.rays_camera, predicted("random", tables, 1).rays_camera);
  EXPECT_NE(first.rays_camera, predicted("random", tables, 2).rays_camera);
}

}  // namespace
}  // namespace preheat
