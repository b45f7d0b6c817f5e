#include "master/predict_cost.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "common/voxel_block.h"

namespace preheat {
namespace {

// Three voxels of 1000, 2000 and 4000 bytes, 10.8 times that when hot.
SceneTables three_voxels() {
  SceneTables tables;
  for (const std::uint32_t bytes : {1000U, 2000U, 4000U}) {
    VoxelEntry entry;
    entry.block_bytes = bytes;
    entry.triangle_count = bytes / 10;
    entry.resident_bytes = bytes + bvh_bytes_bound(entry.triangle_count);
    tables.voxels.push_back(entry);
  }
  return tables;
}

Prediction prediction_of(const std::vector<double>& rays) {
  Prediction prediction;
  prediction.rays_camera = rays;
  prediction.rays_scatter.assign(rays.size(), 0.0);
  prediction.rays_shadow.assign(rays.size(), 0.0);
  prediction.camera_total = 1e6;
  prediction.rays_total_error = 1e3;
  return prediction;
}

TEST(PredictCost, IsRaysTimesTheSecondsOfOne) {
  CostOptions options;
  options.workers = 4;
  options.threads = 2;

  const SceneTables tables = three_voxels();
  const Prediction prediction = prediction_of({1.0, 1.0, 1.0});
  // Measured with two threads together; eight take a quarter of it.
  const auto forecast =
      forecast_cost(tables, prediction, options, /*room_seconds=*/1e-6, /*threads_measured=*/2);

  ASSERT_TRUE(forecast.has_value()) << forecast.error().message;
  const double seconds = 0.25 * seconds_per_ray(1e-6, levels_per_ray(tables, prediction));
  EXPECT_EQ(forecast->threads, 8U);
  EXPECT_DOUBLE_EQ(forecast->seconds_per_ray, seconds);
  EXPECT_DOUBLE_EQ(forecast->tracing_seconds, 1e6 * seconds);
  EXPECT_DOUBLE_EQ(forecast->tracing_seconds_error, std::hypot(kRayCostError * 1e6, 1e3) * seconds);
}

TEST(PredictCost, FetchesWhatIsNotHotAndWhatSomeRayEnters) {
  CostOptions options;
  options.workers = 2;
  options.cache.bytes = 70000;
  options.preload_share = 0.4;  // 28000 bytes: the two small voxels are not both hot

  const auto forecast =
      forecast_cost(three_voxels(), prediction_of({100.0, 4.0, 0.5}), options, 1e-6, 1);

  ASSERT_TRUE(forecast.has_value()) << forecast.error().message;
  EXPECT_DOUBLE_EQ(forecast->preload_bytes, 1000.0);
  EXPECT_NEAR(forecast->fetch_bytes,
              2000.0 * (1.0 - std::exp(-2.0)) + 4000.0 * (1.0 - std::exp(-0.25)), 1e-9);
}

TEST(PredictCost, FetchesNothingWhereEverythingIsHotOrNothingIsEntered) {
  CostOptions options;
  options.cache.share = 1.0;

  const auto all_hot = forecast_cost(three_voxels(), prediction_of({1.0, 1.0, 1.0}), options, 0, 1);
  const auto unseen = forecast_cost(three_voxels(), prediction_of({0.0, 0.0, 0.0}), options, 0, 1);

  EXPECT_EQ(all_hot->preload_bytes, 7000.0);
  EXPECT_EQ(all_hot->fetch_bytes, 0.0);
  EXPECT_EQ(unseen->preload_bytes, 0.0);
  EXPECT_EQ(unseen->fetch_bytes, 0.0);
}

TEST(PredictCost, RefusesACacheBelowOneVoxel) {
  CostOptions options;
  options.cache.bytes = 100;

  const auto forecast =
      forecast_cost(three_voxels(), prediction_of({1.0, 1.0, 1.0}), options, 1e-6, 1);

  ASSERT_FALSE(forecast.has_value());
  EXPECT_EQ(forecast.error().code, ExitCode::kUsage);
}

TEST(PredictCost, SaysTheSameInTheTableAndInJson) {
  const Prediction prediction = prediction_of({1.0, 1.0, 1.0});
  const auto forecast = forecast_cost(three_voxels(), prediction, CostOptions{}, 1e-6, 2);

  const nlohmann::json json = cost_json(*forecast);
  const std::string table = cost_table(*forecast, prediction);

  EXPECT_EQ(json["threads"], 2);
  EXPECT_DOUBLE_EQ(json["tracing_seconds"].get<double>(), forecast->tracing_seconds);
  const std::string line =
      fmt::format("{:.3g} s +- {:.2g} s with 2 threads, {:.3g} ns a ray", forecast->tracing_seconds,
                  forecast->tracing_seconds_error, forecast->seconds_per_ray * 1e9);
  EXPECT_NE(table.find(line), std::string::npos) << table;
}

}  // namespace
}  // namespace preheat
