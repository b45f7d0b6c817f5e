// What a prediction means for a render: seconds of tracing and bytes over the network.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

#include "cache/prediction.h"
#include "cache/ray_cost.h"
#include "common/result.h"
#include "common/scene_tables.h"
#include "master/master.h"

namespace CLI {
class App;
}

namespace preheat {

// The workers that would render.
struct CostOptions {
  unsigned workers = 2;
  unsigned threads = 1;         // of each
  CacheSize cache{};            // of each
  double preload_share = -1.0;  // negative = auto
};

void add_cost_options(CLI::App& app, CostOptions& options);

struct CostForecast {
  unsigned threads = 0;          // of all workers
  double seconds_per_ray = 0.0;  // with all threads together
  double tracing_seconds = 0.0;  // where all that rays enter is hot
  double tracing_seconds_error =
      0.0;                     // standard error: of the seconds of a ray and of their number
  double preload_bytes = 0.0;  // blocks that each worker gets before its first tile
  // Blocks that each worker is expected to ask for once at least: of the voxels outside the hot
  // set, those that any of its rays enters. What a small cache evicts and fetches again is not in
  // it.
  double fetch_bytes = 0.0;
};

// Pure. `room_seconds` is what measure_room_ray() returns for `threads_measured` threads; workers
// are taken to be machines like the one that measured.
[[nodiscard]] Result<CostForecast> forecast_cost(const SceneTables& tables,
                                                 const Prediction& prediction,
                                                 const CostOptions& options, double room_seconds,
                                                 unsigned threads_measured);

// Measures the cost of a ray here first, in well under a second.
[[nodiscard]] Result<CostForecast> measure_and_forecast_cost(const SceneTables& tables,
                                                             const Prediction& prediction,
                                                             const CostOptions& options);

// Lines for the table that `predict` prints, and the same for its JSON.
[[nodiscard]] std::string cost_table(const CostForecast& forecast, const Prediction& prediction);
[[nodiscard]] nlohmann::ordered_json cost_json(const CostForecast& forecast);

}  // namespace preheat
