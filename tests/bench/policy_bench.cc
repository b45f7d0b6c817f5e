// preheat_policy_bench: every eviction policy over a recorded trace of a scene's rays, at cache
// sizes from all of the scene down to one voxel, beside what no policy can avoid; and, where asked
// for, over real renders.
#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <array>
#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>

#include "common/check.h"
#include "master/file_output.h"
#include "tests/bench/belady_policy.h"
#include "tests/bench/bench_scene.h"
#include "tests/bench/cache_replay.h"
#include "tests/bench/real_cache_render.h"

namespace preheat {
namespace {

constexpr std::array kShares{1.0, 0.5, 0.29, 0.25, 0.12, 0.06, 0.03, 0.016, 0.008, 0.004};
constexpr std::array kPolicies{Eviction::kLru, Eviction::kLfu, Eviction::kPrior, Eviction::kS3Fifo};

struct Options {
  BenchSceneOptions scene{};
  unsigned workers = 1;
  std::vector<double> shares{kShares.begin(), kShares.end()};
  std::string json{};
  bool renders = false;
};

class TraceTable {
 public:
  TraceTable(const BenchScene& scene, const ReplaySteps& steps, unsigned workers)
      : scene_(scene),
        steps_(steps),
        chance_expected_(
            chance_per_period(scene.rays_expected, static_cast<double>(steps.size()) * workers)) {}

  nlohmann::ordered_json row(double share, bool preload) {
    const std::uint64_t limit = scene_.limit_bytes(share);
    const PreloadPlan plan = preload ? scene_.plan(limit) : PreloadPlan{};
    const std::vector<bool> is_hot = scene_.is_hot(plan);
    const std::uint64_t left = BenchScene::cold_limit_bytes(limit, plan);
    const std::uint64_t bound = fetched_bytes_bound(steps_, scene_.sizes, is_hot, left);
    const auto belady =
        replay(steps_, scene_.sizes, is_hot, left,
               std::make_unique<BeladyPolicy>(steps_of_use(steps_, scene_.sizes.size())));
    nlohmann::ordered_json row = {{"cache", share},
                                  {"limit_bytes", limit},
                                  {"hot_bytes", plan.hot_bytes},
                                  {"bound_bytes", bound}};
    add(row, "belady", belady, belady);
    for (const Eviction eviction : kPolicies) {
      add(row, std::string(name_of(eviction)),
          replay(steps_, scene_.sizes, is_hot, left,
                 make_eviction_policy(eviction, {scene_.block_bytes, chance_expected_})),
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

  const BenchScene& scene_;
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

nlohmann::ordered_json trace_tables(const Options& options, const BenchScene& scene,
                                    const AccessTrace& trace) {
  const ReplaySteps steps = wave_steps(trace, kPathsPerThread, options.workers);
  fmt::print("trace: {} steps, {:.1f} MB\n", steps.size(),
             static_cast<double>(trace.bytes()) / 1e6);
  fmt::print("cache   preload bound MB | hit rate, fetches, MB, over Belady's: belady");
  for (const Eviction eviction : kPolicies) { fmt::print(" | {}", name_of(eviction)); }
  fmt::print("\n");
  TraceTable table(scene, steps, options.workers);
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
nlohmann::ordered_json real_renders(const Options& options, const BenchScene& scene) {
  nlohmann::ordered_json rows = nlohmann::ordered_json::array();
  std::string sha256;
  for (const double share : options.shares) {
    for (const bool preload : {false, true}) {
      RendererOptions renderer;
      renderer.cache_limit_bytes = scene.limit_bytes(share);
      renderer.count_accesses = AccessCounting::kSampled;
      renderer.rays_expected = scene.rays_expected;
      const PreloadPlan plan = preload ? scene.plan(renderer.cache_limit_bytes) : PreloadPlan{};
      for (const Eviction eviction : kPolicies) {
        renderer.eviction = eviction;
        const RealCacheRender result =
            render_with_cache(scene.store, scene.settings, renderer, plan.hot).value();
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

Result<void> run(const Options& options) {
  const Result<BenchScene> scene = open_bench_scene(options.scene);
  if (!scene) { return tl::unexpected(scene.error()); }
  nlohmann::ordered_json report = {{"store", options.scene.store}, {"spp", scene->settings.spp}};
  if (options.renders) {
    report["renders"] = real_renders(options, *scene);
  } else {
    const Result<AccessTrace> trace = trace_of(options.scene, *scene);
    if (!trace) { return tl::unexpected(trace.error()); }
    report["trace"] = trace_tables(options, *scene, *trace);
  }
  return options.json.empty() ? Result<void>{} : write_output(options.json, report.dump(1) + '\n');
}

}  // namespace
}  // namespace preheat

int main(int argument_count, char** arguments) {
  spdlog::set_level(spdlog::level::warn);
  preheat::Options options;
  CLI::App app("Eviction policies over a recorded trace or real renders");
  preheat::add_bench_scene_options(app, options.scene);
  app.add_option("--workers", options.workers, "The waves of a frame are shared by so many")
      ->check(CLI::Range(1U, preheat::kWorkersMax));
  app.add_option("--cache", options.shares, "Cache sizes as shares of the resident size")
      ->check(CLI::Range(1e-6, 1.0));
  app.add_option("--json", options.json, "Writes what it found here")->type_name("FILE");
  app.add_flag("--renders", options.renders, "Renders for real instead of replaying a trace");
  CLI11_PARSE(app, argument_count, arguments);
  const preheat::Result<void> done = preheat::run(options);
  if (!done) { fmt::print(stderr, "preheat_policy_bench: {}\n", done.error().message); }
  return done ? 0 : static_cast<int>(done.error().code);
}
