// A store, a view of it, what is predicted of that, and the trace of its rays: what benchmarks that
// replay a trace begin with.
#pragma once

#include <string>
#include <vector>

#include "cache/prediction.h"
#include "cache/preload_plan.h"
#include "cache/voxel_cache.h"
#include "master/view.h"
#include "tests/bench/access_trace.h"

namespace CLI {
class App;
}

namespace preheat {

struct BenchSceneOptions {
  std::string store{};
  ViewOptions view{};
  std::string trace{};  // file; empty = recorded and dropped
};

void add_bench_scene_options(CLI::App& app, BenchSceneOptions& options);

struct BenchScene {
  Store store;
  RenderSettings settings{};
  Prediction prediction{};                   // of the model `transport`
  std::vector<double> rays_expected{};       // [voxel_count]
  std::vector<VoxelCache::Size> sizes{};     // [voxel_count]
  std::vector<std::uint64_t> block_bytes{};  // [voxel_count]

  // As `--cache` has it.
  [[nodiscard]] std::uint64_t limit_bytes(double share) const;
  // As `--preload transport` has it.
  [[nodiscard]] PreloadPlan plan(std::uint64_t limit_bytes) const;
  [[nodiscard]] std::vector<bool> is_hot(const PreloadPlan& plan) const;
  // What the hot set leaves of a limit.
  [[nodiscard]] static std::uint64_t cold_limit_bytes(std::uint64_t limit_bytes,
                                                      const PreloadPlan& plan);
};

[[nodiscard]] Result<BenchScene> open_bench_scene(const BenchSceneOptions& options);

inline constexpr std::uint32_t kBenchTileSize = 32;

// From options.trace where that exists, else recorded and kept there.
[[nodiscard]] Result<AccessTrace> trace_of(const BenchSceneOptions& options,
                                           const BenchScene& scene);

}  // namespace preheat
