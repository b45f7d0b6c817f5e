// What workers did, row by row, as inline SVG in the manner of svg_chart.h: who delivered which
// tiles when, and how the threads spent their time. Details are told by tooltips.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>

#include "master/render_history.h"

namespace preheat {

// Of more workers the first ones are drawn.
inline constexpr std::size_t kChartRowsMax = 64;

// Bars for runs of tiles, light and dark in turn, over a band for the time that a worker was there.
[[nodiscard]] std::string tile_timeline_svg(const RenderHistory& history);

// Seconds of a worker's threads, in all and without a ray that could run.
struct ThreadSeconds {
  double total = 0.0;
  double waiting = 0.0;
  [[nodiscard]] double share_waiting() const { return total > 0.0 ? waiting / total : 0.0; }
};
[[nodiscard]] ThreadSeconds thread_seconds(const WorkerHistory& worker);

[[nodiscard]] std::string waiting_svg(const RenderHistory& history);

// Rules for the classes of these charts.
extern const std::string_view kWorkerChartStyle;

}  // namespace preheat
