// What the parts cost: the octree, the compiled store, prediction, and rays per second of one
// process with everything resident, beside Embree alone over the same rays. `./dev bench` prints
// the table and writes out/bench.json. PREHEAT_BENCH_STORE names another store than the demo's.
#include <benchmark/benchmark.h>
#include <spdlog/spdlog.h>

#include <atomic>
#include <cstdlib>
#include <filesystem>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "cache/prediction.h"
#include "cache/tracing.h"
#include "common/check.h"
#include "common/octree.h"
#include "master/compiler.h"
#include "master/demo_scene.h"
#include "master/local_render.h"
#include "master/view.h"
#include "tests/bench/bare_embree.h"

namespace preheat {
namespace {

namespace fs = std::filesystem;

constexpr std::uint64_t kTriangles = 1'000'000;

const Scene& demo() {
  static const Scene scene = make_demo_scene(kTriangles);
  return scene;
}

// The demo as a store in a folder that ends with the process.
class DemoStore {
 public:
  DemoStore() {
    std::string name = (fs::temp_directory_path() / "preheat_bench_XXXXXX").string();
    folder_ = ::mkdtemp(name.data());
    const fs::path file = folder_ / "demo.store";
    CHECK(compile_scene(demo(), "demo", Hash128{}, CompileOptions{}, file).has_value());
    store_ = Store::open(file).value();
  }
  ~DemoStore() { fs::remove_all(folder_); }
  DemoStore(const DemoStore&) = delete;
  DemoStore& operator=(const DemoStore&) = delete;
  [[nodiscard]] const Store& store() const { return store_; }

 private:
  fs::path folder_{};
  Store store_{};
};

const Store& bench_store() {
  if (const char* const file = std::getenv("PREHEAT_BENCH_STORE")) {
    static const Store named = Store::open(file).value();
    return named;
  }
  static const DemoStore store;
  return store.store();
}

RenderSettings small_view(const Store& store) {
  ViewOptions view;
  view.size = {256, 256};
  view.spp = 4;
  return resolve_view(store.tables(), store.cameras(), view)->settings;
}

std::vector<VoxelId> every_voxel(const Store& store) {
  std::vector<VoxelId> voxels;
  for (std::uint32_t voxel = 0; voxel < store.tables().voxels.size(); ++voxel) {
    voxels.push_back(VoxelId{voxel});
  }
  return voxels;
}

// The whole scene as the hot set, and every ray that the small view traces, in the order of
// tracing.
class HotScene {
 public:
  explicit HotScene(const Store& store)
      : hot_(store.tables(), every_voxel(store)), resident_(store.tables().voxels.size(), 1) {
    for (const VoxelId voxel : every_voxel(store)) {
      hot_.add(view_voxel_block(store.block(voxel), store.tables().materials.size()).value());
    }
    residency_.emplace(device_, hot_, store.tables(), std::vector<VoxelId>{}, resident_);
    bare_.emplace(hot_.arrays());
    record_rays(store);
  }

  [[nodiscard]] const std::vector<TracedRay>& rays() const { return rays_; }
  [[nodiscard]] const BareEmbree& bare() const { return *bare_; }

  // Hits, so that nothing is optimised away.
  std::size_t trace_all() {
    const ResidentTable::Guard guard(resident_, 0);
    std::size_t hits = 0;
    for (const TracedRay& ray : rays_) {
      RayQuery query;
      query.ray = ray.ray;
      query.any_hit = ray.any_hit;
      residency_->trace(query);
      hits += query.blocked || query.has_hit() ? 1U : 0U;
    }
    return hits;
  }

 private:
  void record_rays(const Store& store) {
    const RenderSettings settings = small_view(store);
    const Shading shading(store.tables(), settings);
    const ResidentTable::Guard guard(resident_, 0);
    for (std::uint32_t pixel = 0; pixel < settings.width * settings.height; ++pixel) {
      for (std::uint32_t sample = 0; sample < settings.spp; ++sample) {
        PathState path;
        ShadedVertex vertex;
        vertex.scatter = shading.start_path(pixel, sample, path);
        vertex.has_scatter_ray = true;
        while (vertex.has_scatter_ray) {
          RayQuery query;
          query.ray = vertex.scatter;
          rays_.push_back({query.ray, false});
          residency_->trace(query);
          if (!query.has_hit()) { break; }
          vertex = shading.shade_hit(query.ray, query.surface, path);
          if (vertex.has_shadow_ray) { rays_.push_back({vertex.shadow, true}); }
        }
      }
    }
  }

  TracingDevice device_{2};
  HotMesh hot_;
  ResidentTable resident_;
  std::optional<Residency> residency_;
  std::optional<BareEmbree> bare_;
  std::vector<TracedRay> rays_;
};

HotScene& hot_scene() {
  static HotScene scene(bench_store());
  return scene;
}

// One thread, one closest- or any-hit query at a time: the yardstick for the next two.
void bare_embree(benchmark::State& state) {
  HotScene& scene = hot_scene();
  for (auto _ : state) { benchmark::DoNotOptimize(scene.bare().trace_all(scene.rays())); }
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(scene.rays().size()));
}
BENCHMARK(bare_embree)->Unit(benchmark::kMillisecond);

// The same rays through the hot BVH: with the filter that makes bits independent of the layout and
// with the surface that shading needs.
void hot_bvh(benchmark::State& state) {
  HotScene& scene = hot_scene();
  for (auto _ : state) { benchmark::DoNotOptimize(scene.trace_all()); }
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(scene.rays().size()));
}
BENCHMARK(hot_bvh)->Unit(benchmark::kMillisecond);

void triangles_per_second(benchmark::State& state) {
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(demo().triangles.size()));
}

void octree(benchmark::State& state) {
  OctreeLimits limits;
  limits.threads = static_cast<unsigned>(state.range(0));
  for (auto _ : state) { benchmark::DoNotOptimize(build_octree(demo(), limits).nodes.data()); }
  triangles_per_second(state);
}
BENCHMARK(octree)->ArgName("threads")->Arg(1)->Arg(2)->Unit(benchmark::kMillisecond)->UseRealTime();

void compile(benchmark::State& state) {
  const fs::path file = fs::temp_directory_path() / "preheat_bench.store";
  for (auto _ : state) {
    CHECK(compile_scene(demo(), "demo", Hash128{}, CompileOptions{}, file).has_value());
  }
  fs::remove(file);
  triangles_per_second(state);
}
BENCHMARK(compile)->Unit(benchmark::kMillisecond)->UseRealTime()->Iterations(1);

void prediction(benchmark::State& state, const std::string& model) {
  const Store& store = bench_store();
  const ResolvedView view = resolve_view(store.tables(), store.cameras(), {}).value();
  double rays = 0.0;
  for (auto _ : state) {
    rays = predict(model, PredictionInput{store.tables(), store.proxy(), view.settings,
                                          std::thread::hardware_concurrency()})
               ->rays_total();
  }
  state.counters["rays_expected"] = rays;
}
BENCHMARK_CAPTURE(prediction, transport, std::string("transport"))
    ->Unit(benchmark::kMillisecond)
    ->UseRealTime();
BENCHMARK_CAPTURE(prediction, uniform, std::string("uniform"))
    ->Unit(benchmark::kMillisecond)
    ->UseRealTime();

// Seconds are those of tracing alone, without building the BVH.
void local_render(benchmark::State& state) {
  const Store& store = bench_store();
  const RenderSettings settings = small_view(store);
  const std::atomic<int> no_signal{0};
  double rays = 0.0;
  for (auto _ : state) {
    const auto result = render_local(
        store, settings, {static_cast<unsigned>(state.range(0)), 32, AccessCounting::kNone},
        no_signal, [](const MasterProgress&) {});
    CHECK(result.has_value());
    state.SetIterationTime(result->render_seconds);
    rays += static_cast<double>(result->workers[0].rays.total());
  }
  state.counters["rays"] = benchmark::Counter(rays, benchmark::Counter::kIsRate);
}
BENCHMARK(local_render)
    ->ArgName("threads")
    ->Arg(1)
    ->Arg(2)
    ->Unit(benchmark::kMillisecond)
    ->UseManualTime();

}  // namespace
}  // namespace preheat

int main(int argument_count, char** arguments) {
  spdlog::set_level(spdlog::level::warn);
  benchmark::Initialize(&argument_count, arguments);
  if (benchmark::ReportUnrecognizedArguments(argument_count, arguments)) { return 2; }
  benchmark::RunSpecifiedBenchmarks();
  benchmark::Shutdown();
  return 0;
}
