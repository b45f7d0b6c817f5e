#include "master/render_history.h"

#include <algorithm>
#include <utility>

namespace preheat {

HistoryRecorder::Series& HistoryRecorder::of(WorkerId worker) {
  const std::size_t index = index_of(worker);
  if (index >= workers_.size()) { workers_.resize(index + 1); }
  return workers_[index];
}

double HistoryRecorder::since_begin(Time now) const {
  return begin_ ? std::max(0.0, seconds(now - *begin_)) : 0.0;
}

void HistoryRecorder::worker_ready(WorkerId worker, std::size_t threads, Time now) {
  Series& series = of(worker);
  if (!series.was_ready) { series.ready = now; }
  series.was_ready = true;
  series.threads = threads;
  series.gone.reset();
  series.lost = false;
}

void HistoryRecorder::worker_gone(WorkerId worker, bool lost, Time now) {
  Series& series = of(worker);
  series.gone = now;
  series.lost = lost;
}

void HistoryRecorder::begin(Time now) {
  if (!begin_) { begin_ = now; }
}

void HistoryRecorder::append(std::vector<HistoryPoint>& points, const HistoryPoint& point) const {
  const std::size_t count = points.size();
  if (count >= 2 && point.seconds - points[count - 2].seconds < spacing_seconds_) {
    points.back() = point;
  } else {
    points.push_back(point);
  }
}

void HistoryRecorder::counted(WorkerId worker, const WorkerStats& stats, Time now) {
  if (!begin_) { return; }
  std::vector<HistoryPoint>& points = of(worker).points;
  const CacheStats& cache = stats.cache;
  const std::size_t before = points.size();
  append(points, {since_begin(now), stats.rays.total(), cache.accesses, cache.misses,
                  cache.remote_fetches, cache.remote_bytes, cache.stall_seconds});
  points_ += points.size() - before;
  if (points_ > std::max(kPointsMax, 3 * workers_.size())) { thin_points(); }
}

void HistoryRecorder::thin_points() {
  spacing_seconds_ *= 2.0;
  points_ = 0;
  for (Series& series : workers_) {
    std::vector<HistoryPoint> kept;
    for (const HistoryPoint& point : series.points) { append(kept, point); }
    series.points = std::move(kept);
    points_ += series.points.size();
  }
}

void HistoryRecorder::tile_done(WorkerId worker, TileId tile, Time leased, Time now) {
  if (!begin_) { return; }
  std::vector<TileRun>& runs = of(worker).runs;
  const double end = since_begin(now);
  double begin = std::min(since_begin(leased), end);
  if (!runs.empty()) {
    TileRun& last = runs.back();
    begin = std::max(begin, last.end_seconds);
    if (last.tiles < tiles_per_run_) {
      last.end_seconds = end;
      ++last.tiles;
      return;
    }
  }
  runs.push_back({begin, end, index_of(tile), 1});
  ++runs_;
  if (runs_ > std::max(kRunsMax, workers_.size())) { merge_runs(); }
}

void HistoryRecorder::merge_runs() {
  tiles_per_run_ *= 2;
  runs_ = 0;
  for (Series& series : workers_) {
    std::vector<TileRun> merged;
    for (const TileRun& run : series.runs) {
      if (!merged.empty() && merged.back().tiles + run.tiles <= tiles_per_run_) {
        merged.back().end_seconds = run.end_seconds;
        merged.back().tiles += run.tiles;
      } else {
        merged.push_back(run);
      }
    }
    series.runs = std::move(merged);
    runs_ += series.runs.size();
  }
}

std::vector<double> interval_ends(const RenderHistory& history, std::size_t intervals_max) {
  std::size_t told = 0;
  for (const WorkerHistory& worker : history.workers) {
    told = std::max(told, worker.points.size());
  }
  const std::size_t count = std::clamp<std::size_t>(told, 1, intervals_max);
  std::vector<double> ends;
  for (std::size_t i = 1; i <= count; ++i) {
    ends.push_back(history.seconds * static_cast<double>(i) / static_cast<double>(count));
  }
  return ends;
}

RenderHistory HistoryRecorder::take(Time end) {
  RenderHistory history;
  if (!begin_) { return history; }
  history.seconds = since_begin(end);
  for (Series& series : workers_) {
    WorkerHistory& worker = history.workers.emplace_back();
    worker.threads = series.threads;
    worker.lost = series.lost;
    if (series.was_ready) {
      worker.begin_seconds = std::min(since_begin(series.ready), history.seconds);
      worker.end_seconds = std::min(since_begin(series.gone.value_or(end)), history.seconds);
    }
    worker.points = std::move(series.points);
    worker.runs = std::move(series.runs);
  }
  return history;
}

}  // namespace preheat
