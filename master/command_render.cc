#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <thread>

#include "cache/prediction.h"
#include "cache/renderer.h"
#include "cache/tracer.h"
#include "common/content_hash.h"
#include "master/command_line.h"
#include "master/commands.h"
#include "master/file_output.h"
#include "master/image_writer.h"
#include "master/local_render.h"
#include "master/master.h"
#include "master/progress.h"
#include "master/render_page.h"
#include "master/report.h"
#include "master/scene_source.h"
#include "master/signals.h"
#include "master/status_server.h"
#include "master/tev_display.h"
#include "master/tile_scheduler.h"
#include "master/view.h"

namespace preheat {
namespace {

struct RenderOptions {
  SceneOptions scene{};
  ViewOptions view{};
  std::string output{};
  std::string report{};
  std::string html{};
  std::string status{};
  bool insecure_status = false;
  std::string display{};
  double exposure_ev = 0.0;
  bool local = false;
  std::optional<unsigned> workers{};
  std::string listen{};
  unsigned wait_workers = 1;
  SecurityOptions security{};
  bool no_peers = false;
  std::string ledger{};
  std::string endpoint_file{};
  CacheSize cache{};
  std::string cache_text = "25%";
  std::string preload = "transport";
  double preload_share = -1.0;
  std::optional<unsigned> threads{};  // default: 1 per worker, all cores with --local
  std::uint32_t tile_size = 0;        // 0: by how many threads render
  AccessCounting count_accesses = AccessCounting::kSampled;
  std::uint32_t paths_per_thread = kPathsPerThread;
};

const char* name_of(AccessCounting counting) {
  switch (counting) {
    case AccessCounting::kNone:
      return "none";
    case AccessCounting::kSampled:
      return "sampled";
    case AccessCounting::kExact:
      return "exact";
  }
  return "none";
}

unsigned threads_of(const RenderOptions& options) {
  if (options.threads) { return *options.threads; }
  return options.local ? std::max(1U, std::thread::hardware_concurrency()) : 1U;
}

std::uint64_t threads_expected(const RenderOptions& options) {
  if (options.local) { return threads_of(options); }
  const std::uint64_t workers =
      options.listen.empty() ? options.workers.value_or(2) : options.wait_workers;
  return workers * threads_of(options);
}

// The worker program is installed beside this one.
std::string worker_program() {
  std::error_code error;
  const auto own = std::filesystem::read_symlink("/proc/self/exe", error);
  return error ? std::string("preheat-worker") : (own.parent_path() / "preheat-worker").string();
}

std::string security_of(const RenderOptions& options) {
  return describe_security(options.listen.empty() ? MasterOptions{}.listen : options.listen,
                           options.security);
}

MasterOptions master_options(const RenderOptions& options) {
  MasterOptions master;
  if (!options.listen.empty()) {
    master.listen = options.listen;
    master.workers_to_start = 0;
    master.wait_workers = options.wait_workers;
  } else {
    master.workers_to_start = options.workers.value_or(2);
    master.wait_workers = master.workers_to_start;
  }
  master.threads_per_worker = threads_of(options);
  master.cache = options.cache;
  master.preload_share = options.preload_share;
  master.tile_size = options.tile_size;
  master.count_accesses = options.count_accesses;
  master.paths_per_thread = options.paths_per_thread;
  master.worker_program = worker_program();
  master.peers = !options.no_peers;
  master.security = options.security;
  if (!options.security.keys_folder.empty()) { master.reload_keys = &catch_reload_signal(); }
  master.ledger_file = options.ledger;
  master.endpoint_file = options.endpoint_file;
  return master;
}

nlohmann::ordered_json settings_of(const RenderOptions& options) {
  nlohmann::ordered_json settings = {
      {"mode", options.local            ? "local"
               : options.listen.empty() ? "workers"
                                        : "listen"},
      {"workers", options.local ? 0U : options.workers.value_or(options.listen.empty() ? 2U : 0U)},
      {"threads", threads_of(options)},
      {"tile_size", options.tile_size},
      {"count_accesses", name_of(options.count_accesses)},
      {"paths_in_flight", options.paths_per_thread},
      {"paths_bytes_per_thread", options.paths_per_thread * Tracer::bytes_per_path()},
      {"exposure_ev", options.exposure_ev},
      {"isa", tracing_isa()}};
  if (!options.local) {
    settings["security"] = security_of(options);
    settings["cache"] = options.cache_text;
    settings["peers"] = !options.no_peers;
    settings["preload"] = options.preload;
    settings["preload_share"] = options.preload_share < 0.0
                                    ? nlohmann::ordered_json("auto")
                                    : nlohmann::ordered_json(options.preload_share);
  }
  return settings;
}

// Everything that can be known to fail before the first ray does so here.
Result<void> check_before(const RenderOptions& options) {
  if (auto format = image_format(options.output); !format) {
    return tl::unexpected(format.error());
  }
  if (auto writable = check_output(options.output); !writable) { return writable; }
  if (!options.listen.empty()) {
    const auto listen = check_endpoint(options.listen, options.security.reach_settled());
    if (!listen) { return tl::unexpected(listen.error()); }
  }
  if (!options.endpoint_file.empty()) {
    if (auto writable = check_output(options.endpoint_file); !writable) { return writable; }
  }
  if (!options.local && !options.security.keys_folder.empty()) {
    const auto keys = load_keys(options.security.keys_folder, KeyRole::kMaster);
    if (!keys) { return tl::unexpected(keys.error()); }
  }
  if (!options.status.empty()) {
    const auto status = check_status_address(options.status, options.insecure_status);
    if (!status) { return tl::unexpected(status.error()); }
  }
  if (!options.display.empty()) {
    const auto viewer = parse_display(options.display);
    if (!viewer) { return tl::unexpected(viewer.error()); }
  }
  if (auto page = check_text_output(options.html); !page) { return page; }
  return check_text_output(options.report);
}

Result<Prediction> predict_for(const RenderOptions& options, const Store& store,
                               const RenderSettings& settings) {
  // In one process everything is hot: only a report or a page has a use for a prediction, to
  // compare it with what was counted.
  const bool is_compared = (!options.report.empty() || !options.html.empty()) &&
                           options.count_accesses != AccessCounting::kNone;
  return predict(options.local && !is_compared ? "none" : options.preload,
                 PredictionInput{store.tables(), store.proxy(), settings,
                                 std::max(1U, std::thread::hardware_concurrency()), &store});
}

ImageMetadata metadata_of(const RenderRecord& record) {
  const RenderSettings& settings = record.view->settings;
  const auto security = record.settings.find("security");
  return {{"preheat.version", PREHEAT_VERSION},
          {"preheat.scene", record.store->info().source_file},
          {"preheat.scene_hash", to_string(record.store->scene_hash())},
          {"preheat.camera", record.view->camera_source},
          {"preheat.spp", fmt::format("{}", settings.spp)},
          {"preheat.bounces", fmt::format("{}", settings.bounces)},
          {"preheat.seed", fmt::format("{}", settings.seed)},
          {"preheat.isa", tracing_isa()},
          {"preheat.security", security == record.settings.end() ? std::string("none (one process)")
                                                                 : security->get<std::string>()},
          {"preheat.render_seconds", fmt::format("{:.3f}", record.seconds.render)},
          {"preheat.pixels_sha256", record.pixels_sha256}};
}

// Those who look on, one told after the other.
class Watchers : public RenderWatch {
 public:
  void add(std::unique_ptr<RenderWatch> watch) { list_.push_back(std::move(watch)); }
  // nullptr if nobody looks on.
  [[nodiscard]] RenderWatch* get() { return list_.empty() ? nullptr : this; }

  void look(RenderSnapshot snapshot) override {
    for (const auto& watch : list_) { watch->look(snapshot); }
  }
  void tile_done(const TileRect& rect, const TilePixels& pixels) override {
    for (const auto& watch : list_) { watch->tile_done(rect, pixels); }
  }

 private:
  std::vector<std::unique_ptr<RenderWatch>> list_;
};

Result<void> add_watchers(const RenderOptions& options, const Store& store,
                          const RenderSettings& settings, Watchers& watchers) {
  if (!options.status.empty()) {
    const StatusFacts facts{PREHEAT_VERSION, store.info().source_file, tracing_isa(),
                            settings.width,  settings.height,          settings.spp,
                            settings.bounces};
    auto status = StatusServer::start(
        *check_status_address(options.status, options.insecure_status), facts, options.exposure_ev);
    if (!status) { return tl::unexpected(status.error()); }
    spdlog::warn("event=status_page url={}", (*status)->url());
    watchers.add(*std::move(status));
  }
  if (!options.display.empty()) {
    const Result<Endpoint> viewer = parse_display(options.display);
    if (!viewer) { return tl::unexpected(viewer.error()); }
    const auto name = std::filesystem::path(options.output).filename().string();
    watchers.add(std::make_unique<TevDisplay>(*viewer, name, settings.width, settings.height));
  }
  return {};
}

Result<MasterResult> render_image(const RenderOptions& options, const Store& store,
                                  const RenderSettings& settings, const Prediction& prediction) {
  Watchers watchers;
  if (auto added = add_watchers(options, store, settings, watchers); !added) {
    return tl::unexpected(added.error());
  }
  MasterOptions master = master_options(options);
  master.watch = watchers.get();
  ProgressPrinter printer(stderr, ::isatty(STDERR_FILENO) == 1);
  const auto print = [&printer](const MasterProgress& progress) { printer.update(progress); };
  const std::atomic<int>& stop_signal = catch_stop_signals();
  Result<MasterResult> result =
      options.local ? render_local(store, settings,
                                   {threads_of(options), options.tile_size, options.count_accesses,
                                    options.paths_per_thread, watchers.get()},
                                   stop_signal, print)
                    : run_master(store, settings, prediction, master, stop_signal, print);
  printer.finish();
  return result;
}

Result<void> render(RenderOptions options) {
  if (auto fine = check_before(options); !fine) { return fine; }
  const auto opened = open_scene(options.scene);
  if (!opened) { return tl::unexpected(opened.error()); }
  const Store& store = opened->store;
  if (auto limit = options.cache.resolve(store.tables()); !limit && !options.local) {
    return tl::unexpected(limit.error());
  }
  const auto view = resolve_view(store.tables(), store.cameras(), options.view);
  if (!view) { return tl::unexpected(view.error()); }
  if (options.tile_size == 0) {
    const RenderSettings& image = view->settings;
    options.tile_size = tile_size_for(image.width, image.height, threads_expected(options));
  }
  const auto prediction = predict_for(options, store, view->settings);
  if (!prediction) { return tl::unexpected(prediction.error()); }
  const auto result = render_image(options, store, view->settings, *prediction);
  if (!result) { return tl::unexpected(result.error()); }

  RenderRecord record{&store, &*view, &*prediction, &*result};
  record.seconds = {opened->compile_seconds, prediction->seconds, result->preload_seconds,
                    result->render_seconds};
  record.pixels_sha256 = result->film.pixels_sha256();
  record.settings = settings_of(options);
  const auto written =
      write_image(options.output, result->film, options.exposure_ev, metadata_of(record));
  if (!written) { return written; }
  fmt::print(stderr, "{}", make_summary(record));
  const nlohmann::ordered_json report = make_report(record);
  auto reported = write_text_output(options.report, report.dump(2) + "\n");
  if (reported && !options.html.empty()) {
    reported =
        write_text_output(options.html, make_render_page(record, report, options.exposure_ev));
  }
  if (reported && !result->poisoned_tiles.empty()) {
    return fail(
        ExitCode::kPoisonedTile,
        fmt::format("{} of the tiles are black: workers died on each, two of them with no other "
                    "tile; the first is {}",
                    result->poisoned_tiles.size(), index_of(result->poisoned_tiles.front())));
  }
  return reported;
}

void add_worker_options(CLI::App& command, RenderOptions& options) {
  constexpr const char* kGroup = "Workers";
  auto* const workers =
      command
          .add_option("--workers", options.workers, "Worker processes to start here (default: 2)")
          ->type_name("N")
          ->check(in_range(1U, kWorkersMax))
          ->group(kGroup);
  auto* const listen = add_parsed_option(command, "--listen", options.listen, &parse_address,
                                         "Wait here for workers that connect")
                           ->type_name("tcp://HOST:PORT")
                           ->group(kGroup);
  command.add_option("--wait-workers", options.wait_workers, "Begin when so many are there")
      ->type_name("N")
      ->check(in_range(1U, kWorkersMax))
      ->capture_default_str()
      ->needs(listen)
      ->group(kGroup);
  command
      .add_option(
          "--endpoint-file", options.endpoint_file,
          "Write here where workers connect to, once they can: with port *, which one it is")
      ->type_name("FILE")
      ->needs(listen)
      ->group(kGroup);
  auto* const insecure =
      command
          .add_flag("--insecure-no-auth", options.security.insecure_no_auth,
                    "Allow --listen on an address that is not loopback without keys: nothing is "
                    "encrypted or authenticated")
          ->needs(listen)
          ->group(kGroup);
  add_keys_option(command, options.security)->excludes(insecure)->group(kGroup);
  command
      .add_flag("--no-peers", options.no_peers,
                "Every voxel comes from here: workers pass none on to each other")
      ->group(kGroup);
  command
      .add_option("--ledger", options.ledger,
                  "Write a JSON line for every lease, result, join and leave")
      ->type_name("FILE")
      ->group(kGroup);
  auto* const local = command
                          .add_flag("--local", options.local,
                                    "Render in this process, the whole scene in memory, whatever "
                                    "--cache says; a report still judges --preload's model")
                          ->group(kGroup);
  workers->excludes(listen)->excludes(local);
  listen->excludes(local);
  command
      .add_option("--threads", options.threads,
                  "Tracing threads of each worker (default: 1; with --local all cores)")
      ->type_name("N")
      ->check(in_range(1U, kThreadsMax))
      ->group(kGroup);
}

void add_watch_options(CLI::App& command, RenderOptions& options) {
  constexpr const char* kGroup = "Looking on";
  auto* const status =
      command
          .add_option("--status", options.status,
                      "Show the render as it goes on a web page at this address, with "
                      "/status.json, /metrics and /healthz; port 0 takes a free one")
          ->type_name("HOST:PORT")
          ->group(kGroup);
  command
      .add_flag("--insecure-status", options.insecure_status,
                "Allow --status on an address that is not loopback: whoever reaches it can look")
      ->needs(status)
      ->group(kGroup);
  command
      .add_option("--display", options.display,
                  "Send tiles to the tev image viewer there as they arrive (port 14158 if none)")
      ->type_name("HOST[:PORT]")
      ->group(kGroup);
}

void add_cache_options(CLI::App& command, RenderOptions& options) {
  constexpr const char* kGroup = "Cache";
  const auto set_cache = [&options](const std::string& text) {
    Result<CacheSize> cache = parse_cache_size(text);
    if (!cache) { throw CLI::ValidationError("--cache", cache.error().message); }
    options.cache = *cache;
    options.cache_text = text;
  };
  command
      .add_option_function<std::string>("--cache", set_cache,
                                        "Memory of each worker's voxels: bytes with KiB, MiB or "
                                        "GiB, or a share of the scene's resident size")
      ->default_str(options.cache_text)
      ->type_name("BYTES|PERCENT")
      ->group(kGroup);
  command
      .add_option("--preload", options.preload,
                  "Model that chooses the voxels which workers hold beforehand")
      ->type_name("MODEL")
      ->check(CLI::IsMember(prediction_models()))
      ->capture_default_str()
      ->group(kGroup);
  add_parsed_option(command, "--preload-share", options.preload_share, &parse_preload_share,
                    "Share of the cache to preload")
      ->default_str("auto")
      ->type_name("0..1|auto")
      ->group(kGroup);
  add_parsed_option(command, "--count-accesses", options.count_accesses, &parse_access_counting,
                    "Count the voxels that rays enter: exact, sampled (one ray in 64) or none")
      ->default_str("sampled")
      ->type_name("HOW")
      ->group(kGroup);
}

}  // namespace

void add_render_command(CLI::App& app, Command& chosen) {
  const auto options = std::make_shared<RenderOptions>();
  CLI::App* const command = app.add_subcommand("render", "Render an image");
  add_scene_options(*command, options->scene);
  command
      ->add_option("-o,--output", options->output, "The image: .png (8-bit sRGB) or .exr (float)")
      ->required()
      ->type_name("IMAGE");
  command->add_option("--report", options->report, "Write what it cost here as JSON; - for stdout")
      ->type_name("FILE");
  command->add_option("--html", options->html, "Write a page about it here; - for stdout")
      ->type_name("FILE");
  command->add_option("--exposure", options->exposure_ev, "Brightens a PNG by so many stops")
      ->check(in_range(-64.0, 64.0))
      ->type_name("EV")
      ->capture_default_str();
  command
      ->add_option(
          "--tile-size", options->tile_size,
          "Side of a tile in pixels (default: 32, or 16 or 8 where many threads would have "
          "few tiles each)")
      ->type_name("N")
      ->check(in_range(1U, kTileSizeMax));
  command
      ->add_option("--paths-in-flight", options->paths_per_thread,
                   "Paths that each tracing thread keeps going, of some 420 bytes each: the more, "
                   "the more rays a fetched voxel serves")
      ->type_name("N")
      ->check(in_range(kPathsPerThreadMin, kPathsPerThreadMax))
      ->capture_default_str();
  add_view_options(*command, options->view);
  add_worker_options(*command, *options);
  add_cache_options(*command, *options);
  add_watch_options(*command, *options);
  command->footer(
      "Examples:\n"
      "  preheat render demo -o demo.png\n"
      "  preheat render room.gltf -o room.exr --camera 0 --size 1920x1080 --spp 256 --workers 8\n"
      "  preheat render room.store -o room.png --listen tcp://127.0.0.1:5555 --wait-workers 4");
  command->callback([&chosen, options] { chosen = [options] { return render(*options); }; });
}

}  // namespace preheat
