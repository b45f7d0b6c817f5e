// preheat_policy_bench: every eviction policy over a recorded trace of a scene's rays, at cache
// sizes from all of the scene down to one voxel, beside what no policy can avoid; and, where asked
// for, over real renders.
#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <thread>

#include "cache/preload_plan.h"
#include "cache/tracing.h"
#include "common/check.h"
#include "master/view.h"
#include "tests/bench/belady_policy.h"
#include "tests/bench/cache_replay.h"
#include "tests/bench/real_cache_render.h"

namespace preheat {
namespace {

constexpr std::uint32_t kTileSize = 32;
constexpr std::array kShares{1.0, 0.5, 0.29, 0.25, 0.12, 0.06, 0.03, 0.016, 0.008, 0.004};
constexpr std::array kPolicies{Eviction::kLru, Eviction::kLfu, Eviction::kPrior, Eviction::kS3Fifo};

struct Options {
  std::string store{};
  ViewOptions view{};
  unsigned workers = 1;
  std::vector<double> shares{kShares.begin(), kShares.end()};
  std::string trace{};
  std::string json{};
  bool renders = false;
};

// A store, a view of it and what is predicted of that.
struct Bench {
  Store store;
  RenderSettings settings{};
  Prediction prediction{};
  std::vector<VoxelCache::Size> sizes{};
  std::vector<double> rays_expected{};

  [[nodiscard]] std::uint64_t limit_bytes(double share) const {
    const auto bytes = static_cast<double>(store.tables().resident_bytes()) * share;
    return std::max(store.tables().resident_bytes_min(), static_cast<std::uint64_t>(bytes));
  }
};

Bench open_bench(const Options& options) {
  Store store = Store::open(options.store).value();
  const auto view = resolve_view(store.tables(), store.cameras(), options.view);
  const unsigned threads = std::max(1U, std::thread::hardware_concurrency());
  Bench bench{std::move(store), view.value().settings};
  const SceneTables& tables = bench.store.tables();
  bench.prediction =
      predict("transport", {tables, bench.store.proxy(), bench.settings, threads}).value();
  for (std::size_t voxel = 0; voxel < tables.voxels.size(); ++voxel) {
    const VoxelEntry& entry = tables.voxels[voxel];
    bench.sizes.push_back({entry.block_bytes, VoxelMesh::bytes_max(entry.triangle_count)});
    bench.rays_expected.push_back(bench.prediction.rays(voxel));
  }
  return bench;
}

AccessTrace trace_of(const Options& options, const Bench& bench) {
  if (!options.trace.empty() && std::filesystem::exists(options.trace)) {
    return AccessTrace::load(options.trace).value();
  }
  AccessTrace trace = record_accesses(bench.store, bench.settings, kTileSize).value();
  if (!options.trace.empty()) { CHECK(trace.save(options.trace).has_value()); }
  return trace;
}

class TraceTable {
 public:
  TraceTable(const Bench& bench, const ReplaySteps& steps, unsigned workers)
      : bench_(bench),
        steps_(steps),
        chance_expected_(
            chance_per_period(bench.rays_expected, static_cast<double>(steps.size()) * workers)) {}

  nlohmann::ordered_json row(double share, bool preload) {
    const std::uint64_t limit = bench_.limit_bytes(share);
    std::vector<bool> is_hot(bench_.sizes.size());
    PreloadPlan plan;
    if (preload) {
      plan = plan_preload(bench_.store.tables(), bench_.prediction, limit, -1.0);
      for (const VoxelId voxel : plan.hot) { is_hot[index_of(voxel)] = true; }
    }
    const std::uint64_t left = limit - plan.hot_bytes;
    const std::uint64_t bound = fetched_bytes_bound(steps_, bench_.sizes, is_hot, left);
    const auto belady =
        replay(steps_, bench_.sizes, is_hot, left,
               std::make_unique<BeladyPolicy>(steps_of_use(steps_, bench_.sizes.size())));
    nlohmann::ordered_json row = {{"cache", share},
                                  {"limit_bytes", limit},
                                  {"hot_bytes", plan.hot_bytes},
                                  {"bound_bytes", bound}};
    add(row, "belady", belady, belady);
    for (const Eviction eviction : kPolicies) {
      EvictionInput input{{}, chance_expected_};
      for (const VoxelCache::Size& voxel : bench_.sizes) {
        input.bytes.push_back(voxel.block_bytes);
      }
      add(row, std::string(name_of(eviction)),
          replay(steps_, bench_.sizes, is_hot, left,
                 make_eviction_policy(eviction, std::move(input))),
          belady);
    }
    return row;
  }

 private:
  static void add(nlohmann::ordered_json& row, const std::string& name, const ReplayResult& result,
                  const ReplayResult& belady) {
    const auto bytes = static_cast<double>(result.counts.fetched_bytes);
    const auto fewest = static_cast<double>(belady.counts.fetched_bytes);
    row[name] = {{"hit_rate", result.hit_rate()},
                 {"fetches", result.counts.fetches},
                 {"fetched_bytes", result.counts.fetched_bytes},
                 {"rebuilds", result.counts.rebuilds},
                 {"over_belady", fewest > 0.0 ? bytes / fewest : 1.0}};
  }

  const Bench& bench_;
  const ReplaySteps& steps_;
  std::vector<double> chance_expected_;
};

void print_row(const nlohmann::ordered_json& row, bool preload) {
  fmt::print("{:5.1f} % {:7} {:8.1f}", 100.0 * row["cache"].get<double>(), preload ? "hot set" : "",
             row["bound_bytes"].get<double>() / 1e6);
  for (const auto& [name, result] : row.items()) {
    if (!result.is_object()) { continue; }
    fmt::print(" | {:5.3f} {:6} {:7.1f} {:5.2f}", result["hit_rate"].get<double>(),
               result["fetches"].get<std::uint64_t>(), result["fetched_bytes"].get<double>() / 1e6,
               result["over_belady"].get<double>());
  }
  fmt::print("\n");
  std::fflush(stdout);
}

nlohmann::ordered_json trace_tables(const Options& options, const Bench& bench) {
  const AccessTrace trace = trace_of(options, bench);
  const ReplaySteps steps = wave_steps(trace, kPathsPerThread, options.workers);
  fmt::print("trace: {} steps, {:.1f} MB\n", steps.size(),
             static_cast<double>(trace.bytes()) / 1e6);
  fmt::print("cache   preload bound MB | hit rate, fetches, MB, over Belady's: belady");
  for (const Eviction eviction : kPolicies) { fmt::print(" | {}", name_of(eviction)); }
  fmt::print("\n");
  TraceTable table(bench, steps, options.workers);
  nlohmann::ordered_json rows = nlohmann::ordered_json::array();
  for (const bool preload : {false, true}) {
    for (const double share : options.shares) {
      rows.push_back(table.row(share, preload));
      rows.back()["preload"] = preload;
      print_row(rows.back(), preload);
    }
  }
  return rows;
}

// The policies take turns, so that other load on the machine meets all of them.
nlohmann::ordered_json real_renders(const Options& options, const Bench& bench) {
  nlohmann::ordered_json rows = nlohmann::ordered_json::array();
  std::string sha256;
  for (const double share : options.shares) {
    for (const bool preload : {false, true}) {
      RendererOptions renderer;
      renderer.cache_limit_bytes = bench.limit_bytes(share);
      renderer.count_accesses = AccessCounting::kSampled;
      renderer.rays_expected = bench.rays_expected;
      PreloadPlan plan;
      if (preload) {
        plan =
            plan_preload(bench.store.tables(), bench.prediction, renderer.cache_limit_bytes, -1.0);
      }
      for (const Eviction eviction : kPolicies) {
        renderer.eviction = eviction;
        const RealCacheRender result =
            render_with_cache(bench.store, bench.settings, renderer, plan.hot).value();
        if (sha256.empty()) { sha256 = result.pixels_sha256; }
        CHECK(result.pixels_sha256 == sha256);
        rows.push_back({{"cache", share},
                        {"preload", preload},
                        {"policy", name_of(eviction)},
                        {"fetches", result.cache.remote_fetches},
                        {"fetched_bytes", result.cache.remote_bytes},
                        {"rebuilds", result.cache.rebuilds},
                        {"user_seconds", result.user_seconds}});
        fmt::print("{:5.1f} % {:7} {:7}: {:6} fetches {:8.1f} MB {:6} rebuilds {:7.2f} s user\n",
                   100.0 * share, preload ? "hot set" : "", name_of(eviction),
                   result.cache.remote_fetches,
                   static_cast<double>(result.cache.remote_bytes) / 1e6, result.cache.rebuilds,
                   result.user_seconds);
        std::fflush(stdout);
      }
    }
  }
  return rows;
}

int run(const Options& options) {
  const Bench bench = open_bench(options);
  nlohmann::ordered_json report = {{"store", options.store}, {"spp", bench.settings.spp}};
  if (options.renders) {
    report["renders"] = real_renders(options, bench);
  } else {
    report["trace"] = trace_tables(options, bench);
  }
  if (!options.json.empty()) {
    std::ofstream out(options.json);
    out << report.dump(1) << '\n';
    if (!out.flush()) {
      fmt::print(stderr, "preheat_policy_bench: {} cannot be written\n", options.json);
      return static_cast<int>(ExitCode::kOutputUnwritable);
    }
  }
  return 0;
}

}  // namespace
}  // namespace preheat

int main(int argument_count, char** arguments) {
  spdlog::set_level(spdlog::level::warn);
  preheat::Options options;
  CLI::App app("Eviction policies over a recorded trace or real renders");
  app.add_option("STORE", options.store, "A compiled scene")->required();
  preheat::add_view_options(app, options.view);
  app.add_option("--workers", options.workers, "The waves of a frame are shared by so many")
      ->check(CLI::Range(1U, preheat::kWorkersMax));
  app.add_option("--cache", options.shares, "Cache sizes as shares of the resident size")
      ->check(CLI::Range(1e-6, 1.0));
  app.add_option("--trace", options.trace, "Keeps the trace here, or takes it from here");
  app.add_option("--json", options.json, "Writes what it found here");
  app.add_flag("--renders", options.renders, "Renders for real instead of replaying a trace");
  CLI11_PARSE(app, argument_count, arguments);
  return preheat::run(options);
}
