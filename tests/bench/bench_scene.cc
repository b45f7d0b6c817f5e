#include "tests/bench/bench_scene.h"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <filesystem>
#include <thread>
#include <utility>

#include "cache/tracing.h"

namespace preheat {

void add_bench_scene_options(CLI::App& app, BenchSceneOptions& options) {
  app.add_option("STORE", options.store, "A compiled scene")->required();
  add_view_options(app, options.view);
  app.add_option("--trace", options.trace, "Keeps the trace here, or takes it from here")
      ->type_name("FILE");
}

std::uint64_t BenchScene::limit_bytes(double share) const {
  const auto bytes = static_cast<double>(store.tables().resident_bytes()) * share;
  return std::max(store.tables().resident_bytes_min(), static_cast<std::uint64_t>(bytes));
}

PreloadPlan BenchScene::plan(std::uint64_t limit_bytes) const {
  return plan_preload(store.tables(), prediction, limit_bytes, -1.0);
}

std::uint64_t BenchScene::cold_limit_bytes(std::uint64_t limit_bytes, const PreloadPlan& plan) {
  return limit_bytes - plan.hot_bytes - (plan.hot.empty() ? 0 : kBvhBytesFixed);
}

std::vector<bool> BenchScene::is_hot(const PreloadPlan& plan) const {
  std::vector<bool> is_hot(sizes.size());
  for (const VoxelId voxel : plan.hot) { is_hot[index_of(voxel)] = true; }
  return is_hot;
}

Result<BenchScene> open_bench_scene(const BenchSceneOptions& options) {
  Result<Store> store = Store::open(options.store);
  if (!store) { return tl::unexpected(store.error()); }
  const Result<ResolvedView> view = resolve_view(store->tables(), store->cameras(), options.view);
  if (!view) { return tl::unexpected(view.error()); }
  BenchScene scene{*std::move(store), view->settings};
  const SceneTables& tables = scene.store.tables();
  Result<Prediction> prediction =
      predict("transport", {tables, scene.store.proxy(), scene.settings,
                            std::max(1U, std::thread::hardware_concurrency())});
  if (!prediction) { return tl::unexpected(prediction.error()); }
  scene.prediction = *std::move(prediction);
  for (std::size_t voxel = 0; voxel < tables.voxels.size(); ++voxel) {
    const VoxelEntry& entry = tables.voxels[voxel];
    scene.sizes.push_back({entry.block_bytes, VoxelMesh::bytes_max(entry.triangle_count)});
    scene.block_bytes.push_back(entry.block_bytes);
    scene.rays_expected.push_back(scene.prediction.rays(voxel));
  }
  return scene;
}

Result<AccessTrace> trace_of(const BenchSceneOptions& options, const BenchScene& scene) {
  if (!options.trace.empty() && std::filesystem::exists(options.trace)) {
    return AccessTrace::load(options.trace);
  }
  Result<AccessTrace> trace = record_accesses(scene.store, scene.settings, kBenchTileSize);
  if (trace && !options.trace.empty()) {
    if (auto saved = trace->save(options.trace); !saved) { return tl::unexpected(saved.error()); }
  }
  return trace;
}

}  // namespace preheat
