// preheat_simulation_bench: a frame of 3840x2160 pixels and 256 samples on 16, 128 and 1000
// workers, simulated from a recorded trace: efficiency, what it is lost to, origin load and preload
// time.
#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <nlohmann/json.hpp>

#include "master/file_output.h"
#include "tests/bench/bench_scene.h"
#include "tests/bench/cluster_simulation.h"

namespace preheat {
namespace {

struct Options {
  BenchSceneOptions scene{};
  ClusterOptions cluster{};
  FrameScale frame{};
  double cache = 0.25;
  double triangles_per_second = 2e6;  // of a cold voxel's build
  double hot_triangles_per_second = 1.5e6;
  std::vector<unsigned> workers{16, 128, 1000};
  std::string json{};
};

ClusterWork make_work(const Options& options, const BenchScene& scene, const AccessTrace& trace) {
  const std::uint64_t limit = scene.limit_bytes(options.cache);
  const PreloadPlan plan = scene.plan(limit);
  ClusterWork work;
  work.voxels = scene.sizes;
  work.is_hot = scene.is_hot(plan);
  for (const VoxelId voxel : plan.hot) {
    work.hot_block_bytes += scene.block_bytes[index_of(voxel)];
  }
  work.cold_limit_bytes = BenchScene::cold_limit_bytes(limit, plan);
  scale_frame(trace, options.frame, work);
  return work;
}

ClusterOptions cluster_options(const Options& options, const BenchScene& scene,
                               const ClusterWork& work) {
  double triangles = 0.0;
  double bytes = 0.0;
  double hot_triangles = 0.0;
  for (std::size_t voxel = 0; voxel < scene.sizes.size(); ++voxel) {
    const double count = scene.store.tables().voxels[voxel].triangle_count;
    triangles += count;
    bytes += static_cast<double>(scene.block_bytes[voxel]);
    hot_triangles += work.is_hot[voxel] ? count : 0.0;
  }
  ClusterOptions cluster = options.cluster;
  cluster.build_seconds_per_byte = triangles / bytes / options.triangles_per_second;
  cluster.hot_build_seconds = hot_triangles / options.hot_triangles_per_second;
  return cluster;
}

nlohmann::ordered_json simulate(const std::string& what, const ClusterWork& work,
                                const ClusterOptions& cluster) {
  const ClusterResult result = simulate_cluster(work, cluster);
  const ClusterSplit& split = result.split;
  const double total = cluster.workers * result.frame_seconds;
  fmt::print(
      "{:5} workers, {:28}: frame {:9.3f} s, efficiency {:.3f}, without preload {:.3f} | preload "
      "{:.3f}, stalled {:.3f}, doubled {:.3f}, idle {:.3f} | preload {:.3f} s, origin {:8.1f} MB, "
      "peers {:9.1f} MB, {} fetches\n",
      cluster.workers, what, result.frame_seconds, result.efficiency(),
      result.efficiency_rendering(), split.preload / total, split.stalled / total,
      split.duplicated / total, split.idle / total, result.preload_seconds,
      static_cast<double>(result.origin_bytes) / 1e6, static_cast<double>(result.peer_bytes) / 1e6,
      result.fetches);
  std::fflush(stdout);
  return {{"workers", cluster.workers},
          {"what", what},
          {"frame_seconds", result.frame_seconds},
          {"efficiency", result.efficiency()},
          {"efficiency_rendering", result.efficiency_rendering()},
          {"preload_seconds", result.preload_seconds},
          {"split_seconds",
           {{"traced", split.traced},
            {"preload", split.preload},
            {"stalled", split.stalled},
            {"duplicated", split.duplicated},
            {"idle", split.idle}}},
          {"origin_bytes", result.origin_bytes},
          {"peer_bytes", result.peer_bytes},
          {"fetches", result.fetches}};
}

// Costly tiles first, so that none of them is left for the end.
void order_by_cost(ClusterWork& work) {
  const auto rays = [&](const SimulatedTile& tile) {
    double sum = 0.0;
    for (const SimulatedWave& wave : work.waves[tile.recorded]) { sum += wave.rays; }
    return sum * tile.rays_share;
  };
  std::stable_sort(
      work.tiles.begin(), work.tiles.end(),
      [&](const SimulatedTile& a, const SimulatedTile& b) { return rays(a) > rays(b); });
}

Result<void> run(const Options& options) {
  const Result<BenchScene> scene = open_bench_scene(options.scene);
  if (!scene) { return tl::unexpected(scene.error()); }
  const Result<AccessTrace> trace = trace_of(options.scene, *scene);
  if (!trace) { return tl::unexpected(trace.error()); }
  nlohmann::ordered_json rows = nlohmann::ordered_json::array();
  for (const std::uint32_t tile_size : {32U, 16U}) {
    Options sized = options;
    sized.frame.tile_size = tile_size;
    ClusterWork work = make_work(sized, *scene, *trace);
    ClusterOptions cluster = cluster_options(options, *scene, work);
    for (const bool costly_first : {false, true}) {
      if (costly_first) { order_by_cost(work); }
      for (const bool doubled : {false, true}) {
        for (const unsigned workers : options.workers) {
          cluster.workers = workers;
          cluster.double_tiles = doubled;
          rows.push_back(simulate(
              fmt::format("tiles of {}{}{}", tile_size, costly_first ? ", costly first" : "",
                          doubled ? ", doubled" : ""),
              work, cluster));
        }
      }
    }
  }
  return options.json.empty() ? Result<void>{} : write_output(options.json, rows.dump(1) + '\n');
}

}  // namespace
}  // namespace preheat

int main(int argument_count, char** arguments) {
  spdlog::set_level(spdlog::level::warn);
  preheat::Options options;
  CLI::App app("A frame on many workers, simulated from a recorded trace");
  preheat::add_bench_scene_options(app, options.scene);
  app.add_option("--cache", options.cache, "Each worker's cache as a share of the resident size")
      ->check(CLI::Range(1e-6, 1.0));
  app.add_option("--workers", options.workers, "How many")->check(CLI::Range(1U, 100000U));
  app.add_option("--ray-seconds", options.cluster.seconds_per_ray, "Tracing and shading a ray")
      ->check(CLI::PositiveNumber);
  app.add_option("--build-rate", options.triangles_per_second,
                 "Triangles a second, of a cold voxel's build")
      ->check(CLI::PositiveNumber);
  app.add_option("--hot-build-rate", options.hot_triangles_per_second,
                 "Triangles a second, of the hot set's build")
      ->check(CLI::PositiveNumber);
  app.add_option("--fan-out", options.cluster.broadcast_fan_out, "Of the broadcast of the hot set")
      ->check(CLI::Range(1U, 64U));
  app.add_option("--slowness", options.cluster.slowness_mean,
                 "Mean of x, exponential, where a worker takes 1 + x as long")
      ->check(CLI::NonNegativeNumber);
  app.add_option("--json", options.json, "Writes what it found here")->type_name("FILE");
  CLI11_PARSE(app, argument_count, arguments);
  const preheat::Result<void> done = preheat::run(options);
  if (!done) { fmt::print(stderr, "preheat_simulation_bench: {}\n", done.error().message); }
  return done ? 0 : static_cast<int>(done.error().code);
}
