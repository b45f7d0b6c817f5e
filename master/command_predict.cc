#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <thread>
#include <vector>

#include "cache/evaluation.h"
#include "cache/prediction.h"
#include "master/commands.h"
#include "master/options.h"
#include "master/predict_cost.h"
#include "master/prediction_knobs.h"
#include "master/scene_source.h"
#include "master/view.h"

namespace preheat {
namespace {

constexpr std::size_t kHottestPrinted = 10;
constexpr std::size_t kCellsPrinted = 64;  // as many as [P] has

struct PredictOptions {
  SceneOptions scene{};
  ViewOptions view{};
  std::string model = "transport";
  CostOptions cost{};
  PredictionKnobs knobs{};
  std::string json{};
  std::string csv{};
};

// What the model says of every voxel, and in which order it would preload them.
struct Ranking {
  Ranking(const Prediction& prediction, const SceneTables& tables) {
    for (std::size_t voxel = 0; voxel < tables.voxels.size(); ++voxel) {
      rays.push_back(prediction.rays(voxel));
      bytes.push_back(static_cast<double>(tables.voxels[voxel].resident_bytes));
    }
    order = hottest_first(rays, bytes);
  }
  [[nodiscard]] double captured(double bytes_share) const {
    return capture(order, rays, bytes, bytes_share);
  }
  std::vector<double> rays{};
  std::vector<double> bytes{};
  std::vector<std::size_t> order{};
};

// Leaf traversals of the octree's cells at the depth where the model stops.
std::string nodes_table(const NodePrediction& nodes) {
  if (nodes.rays_camera.empty()) { return ""; }
  std::string table = fmt::format(
      "\nleaf traversals of the {} cells of the octree cut at depth {}\n"
      "{:>8} {:>12} {:>12} {:>12} {:>12}\n",
      nodes.rays_camera.size(), nodes.depth, "cell", "camera", "scatter", "shadow", "traversals");
  for (std::size_t cell = 0; cell < std::min(kCellsPrinted, nodes.rays_camera.size()); ++cell) {
    table +=
        fmt::format("{:>8} {:>12.5g} {:>12.5g} {:>12.5g} {:>12.5g}\n", cell,
                    nodes.rays_camera[cell], nodes.rays_scatter[cell], nodes.rays_shadow[cell],
                    nodes.rays_camera[cell] + nodes.rays_scatter[cell] + nodes.rays_shadow[cell]);
  }
  if (nodes.rays_camera.size() > kCellsPrinted) { table += "     ...\n"; }
  return table;
}

std::string prediction_table(const Prediction& prediction, const SceneTables& tables,
                             const Ranking& ranking, const CostForecast& cost) {
  std::string table = fmt::format(
      "model            {}\n"
      "seconds          {:.4f}\n"
      "rays expected    {:.6g} = camera {:.6g} + scatter {:.6g} + shadow {:.6g}\n"
      "voxels           {} of {} resident bytes\n",
      prediction.model, prediction.seconds, prediction.rays_total(), prediction.camera_total,
      prediction.scatter_total, prediction.shadow_total, tables.voxels.size(),
      tables.resident_bytes());
  table += cost_table(cost, prediction);
  for (const double share : {0.01, 0.10, 0.25, 0.50}) {
    table += fmt::format("hottest {:3.0f} % of bytes are entered by {:5.1f} % of the accesses\n",
                         100.0 * share, 100.0 * ranking.captured(share));
  }
  table += fmt::format("\n{:>8} {:>12} {:>12} {:>12} {:>12} {:>12}\n", "voxel", "camera", "scatter",
                       "shadow", "rays", "bytes");
  for (std::size_t rank = 0; rank < std::min(kHottestPrinted, ranking.order.size()); ++rank) {
    const std::size_t voxel = ranking.order[rank];
    table += fmt::format("{:>8} {:>12.5g} {:>12.5g} {:>12.5g} {:>12.5g} {:>12}\n", voxel,
                         prediction.rays_camera[voxel], prediction.rays_scatter[voxel],
                         prediction.rays_shadow[voxel], prediction.rays(voxel),
                         tables.voxels[voxel].resident_bytes);
  }
  return table + nodes_table(prediction.nodes);
}

std::string prediction_json(const Prediction& prediction, const SceneTables& tables,
                            const Ranking& ranking, const CostForecast& cost) {
  nlohmann::ordered_json captures;
  for (const auto& [name, share] : {std::pair{"0.01", 0.01}, std::pair{"0.1", 0.1},
                                    std::pair{"0.25", 0.25}, std::pair{"0.5", 0.5}}) {
    captures[name] = ranking.captured(share);
  }
  nlohmann::ordered_json json = {{"model", prediction.model},
                                 {"seconds", prediction.seconds},
                                 {"rays_expected",
                                  {{"camera", prediction.camera_total},
                                   {"scatter", prediction.scatter_total},
                                   {"shadow", prediction.shadow_total},
                                   {"total", prediction.rays_total()},
                                   {"total_error", prediction.rays_total_error}}},
                                 {"cost", cost_json(cost)},
                                 {"voxels", tables.voxels.size()},
                                 {"resident_bytes", tables.resident_bytes()},
                                 {"capture_of_own_ranking", captures},
                                 {"rays_camera", prediction.rays_camera},
                                 {"rays_scatter", prediction.rays_scatter},
                                 {"rays_shadow", prediction.rays_shadow}};
  if (!prediction.nodes.rays_camera.empty()) {
    json["nodes"] = {{"unit", "leaf traversals"},
                     {"depth", prediction.nodes.depth},
                     {"rays_camera", prediction.nodes.rays_camera},
                     {"rays_scatter", prediction.nodes.rays_scatter},
                     {"rays_shadow", prediction.nodes.rays_shadow}};
  }
  return json.dump(2) + "\n";
}

std::string prediction_csv(const Prediction& prediction, const SceneTables& tables) {
  std::string csv = "voxel,rays_camera,rays_scatter,rays_shadow,rays,resident_bytes\n";
  for (std::size_t voxel = 0; voxel < tables.voxels.size(); ++voxel) {
    csv += fmt::format("{},{},{},{},{},{}\n", voxel, prediction.rays_camera[voxel],
                       prediction.rays_scatter[voxel], prediction.rays_shadow[voxel],
                       prediction.rays(voxel), tables.voxels[voxel].resident_bytes);
  }
  return csv;
}

Result<void> run_predict(const PredictOptions& options) {
  for (const std::string& file : {options.json, options.csv}) {
    if (auto writable = check_text_output(file); !writable) { return writable; }
  }
  const auto opened = open_scene(options.scene);
  if (!opened) { return tl::unexpected(opened.error()); }
  const Store& store = opened->store;
  const auto view = resolve_view(store.tables(), store.cameras(), options.view);
  if (!view) { return tl::unexpected(view.error()); }
  const auto prediction =
      predict(options.model, PredictionInput{store.tables(), store.proxy(), view->settings,
                                             std::max(1U, std::thread::hardware_concurrency()),
                                             &store, options.knobs});
  if (!prediction) { return tl::unexpected(prediction.error()); }
  const auto cost = measure_and_forecast_cost(store.tables(), *prediction, options.cost);
  if (!cost) { return tl::unexpected(cost.error()); }

  const Ranking ranking(*prediction, store.tables());
  if (options.json != "-" && options.csv != "-") {
    const std::string table = prediction_table(*prediction, store.tables(), ranking, *cost);
    if (auto printed = write_text_output("-", table); !printed) { return printed; }
  }
  if (!options.json.empty()) {
    const std::string json = prediction_json(*prediction, store.tables(), ranking, *cost);
    if (auto written = write_text_output(options.json, json); !written) { return written; }
  }
  if (options.csv.empty()) { return {}; }
  return write_text_output(options.csv, prediction_csv(*prediction, store.tables()));
}

}  // namespace

void add_predict_command(CLI::App& app, Command& chosen) {
  const auto options = std::make_shared<PredictOptions>();
  CLI::App* const command =
      app.add_subcommand("predict", "Say how many rays each voxel would see, without tracing one");
  add_scene_options(*command, options->scene);
  command->add_option("--model", options->model, "How to predict")
      ->type_name("MODEL")
      ->check(CLI::IsMember(prediction_models()))
      ->capture_default_str();
  add_view_options(*command, options->view);
  add_cost_options(*command, options->cost);
  add_prediction_knobs(*command, options->knobs);
  command->add_option("--json", options->json, "Write everything here; - for stdout")
      ->type_name("FILE");
  command->add_option("--csv", options->csv, "Write a line per voxel here; - for stdout")
      ->type_name("FILE");
  command->footer("Example: preheat predict demo --spp 64 --csv voxels.csv");
  command->callback([&chosen, options] { chosen = [options] { return run_predict(*options); }; });
}

}  // namespace preheat
