#include "master/report.h"

#include <fmt/format.h>

#include <algorithm>
#include <optional>
#include <vector>

#include "cache/evaluation.h"
#include "common/content_hash.h"

namespace preheat {
namespace {

using Json = nlohmann::ordered_json;

// Accesses may be scaled up from a sample, so that they and the misses need not fit exactly.
std::uint64_t hits_of(const CacheStats& cache) {
  return cache.accesses - std::min(cache.accesses, cache.misses);
}

Json cache_json(const CacheStats& cache) {
  Json json = {{"limit_bytes", cache.limit_bytes},
               {"peak_bytes", cache.peak_bytes},
               {"build_peak_bytes", cache.build_peak_bytes},
               {"accesses", cache.accesses},
               {"hits", hits_of(cache)},
               {"misses", cache.misses},
               {"hit_rate", nullptr},
               {"remote_fetches", cache.remote_fetches},
               {"remote_bytes", cache.remote_bytes},
               {"rebuilds", cache.rebuilds},
               {"evictions", cache.evictions},
               {"stall_seconds", cache.stall_seconds}};
  if (cache.accesses > 0) {
    json["hit_rate"] = static_cast<double>(hits_of(cache)) / static_cast<double>(cache.accesses);
  }
  return json;
}

Json rays_json(const RayStats& rays) {
  return {{"camera", rays.camera},
          {"scatter", rays.scatter},
          {"shadow", rays.shadow},
          {"total", rays.total()},
          {"samples_invalid", rays.samples_invalid}};
}

// Where a worker's voxels came from.
Json sources_json(const SourceStats& sources) {
  return {{"preload_peer_bytes", sources.preload_peer_bytes},
          {"preload_origin_bytes", sources.preload_origin_bytes},
          {"remote_peer_fetches", sources.remote_peer_fetches},
          {"remote_peer_bytes", sources.remote_peer_bytes},
          {"remote_origin_bytes", sources.remote_origin_bytes},
          {"home_bytes", sources.home_bytes},
          {"sent_peer_bytes", sources.sent_peer_bytes},
          {"home_hits", sources.home_hits},
          {"peer_timeouts", sources.peer_timeouts},
          {"peer_lies", sources.peer_lies}};
}

WorkerStats sum_of(const std::vector<WorkerStats>& workers) {
  WorkerStats sum;
  for (const WorkerStats& worker : workers) {
    sum.tiles += worker.tiles;
    sum.rays.add(worker.rays);
    sum.cache.add(worker.cache);
    sum.sources.add(worker.sources);
    sum.preload.voxels = std::max(sum.preload.voxels, worker.preload.voxels);
    sum.preload.bytes = std::max(sum.preload.bytes, worker.preload.bytes);
    sum.preload.seconds = std::max(sum.preload.seconds, worker.preload.seconds);
  }
  return sum;
}

Json vector_json(const Vec3d& vector) { return {vector.x, vector.y, vector.z}; }

Json scene_json(const Store& store, const Features& features) {
  const StoreInfo& info = store.info();
  const SceneTables& tables = store.tables();
  return {{"file", info.source_file},
          {"triangles", tables.triangle_count},
          {"voxels", tables.voxels.size()},
          {"bytes", store.file_bytes()},
          {"resident_bytes", tables.resident_bytes()},
          {"resident_bytes_min", tables.resident_bytes_min()},
          {"hash", to_string(store.scene_hash())},
          {"features_modelled", features.modelled()},
          {"features_left_out", features.left_out()},
          {"import",
           {{"triangles_declared", info.import.triangles_declared},
            {"triangles_non_finite", info.import.triangles_non_finite},
            {"triangles_zero_area", info.import.triangles_zero_area},
            {"notes", info.import.notes}}}};
}

Json settings_json(const RenderRecord& record) {
  const RenderSettings& settings = record.view->settings;
  const Camera& camera = record.view->camera;
  Json json = {{"camera",
                {{"source", record.view->camera_source},
                 {"position", vector_json(camera.position_file)},
                 {"forward", vector_json(camera.forward)},
                 {"up", vector_json(camera.up)},
                 {"vertical_fov_rad", camera.vertical_fov_rad},
                 {"orthographic", camera.orthographic}}},
               {"bounces", settings.bounces},
               {"seed", settings.seed},
               {"sky", vector_json(Vec3d(settings.sky))},
               {"sky_source", record.view->sky_source}};
  json.update(record.settings);
  return json;
}

Json workers_json(const std::vector<WorkerStats>& workers) {
  Json json = Json::array();
  for (std::size_t id = 0; id < workers.size(); ++id) {
    const WorkerStats& worker = workers[id];
    json.push_back({{"id", id},
                    {"tiles", worker.tiles},
                    {"rays", worker.rays.total()},
                    {"preload",
                     {{"voxels", worker.preload.voxels},
                      {"bytes", worker.preload.bytes},
                      {"seconds", worker.preload.seconds}}},
                    {"cache", cache_json(worker.cache)},
                    {"sources", sources_json(worker.sources)}});
  }
  return json;
}

// What all workers had counted at the end of each of at most so many intervals.
constexpr std::size_t kIntervalsMax = 100;

Json history_json(const RenderHistory& history) {
  Json json = Json::array();
  if (history.workers.empty()) { return json; }
  for (const double seconds : interval_ends(history, kIntervalsMax)) {
    const auto sum = [&](auto HistoryPoint::*count) {
      double all = 0.0;
      for (const WorkerHistory& worker : history.workers) {
        all += count_at(worker, count, seconds);
      }
      return all;
    };
    json.push_back({{"seconds", seconds},
                    {"rays", sum(&HistoryPoint::rays)},
                    {"accesses", sum(&HistoryPoint::accesses)},
                    {"misses", sum(&HistoryPoint::misses)},
                    {"remote_fetches", sum(&HistoryPoint::remote_fetches)},
                    {"remote_bytes", sum(&HistoryPoint::remote_bytes)},
                    {"stall_seconds", sum(&HistoryPoint::stall_seconds)}});
  }
  return json;
}

// The share of the bytes that capture is compared at.
constexpr double kCaptureShare = 0.25;

Json json_of(const std::optional<double>& value) { return value ? Json(*value) : Json(nullptr); }

// What was predicted against what was counted, voxel by voxel.
Json prediction_error_json(const Prediction& prediction, const std::vector<double>& counted,
                           const std::vector<VoxelEntry>& voxels) {
  std::vector<double> expected;
  std::vector<double> bytes;
  for (std::size_t voxel = 0; voxel < counted.size(); ++voxel) {
    expected.push_back(prediction.rays(voxel));
    bytes.push_back(static_cast<double>(voxels[voxel].resident_bytes));
  }
  const Evaluation evaluation = evaluate(expected, counted);
  return {
      {"total_ratio", json_of(evaluation.total_ratio)},
      {"r2", json_of(evaluation.r2)},
      {"slope", json_of(evaluation.beta)},
      {"capture_at_0.25", capture(hottest_first(expected, bytes), counted, bytes, kCaptureShare)},
      {"capture_at_0.25_best",
       capture(hottest_first(counted, bytes), counted, bytes, kCaptureShare)}};
}

Json prediction_json(const RenderRecord& record) {
  const Prediction& prediction = *record.prediction;
  const std::vector<double>& counted = record.result->accesses_by_voxel;
  Json json = {{"model", prediction.model},
               {"seconds", prediction.seconds},
               {"rays_expected", prediction.rays_total()},
               {"error", nullptr}};
  if (prediction.model == "none") {
    json["error_unknown"] = "nothing was predicted";
  } else if (counted.empty()) {
    json["error_unknown"] =
        "accesses were not counted, or a worker that counted some was lost before the end";
  } else {
    json["error"] = prediction_error_json(prediction, counted, record.store->tables().voxels);
  }
  return json;
}

std::string in_mib(std::uint64_t bytes) {
  return fmt::format("{:.1f} MiB", static_cast<double>(bytes) / 1048576.0);
}

}  // namespace

nlohmann::ordered_json make_report(const RenderRecord& record) {
  const MasterResult& result = *record.result;
  const WorkerStats sum = sum_of(result.workers);
  const RenderSettings& settings = record.view->settings;
  Features features = detect_features(record.store->tables());
  features.environment = settings.sky != Vec3(0.0F);

  Json report;
  report["version"] = PREHEAT_VERSION;
  report["scene"] = scene_json(*record.store, features);
  report["settings"] = settings_json(record);
  report["image"] = {{"width", settings.width},
                     {"height", settings.height},
                     {"spp", settings.spp},
                     {"pixels_sha256", record.pixels_sha256},
                     {"standard_error", result.film.standard_error()}};
  report["prediction"] = prediction_json(record);
  report["preload"] = {{"voxels", sum.preload.voxels},
                       {"bytes", sum.preload.bytes},
                       {"seconds", sum.preload.seconds}};
  report["cache"] = cache_json(sum.cache);
  report["sources"] = sources_json(sum.sources);
  report["sources"]["origin_preload_bytes"] = result.origin.preload_bytes;
  report["sources"]["origin_remote_bytes"] = result.origin.remote_bytes;
  report["workers"] = workers_json(result.workers);
  report["history"] = history_json(result.history);
  report["leases"] = {{"granted", result.leases.granted},
                      {"doubled", result.leases.doubled},
                      {"expired", result.leases.expired},
                      {"duplicates", result.leases.duplicates},
                      {"mismatches", result.leases.mismatches}};
  report["connections_denied"] = result.connections_denied;
  report["rays"] = rays_json(sum.rays);
  report["time"] = {{"compile", record.seconds.compile},
                    {"predict", record.seconds.predict},
                    {"preload", record.seconds.preload},
                    {"render", record.seconds.render},
                    {"total", record.seconds.total()}};
  return report;
}

std::string make_summary(const RenderRecord& record) {
  const WorkerStats sum = sum_of(record.result->workers);
  const PhaseSeconds& seconds = record.seconds;
  const auto rays = static_cast<double>(sum.rays.total());
  std::string summary = fmt::format(
      "time     {:.2f} s = compile {:.2f} + predict {:.2f} + preload {:.2f} + render {:.2f}\n",
      seconds.total(), seconds.compile, seconds.predict, seconds.preload, seconds.render);
  summary += fmt::format("rays     {:.2f} M, {:.2f} M/s, {} worker(s)\n", rays * 1e-6,
                         seconds.render > 0.0 ? rays / seconds.render * 1e-6 : 0.0,
                         record.result->workers.size());
  const CacheStats& cache = sum.cache;
  const std::string hit_rate =
      cache.accesses == 0 ? std::string("not counted")
                          : fmt::format("{:.3f}%", 100.0 * static_cast<double>(hits_of(cache)) /
                                                       static_cast<double>(cache.accesses));
  summary +=
      fmt::format("cache    hit rate {}, limit {}, peak {}, preloaded {}\n", hit_rate,
                  in_mib(cache.limit_bytes), in_mib(cache.peak_bytes), in_mib(sum.preload.bytes));
  summary +=
      fmt::format("fetched  {} voxels, {}; {} rebuilds, {} evictions\n", cache.remote_fetches,
                  in_mib(cache.remote_bytes), cache.rebuilds, cache.evictions);
  summary += fmt::format("sha256   {}\n", record.pixels_sha256);
  return summary;
}

}  // namespace preheat
