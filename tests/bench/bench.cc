// What the parts cost: the octree, the compiled store, prediction, and rays per second of one
// process with everything resident, beside Embree alone over the same rays. `./dev bench` prints
// the table and writes out/bench.json. PREHEAT_BENCH_STORE names another store than the demo's.
#include <benchmark/benchmark.h>
#include <spdlog/spdlog.h>

#include <atomic>
#include <cstdlib>
#include <filesystem>
#include <memory>
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

// How the resident voxels lie before the rays.
enum class Held { kHot, kCold };
// What is wanted of a ray: whether something blocks it, its nearest hit, or what shading needs of
// that.
enum class Asked { kAny, kClosest, kSurface };

// The whole scene resident, and every ray that the small view traces, in the order of tracing.
class TracedScene {
 public:
  TracedScene(const Store& store, Held held)
      : hot_(store.tables(), held == Held::kHot ? every_voxel(store) : std::vector<VoxelId>{}),
        resident_(store.tables().voxels.size(), 1),
        uses_(store.tables().voxels.size()) {
    for (const VoxelId voxel : every_voxel(store)) {
      const VoxelBlockView block =
          view_voxel_block(store.block(voxel), store.tables().materials.size()).value();
      if (held == Held::kHot) {
        hot_.add(block);
      } else {
        cold_.push_back(std::make_unique<VoxelMesh>(block));
        resident_.publish(voxel, cold_.back().get());
      }
    }
    residency_.emplace(device_, hot_, store.tables(),
                       held == Held::kHot ? std::vector<VoxelId>{} : every_voxel(store), resident_);
    record_rays(store);
  }

  [[nodiscard]] const std::vector<Ray>& closest() const { return closest_; }
  [[nodiscard]] const std::vector<Ray>& any() const { return any_; }
  [[nodiscard]] MeshArrays arrays() const { return hot_.arrays(); }

  // A sum of what was found, so that nothing is optimised away.
  std::size_t trace_all(const std::vector<Ray>& rays, Asked asked) {
    const ResidentTable::Guard guard(resident_, 0);
    std::size_t hits = 0;
    for (const Ray& ray : rays) {
      RayQuery query;
      query.ray = ray;
      query.any_hit = asked == Asked::kAny;
      residency_->trace(query, uses_);
      hits += query.blocked || query.has_hit() ? 1U : 0U;
      if (asked == Asked::kSurface && query.has_hit()) {
        const SurfaceHit surface = residency_->surface(query);
        hits += surface.material + (surface.normal_shading.x > surface.position.x ? 1U : 0U);
      }
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
          closest_.push_back(query.ray);
          residency_->trace(query, uses_);
          if (!query.has_hit()) { break; }
          vertex = shading.shade_hit(query.ray, residency_->surface(query), path);
          if (vertex.has_shadow_ray) { any_.push_back(vertex.shadow); }
        }
      }
    }
  }

  TracingDevice device_{2};
  HotMesh hot_;
  std::vector<std::unique_ptr<VoxelMesh>> cold_;
  ResidentTable resident_;
  std::optional<Residency> residency_;
  VoxelUses uses_;
  std::vector<Ray> closest_;
  std::vector<Ray> any_;
};

TracedScene& hot_scene() {
  static TracedScene scene(bench_store(), Held::kHot);
  return scene;
}

TracedScene& cold_scene() {
  static TracedScene scene(bench_store(), Held::kCold);
  return scene;
}

void count_rays(benchmark::State& state, const std::vector<Ray>& rays) {
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(rays.size()));
}

// One thread, one query at a time, over one BVH of Embree's own: the yardstick for the next.
void plain_embree(benchmark::State& state, BareEmbree::HitFilter filter, bool any_hit) {
  TracedScene& scene = hot_scene();
  const BareEmbree embree(scene.arrays(), filter);
  const std::vector<Ray>& rays = any_hit ? scene.any() : scene.closest();
  for (auto _ : state) {
    benchmark::DoNotOptimize(any_hit ? embree.trace_any(rays) : embree.trace_closest(rays));
  }
  count_rays(state, rays);
}
BENCHMARK_CAPTURE(plain_embree, closest, BareEmbree::HitFilter::kNone, false)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(plain_embree, closest_filtered, BareEmbree::HitFilter::kSame, false)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(plain_embree, closest_surface, BareEmbree::HitFilter::kSameWithSurface, false)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(plain_embree, any, BareEmbree::HitFilter::kNone, true)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(plain_embree, any_filtered, BareEmbree::HitFilter::kSame, true)
    ->Unit(benchmark::kMillisecond);

// The same rays as the renderer traces them: every voxel in the hot BVH, or every voxel resident
// behind its box.
void resident_voxels(benchmark::State& state, Held held, Asked asked) {
  TracedScene& scene = held == Held::kHot ? hot_scene() : cold_scene();
  const std::vector<Ray>& rays = asked == Asked::kAny ? scene.any() : scene.closest();
  for (auto _ : state) { benchmark::DoNotOptimize(scene.trace_all(rays, asked)); }
  count_rays(state, rays);
}
BENCHMARK_CAPTURE(resident_voxels, hot_closest, Held::kHot, Asked::kClosest)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(resident_voxels, hot_closest_surface, Held::kHot, Asked::kSurface)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(resident_voxels, hot_any, Held::kHot, Asked::kAny)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(resident_voxels, cold_closest_surface, Held::kCold, Asked::kSurface)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(resident_voxels, cold_any, Held::kCold, Asked::kAny)
    ->Unit(benchmark::kMillisecond);

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
