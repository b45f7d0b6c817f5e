// Charts as inline SVG: axes with ticks, lines, dots and marks, and nothing that needs a script or
// the network.
//
// Colours and strokes are the page's: the elements carry classes only, see kChartStyle. Series are
// told apart by more than colour: lines are dashed differently, marks have different shapes.
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace preheat {

struct ChartPoint {
  double x = 0.0;
  double y = 0.0;
  friend bool operator==(const ChartPoint&, const ChartPoint&) = default;
};

struct ChartSeries {
  enum class Style { kLine, kDots, kMarks };
  std::string name{};
  unsigned look = 0;  // colour, dash and shape; kChartLooks different ones
  Style style = Style::kLine;
  std::vector<ChartPoint> points{};
};
inline constexpr unsigned kChartLooks = 10;

struct ChartLabel {
  ChartPoint at{};
  std::string text{};
};

// From `low` to `high`, or as far as the data reach where low >= high. On a logarithmic axis what
// is not positive lies on the lower edge.
struct ChartAxis {
  std::string label{};
  bool logarithmic = false;
  double low = 0.0;
  double high = 0.0;
};

struct Chart {
  std::string title{};        // read out in place of the picture
  std::string description{};  // likewise, after the title: what it shows
  ChartAxis x{};
  ChartAxis y{};
  std::vector<ChartSeries> series{};
  std::vector<ChartLabel> labels{};
  bool has_diagonal = false;  // a line where y = x
  int width = 480;
  int height = 360;
};

// Points that are not finite are left out. Coordinates are rounded to a tenth of a unit, and what
// falls together is drawn once, so that the size is bounded by the chart's and not by the data's.
[[nodiscard]] std::string make_svg(const Chart& chart);

// The rules of a style sheet that the elements' classes refer to, for light and dark pages.
extern const std::string_view kChartStyle;

// Where an axis from low to high has its labelled ticks, at most ten: multiples of 1, 2 or 5 times
// a power of ten; on a logarithmic axis of more than a decade powers of ten. Requires: low < high,
// on a logarithmic axis both positive.
[[nodiscard]] std::vector<double> axis_ticks(double low, double high, bool logarithmic);

// "0.25", "1.5k", "3M", "2e-5": short, to three digits.
[[nodiscard]] std::string tick_text(double value);

// For text and attribute values of HTML and SVG.
[[nodiscard]] std::string escape_markup(std::string_view text);

}  // namespace preheat
