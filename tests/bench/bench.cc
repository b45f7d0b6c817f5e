// What the parts cost: the octree, the compiled store, prediction, and rays per second of one
// process with everything resident. `./dev bench` prints the table and writes out/bench.json.
#include <benchmark/benchmark.h>
#include <spdlog/spdlog.h>

#include <atomic>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <thread>

#include "cache/prediction.h"
#include "common/check.h"
#include "common/octree.h"
#include "master/compiler.h"
#include "master/demo_scene.h"
#include "master/local_render.h"
#include "master/view.h"

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

const Store& demo_store() {
  static const DemoStore store;
  return store.store();
}

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
  const Store& store = demo_store();
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
  const Store& store = demo_store();
  ViewOptions view;
  view.size = {256, 256};
  view.spp = 4;
  const RenderSettings settings = resolve_view(store.tables(), store.cameras(), view)->settings;
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
