// How predicting grows with the leaves of the proxy and with the paths through it. A store affords
// a leaf for about eight triangles, so that the 29 million of the largest are those of more than a
// hundred million triangles.
#include <benchmark/benchmark.h>

#include "cache/transport_model.h"
#include "common/check.h"
#include "tests/bench/generated_proxy.h"

namespace preheat {
namespace {

void predict_hills(benchmark::State& state) {
  const GeneratedProxy hills = generate_hills(static_cast<std::uint32_t>(state.range(0)));
  PredictionInput input{hills.tables, hills.proxy, hills.settings, 1};
  input.knobs.transport.paths = static_cast<std::uint32_t>(state.range(1));
  double rays = 0.0;
  for (auto _ : state) {
    const auto prediction = predict_transport(input);
    CHECK(prediction.has_value());
    rays = prediction->rays_total();
  }
  const double samples =
      static_cast<double>(hills.settings.width) * hills.settings.height * hills.settings.spp;
  const double rays_walked = rays * static_cast<double>(state.range(1)) / samples;
  state.counters["leaves"] = static_cast<double>(hills.proxy.records.size());
  state.counters["bytes"] = static_cast<double>(hills.proxy.nodes.size() * sizeof(ProxyNode) +
                                                hills.proxy.records.size() * sizeof(ProxyRecord));
  state.counters["ns_per_ray"] =
      benchmark::Counter(rays_walked * 1e-9, benchmark::Counter::kIsIterationInvariantRate |
                                                 benchmark::Counter::kInvert);
}
BENCHMARK(predict_hills)
    ->ArgNames({"voxels_side", "paths"})
    ->Args({8, 4096})
    ->Args({32, 4096})
    ->Args({128, 4096})
    ->Args({32, 16384})
    ->Args({32, 65536})
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace preheat
