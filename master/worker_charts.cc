#include "master/worker_charts.h"

#include <fmt/format.h>

#include <algorithm>

#include "master/svg_chart.h"

namespace preheat {
namespace {

constexpr double kWidth = 960.0;
constexpr double kLeft = 90.0;
constexpr double kRight = 20.0;
constexpr double kRow = 22.0;
constexpr double kBar = 16.0;
constexpr double kFoot = 44.0;

// Rows of bars over an axis from 0 to `most`.
class RowChart {
 public:
  RowChart(std::size_t rows, double most) : rows_(rows), most_(most > 0.0 ? most : 1.0) {}

  [[nodiscard]] double x(double value) const {
    return kLeft + (kWidth - kLeft - kRight) * std::clamp(value / most_, 0.0, 1.0);
  }
  [[nodiscard]] static double y(std::size_t row) { return kRow * static_cast<double>(row) + 4.0; }

  // Bars too short to see are drawn half a unit long.
  void bar(std::size_t row, double from, double to, const char* look, const std::string& tooltip) {
    bars_ += fmt::format(
        "<rect class=\"{}\" x=\"{:.1f}\" y=\"{:.0f}\" width=\"{:.1f}\" height=\"{:.0f}\">"
        "<title>{}</title></rect>\n",
        look, x(from), y(row), std::max(0.5, x(to) - x(from)), kBar, escape_markup(tooltip));
  }
  void name(std::size_t row, const std::string& text) {
    bars_ += fmt::format(
        "<text class=\"tick\" x=\"{:.0f}\" y=\"{:.0f}\" text-anchor=\"end\">{}</text>\n",
        kLeft - 8.0, y(row) + 12.0, escape_markup(text));
  }

  [[nodiscard]] std::string svg(const char* title, const char* description,
                                const char* axis) const {
    const double bottom = kRow * static_cast<double>(rows_) + 6.0;
    std::string svg = fmt::format(
        "<svg class=\"chart rows\" role=\"img\" aria-label=\"{}\" viewBox=\"0 0 {:.0f} {:.0f}\" "
        "width=\"{:.0f}\">\n<desc>{}</desc>\n",
        title, kWidth, bottom + kFoot, kWidth, description);
    for (const double tick : axis_ticks(0.0, most_, false)) {
      svg += fmt::format(
          "<path class=\"grid\" d=\"M{0:.1f} 0V{1:.1f}\"/>"
          "<text class=\"tick\" x=\"{0:.1f}\" y=\"{2:.1f}\" text-anchor=\"middle\">{3}</text>\n",
          x(tick), bottom, bottom + 16.0, tick_text(tick));
    }
    svg += bars_;
    return svg + fmt::format(
                     "<text class=\"name\" x=\"{:.0f}\" y=\"{:.0f}\" "
                     "text-anchor=\"middle\">{}</text>\n</svg>\n",
                     0.5 * (kLeft + kWidth - kRight), bottom + 36.0, axis);
  }

 private:
  std::size_t rows_;
  double most_;
  std::string bars_;
};

std::string run_text(const TileRun& run) {
  const std::string tiles =
      run.tiles == 1 ? fmt::format("tile {}", run.tile_first)
                     : fmt::format("{} tiles, the first is {}", run.tiles, run.tile_first);
  return fmt::format("{}: {:.2f} to {:.2f} s", tiles, run.begin_seconds, run.end_seconds);
}

}  // namespace

const std::string_view kWorkerChartStyle = R"css(
svg.rows .there { fill: var(--grid); }
svg.rows .run0 { fill: var(--look0); }
svg.rows .run1 { fill: var(--look0); fill-opacity: 0.6; }
svg.rows .busy { fill: var(--look0); }
svg.rows .waiting { fill: var(--look1); stroke: var(--ink); stroke-width: 1; stroke-dasharray: 2 2; }
)css";

std::string tile_timeline_svg(const RenderHistory& history) {
  const std::size_t rows = std::min(history.workers.size(), kChartRowsMax);
  RowChart chart(rows, history.seconds);
  for (std::size_t row = 0; row < rows; ++row) {
    const WorkerHistory& worker = history.workers[row];
    chart.name(row, fmt::format("worker {}", row));
    chart.bar(row, worker.begin_seconds, worker.end_seconds, "there",
              fmt::format("worker {}: here from {:.2f} to {:.2f} s{}", row, worker.begin_seconds,
                          worker.end_seconds, worker.lost ? ", then lost" : ""));
    for (std::size_t i = 0; i < worker.runs.size(); ++i) {
      const TileRun& run = worker.runs[i];
      chart.bar(row, run.begin_seconds, run.end_seconds, i % 2 == 0 ? "run0" : "run1",
                run_text(run));
    }
  }
  return chart.svg("Tiles of each worker over time",
                   "A row for each worker and a bar for each result. The table of workers has the "
                   "numbers of tiles.",
                   "seconds since the first tile was handed out");
}

ThreadSeconds thread_seconds(const WorkerHistory& worker) {
  ThreadSeconds time;
  time.total = static_cast<double>(worker.threads) *
               std::max(0.0, worker.end_seconds - worker.begin_seconds);
  if (!worker.points.empty()) {
    time.waiting = std::min(worker.points.back().stall_seconds, time.total);
  }
  return time;
}

std::string waiting_svg(const RenderHistory& history) {
  const std::size_t rows = std::min(history.workers.size(), kChartRowsMax);
  double most = 0.0;
  for (std::size_t row = 0; row < rows; ++row) {
    most = std::max(most, thread_seconds(history.workers[row]).total);
  }
  RowChart chart(rows, most);
  for (std::size_t row = 0; row < rows; ++row) {
    const ThreadSeconds time = thread_seconds(history.workers[row]);
    const double busy = time.total - time.waiting;
    chart.name(row, fmt::format("worker {}", row));
    chart.bar(row, 0.0, busy, "busy", fmt::format("worker {}: {:.2f} s not waiting", row, busy));
    if (time.waiting > 0.0) {
      chart.bar(row, busy, time.total, "waiting",
                fmt::format("worker {}: {:.2f} s waiting for voxels", row, time.waiting));
    }
  }
  return chart.svg("Seconds that each worker's threads traced and waited",
                   "A row for each worker: the solid part is tracing, the dashed part waiting. The "
                   "table of workers has the numbers.",
                   "seconds of all its threads");
}

}  // namespace preheat
