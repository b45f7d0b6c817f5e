#include "master/local_render.h"

#include <chrono>
#include <memory>
#include <utility>
#include <variant>
#include <vector>

#include "cache/doorbell.h"
#include "cache/local_residency.h"
#include "cache/renderer.h"
#include "cache/tracer.h"
#include "common/clock.h"
#include "master/signals.h"

namespace preheat {
namespace {

double seconds_since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

class LocalRender {
 public:
  LocalRender(const Store& store, const RenderSettings& settings, const LocalOptions& options,
              const std::function<void(const MasterProgress&)>& progress)
      : store_(store),
        grid_{settings.width, settings.height, options.tile_size},
        count_accesses_(options.count_accesses),
        threads_(options.threads),
        watch_(options.watch),
        progress_(progress),
        film_(settings.width, settings.height),
        renderer_(store.tables(), settings,
                  RendererOptions{.threads = options.threads,
                                  .cache_limit_bytes = store.tables().resident_bytes(),
                                  .tile_size = options.tile_size,
                                  .count_accesses = options.count_accesses,
                                  .paths_per_thread = options.paths_per_thread},
                  [this] { doorbell_.ring(); }) {}

  Result<MasterResult> run(const std::atomic<int>& stop_signal) {
    const Clock::time_point began = Clock::now();
    started_ = began;
    if (auto preloaded = make_everything_hot(store_, renderer_); !preloaded) {
      return tl::unexpected(preloaded.error());
    }
    for (std::uint32_t tile = 0; tile < grid_.count(); ++tile) { renderer_.add_tile(TileId{tile}); }
    while (tiles_done_ < grid_.count()) {
      if (const int signal = stop_signal.load(); signal != 0) {
        return fail(exit_code_of_signal(signal), "stopped by a signal; no image was written");
      }
      doorbell_.wait_for(std::chrono::milliseconds(100));
      for (RendererEvent& event : renderer_.take_events()) {
        if (auto handled = handle(event); !handled) { return tl::unexpected(handled.error()); }
      }
      report_progress();
    }
    MasterResult result{.film = std::move(film_), .workers = {renderer_.stats()}};
    const Time end = Clock::now();
    history_.counted(kSelf, result.workers.front(), end);
    result.history = history_.take(end);
    result.preload_seconds = preload_seconds_ > 0.0 ? preload_seconds_ : 0.0;
    result.render_seconds = seconds_since(began) - result.preload_seconds;
    result.accesses_by_voxel = accesses_by_voxel();
    return result;
  }

 private:
  static constexpr WorkerId kSelf{0};

  [[nodiscard]] std::vector<double> accesses_by_voxel() const {
    std::vector<double> accesses;
    if (count_accesses_ == AccessCounting::kNone) { return accesses; }
    const double scale = Tracer::accesses_per_count(count_accesses_);
    for (const CellAccesses& voxel : renderer_.accesses_by_cell()) {
      accesses.push_back(scale * static_cast<double>(voxel.total()));
    }
    return accesses;
  }

  Result<void> handle(RendererEvent& event) {
    if (auto* const done = std::get_if<TileDone>(&event)) {
      film_.assign(grid_.rect(done->tile), done->pixels);
      history_.tile_done(kSelf, done->tile, started_, Clock::now());
      if (watch_ != nullptr) { watch_->tile_done(grid_.rect(done->tile), done->pixels); }
      ++tiles_done_;
    } else if (const auto* const needed = std::get_if<VoxelNeeded>(&event)) {
      return deliver_from(store_, needed->voxel, renderer_);
    } else if (const auto* const failed = std::get_if<RendererFailed>(&event)) {
      return tl::unexpected(failed->error);
    } else if (std::holds_alternative<HotSetReady>(event)) {
      preload_seconds_ = seconds_since(started_);
      started_ = Clock::now();
      history_.worker_ready(kSelf, threads_, started_);
      history_.begin(started_);
    }
    return {};
  }

  void report_progress() {
    if (seconds_since(reported_) < 0.1) { return; }
    reported_ = Clock::now();
    const WorkerStats stats = renderer_.stats();
    if (watch_ != nullptr) { watch_->look(snapshot(stats)); }
    if (preload_seconds_ < 0.0) { return; }
    history_.counted(kSelf, stats, reported_);
    MasterProgress progress{tiles_done_, grid_.count(), 1, stats.rays.total()};
    progress.seconds = seconds_since(started_);
    progress_(progress);
  }

  [[nodiscard]] RenderSnapshot snapshot(const WorkerStats& stats) const {
    const bool ready = preload_seconds_ >= 0.0;
    RenderSnapshot snapshot;
    snapshot.phase = ready ? JobPhase::kRendering : JobPhase::kWaiting;
    snapshot.tiles_done = tiles_done_;
    snapshot.tiles_total = grid_.count();
    snapshot.waiting_seconds = ready ? preload_seconds_ : seconds_since(started_);
    snapshot.rendering_seconds = ready ? seconds_since(started_) : 0.0;
    snapshot.workers.push_back({ready ? WorkerState::kReady : WorkerState::kPreparing, threads_,
                                renderer_.tiles_pending(), stats});
    return snapshot;
  }

  const Store& store_;
  TileGrid grid_;
  AccessCounting count_accesses_;
  unsigned threads_;
  RenderWatch* watch_;
  const std::function<void(const MasterProgress&)>& progress_;
  Film film_;
  HistoryRecorder history_;
  std::uint32_t tiles_done_ = 0;
  double preload_seconds_ = -1.0;  // negative until the hot set is ready
  Clock::time_point started_{};    // of the phase under way
  Clock::time_point reported_{};
  Doorbell doorbell_;
  Renderer renderer_;  // last: its threads stop before what they ring
};

}  // namespace

Result<MasterResult> render_local(const Store& store, const RenderSettings& settings,
                                  const LocalOptions& options, const std::atomic<int>& stop_signal,
                                  const std::function<void(const MasterProgress&)>& progress) {
  return LocalRender(store, settings, options, progress).run(stop_signal);
}

}  // namespace preheat
