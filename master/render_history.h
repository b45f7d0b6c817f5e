// What workers did when: their counts over time and the tiles they delivered, for charts.
//
// Bounded however long a render lasts and however many tiles it has: where there is no more room,
// neighbouring points and runs of tiles are merged, everybody's alike.
//
// Pure: time is an argument. Before the first tile is leased there is no time axis; what is told
// before is kept only as the state that a worker begins with.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "common/clock.h"
#include "common/ids.h"
#include "common/stats.h"

namespace preheat {

// A worker's counts so far, as it told them. Seconds are since the first tile was leased.
struct HistoryPoint {
  double seconds = 0.0;
  std::uint64_t rays = 0;
  std::uint64_t accesses = 0;
  std::uint64_t misses = 0;
  std::uint64_t remote_fetches = 0;
  std::uint64_t remote_bytes = 0;
  double stall_seconds = 0.0;
};

// Tiles that a worker delivered one after the other. It begins when the first was leased, but not
// before the worker's previous result: workers hold several leases at a time.
struct TileRun {
  double begin_seconds = 0.0;
  double end_seconds = 0.0;
  std::uint32_t tile_first = 0;
  std::uint32_t tiles = 1;
};

struct WorkerHistory {
  std::size_t threads = 1;
  double begin_seconds = 0.0;          // ready for tiles
  double end_seconds = 0.0;            // gone
  bool lost = false;                   // without a farewell
  std::vector<HistoryPoint> points{};  // ascending
  std::vector<TileRun> runs{};         // ascending, apart
};

struct RenderHistory {
  double seconds = 0.0;                  // from the first lease to the end
  std::vector<WorkerHistory> workers{};  // by WorkerId; without points if it never was ready
};

// A worker's count at a moment, between those it told of.
template <class Number>
[[nodiscard]] double count_at(const WorkerHistory& worker, Number HistoryPoint::*count,
                              double seconds) {
  const std::vector<HistoryPoint>& points = worker.points;
  const auto next = std::upper_bound(
      points.begin(), points.end(), seconds,
      [](double value, const HistoryPoint& point) { return value < point.seconds; });
  if (next == points.end()) {
    return points.empty() ? 0.0 : static_cast<double>(points.back().*count);
  }
  const double from_seconds = next == points.begin() ? worker.begin_seconds : (next - 1)->seconds;
  const double from = next == points.begin() ? 0.0 : static_cast<double>((*(next - 1)).*count);
  const double length = next->seconds - from_seconds;
  const double share = length > 0.0 ? std::clamp((seconds - from_seconds) / length, 0.0, 1.0) : 1.0;
  return from + share * (static_cast<double>((*next).*count) - from);
}

// The ends of intervals of equal length from the first lease on: as many as the worker that told
// most often has points, at most `intervals_max` and at least one.
[[nodiscard]] std::vector<double> interval_ends(const RenderHistory& history,
                                                std::size_t intervals_max);

class HistoryRecorder {
 public:
  // A worker has at least three points and one run, whatever the bounds.
  static constexpr std::size_t kPointsMax = 32768;
  static constexpr std::size_t kRunsMax = 8192;

  void worker_ready(WorkerId worker, std::size_t threads, Time now);
  void worker_gone(WorkerId worker, bool lost, Time now);
  // The first tile is leased.
  void begin(Time now);
  void counted(WorkerId worker, const WorkerStats& stats, Time now);
  void tile_done(WorkerId worker, TileId tile, Time leased, Time now);

  // Empty if nothing was leased.
  [[nodiscard]] RenderHistory take(Time end);

 private:
  struct Series {
    std::size_t threads = 1;
    Time ready{};
    std::optional<Time> gone{};
    bool was_ready = false;
    bool lost = false;
    std::vector<HistoryPoint> points{};
    std::vector<TileRun> runs{};
  };
  Series& of(WorkerId worker);
  [[nodiscard]] double since_begin(Time now) const;
  // The newest point always stands; those before are at least spacing_seconds_ apart.
  void append(std::vector<HistoryPoint>& points, const HistoryPoint& point) const;
  void thin_points();
  void merge_runs();

  std::optional<Time> begin_;
  std::vector<Series> workers_;
  std::size_t points_ = 0;
  std::size_t runs_ = 0;
  double spacing_seconds_ = 0.05;
  std::uint32_t tiles_per_run_ = 1;
};

}  // namespace preheat
