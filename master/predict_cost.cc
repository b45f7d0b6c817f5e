#include "master/predict_cost.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <thread>
#include <vector>

#include "cache/preload_plan.h"
#include "common/limits.h"
#include "master/command_line.h"

namespace preheat {

void add_cost_options(CLI::App& app, CostOptions& options) {
  constexpr const char* kGroup = "Workers that would render";
  app.add_option("--workers", options.workers, "How many")
      ->type_name("N")
      ->check(in_range(1U, kWorkersMax))
      ->capture_default_str()
      ->group(kGroup);
  app.add_option("--threads", options.threads, "Tracing threads of each")
      ->type_name("N")
      ->check(in_range(1U, kThreadsMax))
      ->capture_default_str()
      ->group(kGroup);
  add_parsed_option(app, "--cache", options.cache, &parse_cache_size,
                    "Memory of each worker's voxels: bytes with KiB, MiB or GiB, or a share of "
                    "the scene's resident size")
      ->default_str("25%")
      ->type_name("BYTES|PERCENT")
      ->group(kGroup);
  add_parsed_option(app, "--preload-share", options.preload_share, &parse_preload_share,
                    "Share of the cache to preload")
      ->default_str("auto")
      ->type_name("0..1|auto")
      ->group(kGroup);
}

Result<CostForecast> forecast_cost(const SceneTables& tables, const Prediction& prediction,
                                   const CostOptions& options, double room_seconds,
                                   unsigned threads_measured) {
  const Result<std::uint64_t> cache_bytes = options.cache.resolve(tables);
  if (!cache_bytes) { return tl::unexpected(cache_bytes.error()); }
  CostForecast forecast;
  forecast.threads = options.workers * options.threads;
  forecast.seconds_per_ray = seconds_per_ray(room_seconds, levels_per_ray(tables, prediction)) *
                             threads_measured / forecast.threads;
  forecast.tracing_seconds = prediction.rays_total() * forecast.seconds_per_ray;
  forecast.tracing_seconds_error =
      std::hypot(kRayCostError * forecast.tracing_seconds,
                 prediction.rays_total_error * forecast.seconds_per_ray);

  const PreloadPlan plan = plan_preload(tables, prediction, *cache_bytes, options.preload_share);
  std::vector<bool> is_hot(tables.voxels.size(), false);
  for (const VoxelId voxel : plan.hot) { is_hot[index_of(voxel)] = true; }
  for (std::size_t voxel = 0; voxel < tables.voxels.size(); ++voxel) {
    const double bytes = tables.voxels[voxel].block_bytes;
    if (is_hot[voxel]) {
      forecast.preload_bytes += bytes;
    } else {
      // Of rays that arrive one by one, exp(-expected) is the chance of none.
      forecast.fetch_bytes += bytes * -std::expm1(-prediction.rays(voxel) / options.workers);
    }
  }
  return forecast;
}

Result<CostForecast> measure_and_forecast_cost(const SceneTables& tables,
                                               const Prediction& prediction,
                                               const CostOptions& options) {
  const unsigned threads =
      std::clamp(std::thread::hardware_concurrency(), 1U, options.workers * options.threads);
  const Result<double> room_seconds = measure_room_ray(threads);
  if (!room_seconds) { return tl::unexpected(room_seconds.error()); }
  return forecast_cost(tables, prediction, options, *room_seconds, threads);
}

std::string cost_table(const CostForecast& forecast, const Prediction& prediction) {
  return fmt::format(
      "standard error   {:.3g} rays\n"
      "tracing          {:.3g} s +- {:.2g} s with {} threads, {:.3g} ns a ray\n"
      "each worker      preloads {:.0f} bytes, fetches {:.0f} while it renders\n",
      prediction.rays_total_error, forecast.tracing_seconds, forecast.tracing_seconds_error,
      forecast.threads, forecast.seconds_per_ray * 1e9, forecast.preload_bytes,
      forecast.fetch_bytes);
}

nlohmann::ordered_json cost_json(const CostForecast& forecast) {
  return {{"threads", forecast.threads},
          {"seconds_per_ray", forecast.seconds_per_ray},
          {"tracing_seconds", forecast.tracing_seconds},
          {"tracing_seconds_error", forecast.tracing_seconds_error},
          {"preload_bytes_per_worker", forecast.preload_bytes},
          {"fetch_bytes_per_worker", forecast.fetch_bytes}};
}

}  // namespace preheat
