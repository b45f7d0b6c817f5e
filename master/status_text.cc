#include "master/status_text.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <functional>
#include <string_view>
#include <utility>
#include <vector>

namespace preheat {
namespace {

using Json = nlohmann::ordered_json;

const char* name_of(JobPhase phase) {
  switch (phase) {
    case JobPhase::kWaiting:
      return "waiting";
    case JobPhase::kRendering:
      return "rendering";
    case JobPhase::kFarewell:
      return "farewell";
    case JobPhase::kOver:
      return "over";
  }
  return "over";
}

const char* name_of(WorkerState state) {
  switch (state) {
    case WorkerState::kPreparing:
      return "preparing";
    case WorkerState::kReady:
      return "ready";
    case WorkerState::kGone:
      return "gone";
  }
  return "gone";
}

std::size_t count_of(const RenderSnapshot& snapshot, WorkerState state) {
  return static_cast<std::size_t>(
      std::count_if(snapshot.workers.begin(), snapshot.workers.end(),
                    [state](const WorkerSnapshot& worker) { return worker.state == state; }));
}

WorkerStats sum_from(const RenderSnapshot& snapshot, std::size_t first) {
  WorkerStats sum;
  for (std::size_t id = first; id < snapshot.workers.size(); ++id) {
    const WorkerStats& stats = snapshot.workers[id].stats;
    sum.tiles += stats.tiles;
    sum.rays.add(stats.rays);
    sum.cache.add(stats.cache);
    sum.preload.voxels += stats.preload.voxels;
    sum.preload.bytes += stats.preload.bytes;
  }
  return sum;
}

Json hit_rate_json(const CacheStats& cache) {
  if (cache.accesses == 0) { return nullptr; }
  return 1.0 -
         std::min(1.0, static_cast<double>(cache.misses) / static_cast<double>(cache.accesses));
}

Json cache_json(const CacheStats& cache) {
  return {{"limit_bytes", cache.limit_bytes},   {"peak_bytes", cache.peak_bytes},
          {"accesses", cache.accesses},         {"misses", cache.misses},
          {"hit_rate", hit_rate_json(cache)},   {"remote_fetches", cache.remote_fetches},
          {"remote_bytes", cache.remote_bytes}, {"rebuilds", cache.rebuilds},
          {"evictions", cache.evictions},       {"stall_seconds", cache.stall_seconds}};
}

// One metric with its values by labels.
class Metric {
 public:
  Metric(std::string_view name, std::string_view type, std::string_view help)
      : name_(name), text_(fmt::format("# HELP {0} {1}\n# TYPE {0} {2}\n", name, help, type)) {}

  template <class Number>
  void add(std::string_view labels, Number value) {
    text_ += labels.empty() ? fmt::format("{} {}\n", name_, value)
                            : fmt::format("{}{{{}}} {}\n", name_, labels, value);
  }
  [[nodiscard]] const std::string& text() const { return text_; }

 private:
  std::string name_;
  std::string text_;
};

std::string label(std::string_view name, std::string_view value) {
  std::string escaped;
  for (const char c : value) {
    if (c == '\\' || c == '"') { escaped += '\\'; }
    if (c == '\n') {
      escaped += "\\n";
    } else {
      escaped += c;
    }
  }
  return fmt::format("{}=\"{}\"", name, escaped);
}

struct WorkerMetric {
  const char* name;
  const char* type;
  const char* help;
  double (*value)(const WorkerStats&);
};

template <class Number>
double real(Number value) {
  return static_cast<double>(value);
}

constexpr std::array kWorkerMetrics{
    WorkerMetric{"preheat_worker_tiles_total", "counter", "Tiles rendered.",
                 [](const WorkerStats& stats) { return real(stats.tiles); }},
    WorkerMetric{"preheat_cache_accesses_total", "counter",
                 "Rays that entered a voxel, scaled up where sampled.",
                 [](const WorkerStats& stats) { return real(stats.cache.accesses); }},
    WorkerMetric{"preheat_cache_misses_total", "counter", "Rays that waited for a voxel.",
                 [](const WorkerStats& stats) { return real(stats.cache.misses); }},
    WorkerMetric{"preheat_fetches_total", "counter", "Voxels fetched while rendering.",
                 [](const WorkerStats& stats) { return real(stats.cache.remote_fetches); }},
    WorkerMetric{"preheat_fetched_bytes_total", "counter", "Bytes fetched while rendering.",
                 [](const WorkerStats& stats) { return real(stats.cache.remote_bytes); }},
    WorkerMetric{"preheat_cache_evictions_total", "counter", "Voxels evicted.",
                 [](const WorkerStats& stats) { return real(stats.cache.evictions); }},
    WorkerMetric{"preheat_cache_rebuilds_total", "counter",
                 "Trees built again from bytes that were held.",
                 [](const WorkerStats& stats) { return real(stats.cache.rebuilds); }},
    WorkerMetric{"preheat_stall_seconds_total", "counter",
                 "Seconds of threads without a ray that could run.",
                 [](const WorkerStats& stats) { return stats.cache.stall_seconds; }},
    WorkerMetric{"preheat_cache_limit_bytes", "gauge", "Limit of the cache.",
                 [](const WorkerStats& stats) { return real(stats.cache.limit_bytes); }},
    WorkerMetric{"preheat_cache_peak_bytes", "gauge", "Most that the cache has held.",
                 [](const WorkerStats& stats) { return real(stats.cache.peak_bytes); }},
    WorkerMetric{"preheat_preload_bytes", "gauge", "Bytes held before the first tile.",
                 [](const WorkerStats& stats) { return real(stats.preload.bytes); }},
};

std::string job_metrics(const StatusFacts& facts, const RenderSnapshot& snapshot) {
  std::string text;
  const auto single = [&text](const char* name, const char* type, const char* help, double value) {
    Metric metric(name, type, help);
    metric.add("", value);
    text += metric.text();
  };
  Metric build("preheat_build_info", "gauge", "Constant 1; the labels say what runs.");
  build.add(label("version", facts.version) + "," + label("isa", facts.isa) + "," +
                label("scene", facts.scene),
            1);
  text += build.text();
  Metric phase("preheat_phase", "gauge", "1 for the phase that the render is in.");
  for (const JobPhase each : {JobPhase::kWaiting, JobPhase::kRendering, JobPhase::kFarewell}) {
    phase.add(label("phase", name_of(each)), each == snapshot.phase ? 1 : 0);
  }
  text += phase.text();
  single("preheat_tiles", "gauge", "Tiles of the image.", snapshot.tiles_total);
  single("preheat_tiles_committed_total", "counter", "Tiles that have arrived.",
         snapshot.tiles_done);
  Metric workers("preheat_workers", "gauge", "Workers by state.");
  for (const WorkerState state :
       {WorkerState::kPreparing, WorkerState::kReady, WorkerState::kGone}) {
    workers.add(label("state", name_of(state)), count_of(snapshot, state));
  }
  text += workers.text();
  single("preheat_workers_lost_total", "counter", "Workers gone without a farewell.",
         snapshot.workers_lost);
  single("preheat_leases_granted_total", "counter", "Tiles handed out, again ones too.",
         real(snapshot.leases.granted));
  single("preheat_leases_doubled_total", "counter", "Last tiles handed to a second worker.",
         real(snapshot.leases.doubled));
  single("preheat_leases_expired_total", "counter", "Tiles taken back.",
         real(snapshot.leases.expired));
  single("preheat_results_duplicate_total", "counter", "Results equal to one that was there.",
         real(snapshot.leases.duplicates));
  single("preheat_results_mismatch_total", "counter", "Results unlike one that was there.",
         real(snapshot.leases.mismatches));
  single("preheat_rendering_seconds", "gauge", "Seconds since the first tile was handed out.",
         snapshot.rendering_seconds);
  return text;
}

}  // namespace

Json make_status_json(const StatusFacts& facts, const RenderSnapshot& snapshot,
                      std::uint64_t image_version) {
  const WorkerStats sum = sum_from(snapshot, 0);
  Json json = {
      {"version", facts.version},
      {"scene", facts.scene},
      {"image",
       {{"width", facts.width},
        {"height", facts.height},
        {"spp", facts.spp},
        {"bounces", facts.bounces},
        {"revision", image_version}}},
      {"phase", name_of(snapshot.phase)},
      {"tiles", {{"done", snapshot.tiles_done}, {"total", snapshot.tiles_total}}},
      {"workers",
       {{"ready", count_of(snapshot, WorkerState::kReady)},
        {"preparing", count_of(snapshot, WorkerState::kPreparing)},
        {"gone", count_of(snapshot, WorkerState::kGone)},
        {"lost", snapshot.workers_lost}}},
      {"leases",
       {{"granted", snapshot.leases.granted},
        {"doubled", snapshot.leases.doubled},
        {"expired", snapshot.leases.expired},
        {"duplicates", snapshot.leases.duplicates},
        {"mismatches", snapshot.leases.mismatches}}},
      {"rays", sum.rays.total()},
      {"cache", cache_json(sum.cache)},
      {"time", {{"waiting", snapshot.waiting_seconds}, {"rendering", snapshot.rendering_seconds}}},
      {"worker", Json::array()}};
  const std::size_t shown = std::min(snapshot.workers.size(), kStatusWorkersMax);
  for (std::size_t id = 0; id < shown; ++id) {
    const WorkerSnapshot& worker = snapshot.workers[id];
    json["worker"].push_back({{"id", id},
                              {"state", name_of(worker.state)},
                              {"threads", worker.threads},
                              {"leases", worker.leases},
                              {"tiles", worker.stats.tiles},
                              {"rays", worker.stats.rays.total()},
                              {"preload_bytes", worker.stats.preload.bytes},
                              {"cache", cache_json(worker.stats.cache)}});
  }
  json["workers_not_listed"] = snapshot.workers.size() - shown;
  return json;
}

std::string make_metrics(const StatusFacts& facts, const RenderSnapshot& snapshot) {
  std::vector<std::pair<std::string, WorkerStats>> rows;
  const std::size_t shown = std::min(snapshot.workers.size(), kStatusWorkersMax);
  for (std::size_t id = 0; id < shown; ++id) {
    rows.emplace_back(label("worker", std::to_string(id)), snapshot.workers[id].stats);
  }
  if (snapshot.workers.size() > shown) {
    rows.emplace_back(label("worker", "rest"), sum_from(snapshot, shown));
  }
  std::string text = job_metrics(facts, snapshot);
  Metric rays("preheat_rays_total", "counter", "Rays traced.");
  for (const auto& [worker, stats] : rows) {
    rays.add(worker + "," + label("type", "camera"), stats.rays.camera);
    rays.add(worker + "," + label("type", "scatter"), stats.rays.scatter);
    rays.add(worker + "," + label("type", "shadow"), stats.rays.shadow);
  }
  text += rays.text();
  for (const WorkerMetric& each : kWorkerMetrics) {
    Metric metric(each.name, each.type, each.help);
    for (const auto& [worker, stats] : rows) { metric.add(worker, each.value(stats)); }
    text += metric.text();
  }
  return text;
}

}  // namespace preheat
