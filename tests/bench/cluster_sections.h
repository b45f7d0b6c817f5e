// Measurements of whole renders: a master, its workers and their caches, started as a user would.
//
// Every section returns its rows as JSON and logs a line per run. Times on a shared machine are
// noisy, so what is compared is run in turn and stated as a ratio to a neighbour in time.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "common/result.h"

namespace preheat {

// What is rendered: the arguments that name it.
struct BenchView {
  std::string name{};
  std::string scene{};
  std::string camera{};  // empty = the scene's first
};

struct BenchSettings {
  std::string folder{};   // of the programs
  std::string scratch{};  // for reports and images; exists
  std::vector<BenchView> views{};
  std::string size = "256x256";
  std::vector<unsigned> spp{8, 64};
  std::vector<double> cache_percents{100, 70, 50, 29, 12.5, 6.25, 3.1, 1.6, 0.8, 0.4};
  std::vector<std::string> preloads{"none",      "random",  "surface-area",
                                    "transport", "profile", "oracle"};
  unsigned repeats = 3;                      // of what only a ratio of times says
  std::uint64_t triangles_max = 50'000'000;  // of the generated scenes
};

using BenchRows = Result<nlohmann::ordered_json>;

// (a) Rays per second of the tracer beside a BVH of Embree's own, from preheat_bench.
[[nodiscard]] BenchRows measure_tracing(const BenchSettings& settings);

// (b) A master and two workers of one thread, everything hot, against --local with two threads.
[[nodiscard]] BenchRows measure_distribution(const BenchSettings& settings);

// (c) Time, hit rate, fetches, bytes and stall against the size of the cache, for every preload.
[[nodiscard]] BenchRows measure_cache_curve(const BenchSettings& settings);

// (d) Bytes over the network for each path, at 1 to 64 samples and a 25 % cache.
[[nodiscard]] BenchRows measure_wire_bytes(const BenchSettings& settings);

// (e) Hit rate over time, from a cold start and with a preload, at a 25 % cache.
[[nodiscard]] BenchRows measure_hits_over_time(const BenchSettings& settings);

// (f) Renders over links held to a rate, in network namespaces; skipped, with the reason, where
// they cannot be made.
[[nodiscard]] BenchRows measure_limited_links(const BenchSettings& settings);

// (h) Error against seconds: --local, preloaded and cold.
[[nodiscard]] BenchRows measure_error(const BenchSettings& settings);

// (i) Seconds and memory of compiling, the store's size, and a render, against triangles.
[[nodiscard]] BenchRows measure_scaling(const BenchSettings& settings);

}  // namespace preheat
