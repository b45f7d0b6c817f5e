#include "tests/bench/cluster_sections.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <filesystem>
#include <optional>

#include "master/image_compare.h"
#include "tests/bench/program_run.h"
#include "tests/scenes/scratch_folder.h"

namespace preheat {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;
using test::read_file;

using Arguments = std::vector<std::string>;

Arguments operator+(Arguments left, const Arguments& right) {
  left.insert(left.end(), right.begin(), right.end());
  return left;
}

Arguments view_arguments(const BenchSettings& settings, const BenchView& view, unsigned spp) {
  Arguments arguments{view.scene, "--size", settings.size, "--spp", std::to_string(spp)};
  if (!view.camera.empty()) { arguments = arguments + Arguments{"--camera", view.camera}; }
  return arguments;
}

const Arguments kLocal{"--local", "--threads", "2", "--count-accesses", "none"};
const Arguments kTwoWorkers{"--workers", "2", "--threads", "1"};

Result<ordered_json> read_json(const fs::path& file) {
  ordered_json json = ordered_json::parse(read_file(file), nullptr, /*allow_exceptions=*/false);
  if (json.is_discarded()) {
    return fail(ExitCode::kFailed, fmt::format("{} is not JSON", file.string()));
  }
  return json;
}

std::string program(const BenchSettings& settings, const char* name) {
  return (fs::path(settings.folder) / name).string();
}

struct Render {
  ProgramRun run{};
  ordered_json report{};
  fs::path image{};

  // Compiling is done once for all, and not part of a render.
  [[nodiscard]] double total_seconds() const {
    const ordered_json& time = report["time"];
    return time["total"].get<double>() - time["compile"].get<double>();
  }
  [[nodiscard]] double phase(const char* name) const { return report["time"][name].get<double>(); }
  [[nodiscard]] double rays() const { return report["rays"]["total"].get<double>(); }
};

// `launcher` goes in front of the program.
Result<Render> render(const BenchSettings& settings, const Arguments& arguments,
                      const Arguments& launcher = {}) {
  const fs::path scratch(settings.scratch);
  const fs::path log = scratch / "render.log";
  Render render{{}, {}, scratch / "image.exr"};
  const fs::path report = scratch / "report.json";
  const Arguments command = launcher + Arguments{program(settings, "preheat"), "render"} +
                            arguments +
                            Arguments{"-o", render.image.string(), "--report", report.string()};
  const Result<ProgramRun> run = run_program(command, log);
  if (!run) { return tl::unexpected(run.error()); }
  if (run->exit_code != 0) {
    return fail(ExitCode::kFailed, fmt::format("{} ended with {}:\n{}", fmt::join(command, " "),
                                               run->exit_code, read_file(log)));
  }
  render.run = *run;
  Result<ordered_json> read = read_json(report);
  if (!read) { return tl::unexpected(read.error()); }
  render.report = std::move(*read);
  return render;
}

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// No smaller than what one voxel takes, below which a worker refuses to start.
Arguments cache_argument(const ordered_json& scene, double percent) {
  const double bytes = 0.01 * percent * scene["resident_bytes"].get<double>();
  const double least = scene["resident_bytes_min"].get<double>();
  return {"--cache", fmt::format("{:.0f}", std::max(bytes, least))};
}

ordered_json row_of(const BenchView& view, unsigned spp) {
  return {{"view", view.name}, {"spp", spp}};
}

double preloaded_bytes(const ordered_json& report) {
  double bytes = 0.0;
  for (const ordered_json& worker : report["workers"]) {
    bytes += worker["preload"]["bytes"].get<double>();
  }
  return bytes;
}

// What the caches did.
void add_cache_figures(ordered_json& row, const Render& render) {
  const ordered_json& cache = render.report["cache"];
  row["seconds"] = render.total_seconds();
  row["seconds_predict"] = render.phase("predict");
  row["seconds_preload"] = render.phase("preload");
  row["seconds_render"] = render.phase("render");
  row["processor_seconds"] = render.run.processor_seconds;
  row["hit_rate"] = cache["hit_rate"];
  row["remote_fetches"] = cache["remote_fetches"];
  row["remote_bytes"] = cache["remote_bytes"];
  row["preload_bytes"] = preloaded_bytes(render.report);
  row["rebuilds"] = cache["rebuilds"];
  row["stall_seconds"] = cache["stall_seconds"];
  row["image"] = render.report["image"]["pixels_sha256"];
}

// The line of Google Benchmark's JSON that counts so many rays per second.
std::optional<double> items_per_second(const ordered_json& benchmarks, const std::string& name) {
  for (const ordered_json& line : benchmarks) {
    if (line["name"] == name) { return line["items_per_second"].get<double>(); }
  }
  return std::nullopt;
}

}  // namespace

BenchRows measure_tracing(const BenchSettings& settings) {
  const fs::path file = fs::path(settings.scratch) / "tracing.json";
  const fs::path log = fs::path(settings.scratch) / "tracing.log";
  const Result<ProgramRun> run = run_program(
      {program(settings, "preheat_bench"), "--benchmark_filter=plain_embree|resident",
       "--benchmark_repetitions=" + std::to_string(settings.repeats),
       "--benchmark_enable_random_interleaving=true", "--benchmark_report_aggregates_only=true",
       "--benchmark_out_format=json", "--benchmark_out=" + file.string()},
      log);
  if (!run) { return tl::unexpected(run.error()); }
  const Result<ordered_json> read = read_json(file);
  if (!read) { return read; }
  ordered_json rows = ordered_json::array();
  for (const char* const kind : {"closest", "any"}) {
    const bool closest = std::string_view(kind) == "closest";
    const auto rate = [&](const std::string& name) {
      return items_per_second((*read)["benchmarks"], name + "_median").value_or(0.0);
    };
    const double plain = rate(fmt::format("plain_embree/{}", kind));
    const double filtered = rate(fmt::format("plain_embree/{}_filtered", kind));
    const double hot = rate(fmt::format("resident_voxels/hot_{}", kind));
    // A nearest hit without its surface is of no use to a renderer.
    const char* const whole = closest ? "closest_surface" : "any";
    const double surface = closest ? rate("plain_embree/closest_surface") : filtered;
    const double hot_whole = rate(fmt::format("resident_voxels/hot_{}", whole));
    const double cold_whole = rate(fmt::format("resident_voxels/cold_{}", whole));
    rows.push_back({{"rays", kind},
                    {"plain_rays_per_second", plain},
                    {"filtered_rays_per_second", filtered},
                    {"surface_rays_per_second", surface},
                    {"hot_rays_per_second", hot},
                    {"hot_surface_rays_per_second", hot_whole},
                    {"cold_surface_rays_per_second", cold_whole},
                    {"filtered_over_plain", filtered / plain},
                    {"hot_over_filtered", hot / filtered},
                    {"hot_over_surface", hot_whole / surface},
                    {"cold_over_hot", cold_whole / hot_whole}});
    spdlog::info(
        "(a) {}: hot {:.3f} of Embree with the same filter, {:.3f} with the surface fetched by "
        "both, cold {:.3f} of hot; the filter leaves {:.3f} of plain Embree",
        kind, hot / filtered, hot_whole / surface, cold_whole / hot_whole, filtered / plain);
  }
  return rows;
}

BenchRows measure_distribution(const BenchSettings& settings) {
  ordered_json rows = ordered_json::array();
  for (const BenchView& view : settings.views) {
    const Arguments arguments = view_arguments(settings, view, settings.spp.back());
    std::vector<double> rendering;
    std::vector<double> whole;
    for (unsigned repeat = 0; repeat < settings.repeats; ++repeat) {
      const Result<Render> local = render(settings, arguments + kLocal);
      if (!local) { return tl::unexpected(local.error()); }
      const Result<Render> spread = render(
          settings, arguments + kTwoWorkers + Arguments{"--cache", "100%", "--preload-share", "1"});
      if (!spread) { return tl::unexpected(spread.error()); }
      rendering.push_back(local->phase("render") / spread->phase("render"));
      whole.push_back(local->total_seconds() / spread->total_seconds());
    }
    ordered_json row = row_of(view, settings.spp.back());
    row["speed_of_rendering"] = median(rendering);
    row["speed_of_the_whole"] = median(whole);
    spdlog::info("(b) {}: {:.3f} of --local's speed, {:.3f} with building and prediction",
                 view.name, median(rendering), median(whole));
    rows.push_back(std::move(row));
  }
  return rows;
}

BenchRows measure_cache_curve(const BenchSettings& settings) {
  ordered_json rows = ordered_json::array();
  for (const BenchView& view : settings.views) {
    for (const unsigned spp : settings.spp) {
      const Arguments arguments = view_arguments(settings, view, spp);
      for (const double percent : settings.cache_percents) {
        // Next to each size, as the machine's speed changes over minutes.
        const Result<Render> local = render(settings, arguments + kLocal);
        if (!local) { return tl::unexpected(local.error()); }
        const Arguments cache = cache_argument(local->report["scene"], percent);
        for (const std::string& preload : settings.preloads) {
          const Result<Render> spread =
              render(settings, arguments + kTwoWorkers + cache + Arguments{"--preload", preload});
          if (!spread) { return tl::unexpected(spread.error()); }
          ordered_json row = row_of(view, spp);
          row["cache_percent"] = percent;
          row["preload"] = preload;
          row["slowdown"] = spread->total_seconds() / local->total_seconds();
          add_cache_figures(row, *spread);
          row["equals_local"] = row["image"] == local->report["image"]["pixels_sha256"];
          spdlog::info(
              "(c) {} {} spp, cache {} %, {}: {:.2f} of --local's time, hit rate {:.5f}, "
              "{} fetches, {} bytes",
              view.name, spp, percent, preload, row["slowdown"].get<double>(),
              row["hit_rate"].is_null() ? 1.0 : row["hit_rate"].get<double>(),
              row["remote_fetches"].dump(), row["remote_bytes"].dump());
          rows.push_back(std::move(row));
        }
      }
    }
  }
  return rows;
}

BenchRows measure_wire_bytes(const BenchSettings& settings) {
  ordered_json rows = ordered_json::array();
  for (const BenchView& view : settings.views) {
    for (const unsigned spp : {1U, 4U, 16U, 64U}) {
      const Result<Render> spread =
          render(settings, view_arguments(settings, view, spp) + kTwoWorkers);
      if (!spread) { return tl::unexpected(spread.error()); }
      const double paths = spread->report["rays"]["camera"].get<double>();
      const double preloaded = preloaded_bytes(spread->report);
      const double fetched = spread->report["cache"]["remote_bytes"].get<double>();
      ordered_json row = row_of(view, spp);
      row["preload_bytes_per_path"] = preloaded / paths;
      row["remote_bytes_per_path"] = fetched / paths;
      row["bytes_per_path"] = (preloaded + fetched) / paths;
      spdlog::info("(d) {} {} spp: {:.0f} bytes a path, {:.0f} of them preloaded", view.name, spp,
                   (preloaded + fetched) / paths, preloaded / paths);
      rows.push_back(std::move(row));
    }
  }
  return rows;
}

BenchRows measure_hits_over_time(const BenchSettings& settings) {
  ordered_json rows = ordered_json::array();
  for (const BenchView& view : settings.views) {
    for (const char* const preload : {"none", "transport"}) {
      const Result<Render> spread =
          render(settings, view_arguments(settings, view, settings.spp.back()) + kTwoWorkers +
                               Arguments{"--preload", preload});
      if (!spread) { return tl::unexpected(spread.error()); }
      double accesses = 0.0;
      double misses = 0.0;
      double worst = 1.0;
      for (const ordered_json& point : spread->report["history"]) {
        const double entered = point["accesses"].get<double>() - accesses;
        const double missed = point["misses"].get<double>() - misses;
        accesses += entered;
        misses += missed;
        if (!(entered > 0.0)) { continue; }
        const double hit_rate = std::clamp(1.0 - missed / entered, 0.0, 1.0);
        worst = std::min(worst, hit_rate);
        ordered_json row = row_of(view, settings.spp.back());
        row["preload"] = preload;
        // Who preloads begins later.
        row["seconds"] =
            spread->phase("predict") + spread->phase("preload") + point["seconds"].get<double>();
        row["hit_rate"] = hit_rate;
        row["remote_fetches"] = point["remote_fetches"];
        row["remote_bytes"] = point["remote_bytes"];
        rows.push_back(std::move(row));
      }
      spdlog::info(
          "(e) {}, {}: least hit rate of an interval {:.4f}, of the whole {:.5f}, {:.2f} s",
          view.name, preload, worst, accesses > 0.0 ? 1.0 - misses / accesses : 1.0,
          spread->total_seconds());
    }
  }
  return rows;
}

BenchRows measure_limited_links(const BenchSettings& settings) {
  ordered_json rows = ordered_json::array();
  const fs::path script = fs::path(PREHEAT_BENCH_DIR) / "limited_link.sh";
  const fs::path log = fs::path(settings.scratch) / "link.log";
  const Result<ProgramRun> possible = run_program({"bash", script.string(), "check"}, log);
  if (!possible) { return tl::unexpected(possible.error()); }
  if (possible->exit_code != 0) {
    spdlog::warn("(f) skipped: {}", read_file(log));
    return rows;
  }
  for (const BenchView& view : settings.views) {
    for (const char* const rate : {"100mbit", "1gbit"}) {
      for (const unsigned workers : {1U, 2U, 4U}) {
        for (const char* const preload : {"none", "transport"}) {
          const Result<Render> spread = render(
              settings,
              view_arguments(settings, view, settings.spp.back()) + Arguments{"--preload", preload},
              {"bash", script.string(), "run", rate, std::to_string(workers), "25%"});
          if (!spread) { return tl::unexpected(spread.error()); }
          ordered_json row = row_of(view, settings.spp.back());
          row["rate"] = rate;
          row["workers"] = workers;
          row["preload"] = preload;
          add_cache_figures(row, *spread);
          spdlog::info("(f) {}, {} workers at {}, {}: {:.2f} s, hit rate {:.5f}, {} bytes",
                       view.name, workers, rate, preload, row["seconds"].get<double>(),
                       row["hit_rate"].is_null() ? 1.0 : row["hit_rate"].get<double>(),
                       row["remote_bytes"].dump());
          rows.push_back(std::move(row));
        }
      }
    }
  }
  return rows;
}

BenchRows measure_error(const BenchSettings& settings) {
  constexpr unsigned kReferenceSpp = 1024;
  ordered_json rows = ordered_json::array();
  const std::vector<std::pair<std::string, Arguments>> ways{
      {"local", kLocal},
      {"preloaded", kTwoWorkers},
      {"cold", kTwoWorkers + Arguments{"--preload", "none"}}};
  for (const BenchView& view : settings.views) {
    // Other samples, or its noise would be part of the images' own.
    const Result<Render> reference =
        render(settings,
               view_arguments(settings, view, kReferenceSpp) + kLocal + Arguments{"--seed", "1"});
    if (!reference) { return tl::unexpected(reference.error()); }
    const Result<Image> converged = read_image(reference->image);
    if (!converged) { return tl::unexpected(converged.error()); }
    for (const unsigned spp : {1U, 4U, 16U, 64U}) {
      for (const auto& [name, way] : ways) {
        const Result<Render> rendered = render(settings, view_arguments(settings, view, spp) + way);
        if (!rendered) { return tl::unexpected(rendered.error()); }
        const Result<Image> image = read_image(rendered->image);
        if (!image) { return tl::unexpected(image.error()); }
        const Result<ImageDifference> difference = compare_images(*image, *converged);
        if (!difference) { return tl::unexpected(difference.error()); }
        ordered_json row = row_of(view, spp);
        row["way"] = name;
        row["seconds"] = rendered->total_seconds();
        row["rmse"] = difference->rmse;
        row["relative_mse"] = difference->relative_mse;
        spdlog::info("(h) {} {} spp, {}: {:.2f} s, RMSE {:.4g}", view.name, spp, name,
                     row["seconds"].get<double>(), difference->rmse);
        rows.push_back(std::move(row));
      }
    }
  }
  return rows;
}

BenchRows measure_scaling(const BenchSettings& settings) {
  ordered_json rows = ordered_json::array();
  const fs::path scratch(settings.scratch);
  std::vector<std::string> scenes;
  for (const BenchView& view : settings.views) {
    if (std::find(scenes.begin(), scenes.end(), view.scene) == scenes.end()) {
      scenes.push_back(view.scene);
    }
  }
  for (const std::uint64_t millions : {1U, 10U, 50U}) {
    if (millions * 1'000'000 <= settings.triangles_max) {
      scenes.push_back(fmt::format("demo:{}M", millions));
    }
  }
  for (const std::string& scene : scenes) {
    const fs::path store = scratch / "scaling.store";
    const fs::path log = scratch / "compile.log";
    const Result<ProgramRun> compiled =
        run_program({program(settings, "preheat"), "compile", scene, "-o", store.string()}, log);
    if (!compiled) { return tl::unexpected(compiled.error()); }
    if (compiled->exit_code != 0) {
      return fail(ExitCode::kFailed, fmt::format("compile {} ended with {}:\n{}", scene,
                                                 compiled->exit_code, read_file(log)));
    }
    const Result<Render> spread = render(
        settings, Arguments{store.string(), "--size", settings.size, "--spp", "8"} + kTwoWorkers);
    if (!spread) { return tl::unexpected(spread.error()); }
    ordered_json row{{"scene", scene},
                     {"triangles", spread->report["scene"]["triangles"]},
                     {"compile_seconds", compiled->wall_seconds},
                     {"compile_peak_bytes", compiled->peak_bytes},
                     {"store_bytes", fs::file_size(store)},
                     {"render_peak_bytes", spread->run.peak_bytes}};
    add_cache_figures(row, *spread);
    spdlog::info("(i) {}: compiled in {:.1f} s and {} MiB into {} MiB, rendered in {:.2f} s", scene,
                 compiled->wall_seconds, compiled->peak_bytes >> 20, fs::file_size(store) >> 20,
                 row["seconds"].get<double>());
    rows.push_back(std::move(row));
    fs::remove(store);
  }
  return rows;
}

}  // namespace preheat
