#include "master/svg_chart.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <set>
#include <utility>

namespace preheat {
namespace {

constexpr double kLeft = 66.0;
constexpr double kRight = 14.0;
constexpr double kTop = 12.0;
constexpr double kBottom = 48.0;
constexpr double kLegendRow = 18.0;
constexpr double kLegendColumn = 165.0;
constexpr double kMarkRadius = 4.5;

// A value's place along an axis, in the chart's units.
class Scale {
 public:
  Scale(const ChartAxis& axis, const std::vector<double>& data, double from, double to)
      : logarithmic_(axis.logarithmic), from_(from), to_(to), low_(axis.low), high_(axis.high) {
    if (!(low_ < high_)) { fit(data); }
  }

  [[nodiscard]] double place(double value) const {
    const double clamped = std::clamp(value, low_, high_);
    return from_ + (to_ - from_) * (stretched(clamped) - stretched(low_)) /
                       (stretched(high_) - stretched(low_));
  }
  [[nodiscard]] double low() const { return low_; }
  [[nodiscard]] double high() const { return high_; }
  [[nodiscard]] std::vector<double> ticks() const { return axis_ticks(low_, high_, logarithmic_); }

 private:
  [[nodiscard]] double stretched(double value) const {
    return logarithmic_ ? std::log10(value) : value;
  }

  void fit(const std::vector<double>& data) {
    double least = std::numeric_limits<double>::infinity();
    double most = -least;
    for (const double value : data) {
      if (!std::isfinite(value) || (logarithmic_ && !(value > 0.0))) { continue; }
      least = std::min(least, value);
      most = std::max(most, value);
    }
    if (!(least <= most)) { least = most = 1.0; }
    if (logarithmic_) {
      low_ = std::pow(10.0, std::floor(std::log10(least)));
      high_ = std::pow(10.0, std::ceil(std::log10(most)));
      if (!(low_ < high_)) { high_ = low_ * 10.0; }
    } else {
      low_ = std::min(0.0, least);
      high_ = most > low_ ? most : low_ + 1.0;
    }
  }

  bool logarithmic_;
  double from_;
  double to_;
  double low_;
  double high_;
};

std::vector<double> coordinates(const Chart& chart, double ChartPoint::*coordinate) {
  std::vector<double> values;
  for (const ChartSeries& series : chart.series) {
    for (const ChartPoint& point : series.points) { values.push_back(point.*coordinate); }
  }
  return values;
}

// Tenths of a chart unit.
using Place = std::pair<long, long>;

std::vector<Place> places_of(const ChartSeries& series, const Scale& x, const Scale& y) {
  std::vector<Place> places;
  for (const ChartPoint& point : series.points) {
    if (!std::isfinite(point.x) || !std::isfinite(point.y)) { continue; }
    places.emplace_back(std::lround(10.0 * x.place(point.x)), std::lround(10.0 * y.place(point.y)));
  }
  return places;
}

std::string number(long tenths) {
  return tenths % 10 == 0 ? fmt::format("{}", tenths / 10)
                          : fmt::format("{:.1f}", static_cast<double>(tenths) / 10.0);
}

// A point that continues the direction of the last two adds nothing to see; only repeated places
// are dropped, which bounds a curve of many points that hardly moves.
std::string line_path(const std::vector<Place>& places) {
  std::string path;
  for (std::size_t i = 0; i < places.size(); ++i) {
    if (i > 0 && places[i] == places[i - 1]) { continue; }
    path += fmt::format("{}{} {}", i == 0 ? "M" : "L", number(places[i].first),
                        number(places[i].second));
  }
  return path;
}

std::string dots_path(const std::vector<Place>& places) {
  std::string path;
  for (const auto& [x, y] : std::set<Place>(places.begin(), places.end())) {
    path += fmt::format("M{} {}h0", number(x), number(y));
  }
  return path;
}

// Shapes by look: polygons of different corner counts and turns.
std::string mark_path(double x, double y, unsigned look) {
  constexpr std::array<int, 5> kCorners{12, 4, 3, 4, 3};
  constexpr std::array<double, 5> kTurns{0.0, 0.125, 0.75, 0.0, 0.25};
  const std::size_t shape = look % kCorners.size();
  std::string path;
  for (int corner = 0; corner < kCorners[shape]; ++corner) {
    const double turn = kTurns[shape] + static_cast<double>(corner) / kCorners[shape];
    const double angle = 2.0 * 3.14159265358979 * turn;
    path += fmt::format("{}{:.1f} {:.1f}", corner == 0 ? "M" : "L",
                        x + kMarkRadius * std::cos(angle), y + kMarkRadius * std::sin(angle));
  }
  return path + "Z";
}

std::string series_svg(const ChartSeries& series, const std::vector<Place>& places) {
  const unsigned look = series.look % kChartLooks;
  switch (series.style) {
    case ChartSeries::Style::kLine:
      return fmt::format("<path class=\"line look{}\" d=\"{}\"/>\n", look, line_path(places));
    case ChartSeries::Style::kDots:
      return fmt::format("<path class=\"dots look{}\" d=\"{}\"/>\n", look, dots_path(places));
    case ChartSeries::Style::kMarks:
      break;
  }
  std::string path;
  for (const auto& [x, y] : std::set<Place>(places.begin(), places.end())) {
    path += mark_path(static_cast<double>(x) / 10.0, static_cast<double>(y) / 10.0, look);
  }
  return fmt::format("<path class=\"marks look{}\" d=\"{}\"/>\n", look, path);
}

struct Layout {
  double width;
  double height;
  [[nodiscard]] double right() const { return width - kRight; }
  [[nodiscard]] double bottom() const { return height - kBottom; }
};

std::string axes_svg(const Chart& chart, const Layout& layout, const Scale& x, const Scale& y) {
  std::string svg;
  for (const double tick : x.ticks()) {
    const double at = x.place(tick);
    svg += fmt::format(
        "<path class=\"grid\" d=\"M{0:.1f} {1:.1f}V{2:.1f}\"/>"
        "<text class=\"tick\" x=\"{0:.1f}\" y=\"{3:.1f}\" text-anchor=\"middle\">{4}</text>\n",
        at, kTop, layout.bottom(), layout.bottom() + 16.0, tick_text(tick));
  }
  for (const double tick : y.ticks()) {
    const double at = y.place(tick);
    svg += fmt::format(
        "<path class=\"grid\" d=\"M{0:.1f} {1:.1f}H{2:.1f}\"/>"
        "<text class=\"tick\" x=\"{3:.1f}\" y=\"{4:.1f}\" text-anchor=\"end\">{5}</text>\n",
        kLeft, at, layout.right(), kLeft - 6.0, at + 4.0, tick_text(tick));
  }
  svg += fmt::format("<path class=\"axis\" d=\"M{0:.1f} {1:.1f}V{2:.1f}H{3:.1f}\"/>\n", kLeft, kTop,
                     layout.bottom(), layout.right());
  const double middle = 0.5 * (kTop + layout.bottom());
  svg += fmt::format(
      "<text class=\"name\" x=\"{:.1f}\" y=\"{:.1f}\" text-anchor=\"middle\">{}</text>\n",
      0.5 * (kLeft + layout.right()), layout.bottom() + 36.0, escape_markup(chart.x.label));
  svg += fmt::format(
      "<text class=\"name\" transform=\"translate(14 {:.1f}) rotate(-90)\" "
      "text-anchor=\"middle\">{}</text>\n",
      middle, escape_markup(chart.y.label));
  return svg;
}

std::string diagonal_svg(const Scale& x, const Scale& y) {
  const double from = std::max(x.low(), y.low());
  const double to = std::min(x.high(), y.high());
  if (!(from < to)) { return {}; }
  return fmt::format("<path class=\"diagonal\" d=\"M{:.1f} {:.1f}L{:.1f} {:.1f}\"/>\n",
                     x.place(from), y.place(from), x.place(to), y.place(to));
}

std::size_t legend_columns(const Chart& chart) {
  return std::max<std::size_t>(1, static_cast<std::size_t>((chart.width - kLeft) / kLegendColumn));
}

// One series needs no legend: the title names it.
double legend_height(const Chart& chart) {
  if (chart.series.size() < 2) { return 0.0; }
  const std::size_t columns = legend_columns(chart);
  return kLegendRow * static_cast<double>((chart.series.size() + columns - 1) / columns) + 6.0;
}

std::string legend_svg(const Chart& chart, double top) {
  std::string svg;
  if (chart.series.size() < 2) { return svg; }
  const std::size_t columns = legend_columns(chart);
  for (std::size_t i = 0; i < chart.series.size(); ++i) {
    const ChartSeries& series = chart.series[i];
    const double x = kLeft + kLegendColumn * static_cast<double>(i % columns);
    const double y = top + kLegendRow * (static_cast<double>(i / columns) + 0.5);
    const auto tenths = [](double value) { return std::lround(10.0 * value); };
    std::vector<Place> sample{{tenths(x), tenths(y)}, {tenths(x + 22.0), tenths(y)}};
    if (series.style != ChartSeries::Style::kLine) { sample = {{tenths(x + 11.0), tenths(y)}}; }
    svg += series_svg(series, sample);
    svg += fmt::format("<text class=\"tick\" x=\"{:.1f}\" y=\"{:.1f}\">{}</text>\n", x + 28.0,
                       y + 4.0, escape_markup(series.name));
  }
  return svg;
}

}  // namespace

const std::string_view kChartStyle = R"css(
svg.chart { max-width: 100%; height: auto; font: 12px system-ui, sans-serif; }
svg.chart path { fill: none; }
svg.chart .grid { stroke: var(--grid); stroke-width: 1; }
svg.chart .axis { stroke: var(--ink); stroke-width: 1; }
svg.chart .diagonal { stroke: var(--ink); stroke-width: 1; stroke-dasharray: 2 4; }
svg.chart text { fill: var(--ink); }
svg.chart .label { font-size: 11px; }
svg.chart .line { stroke-width: 1.8; stroke-linejoin: round; }
svg.chart .dots { stroke-width: 3.5; stroke-linecap: round; stroke-opacity: 0.65; }
svg.chart .marks { stroke-width: 1.5; }
:root { --look0: #0b62a8; --look1: #b8470b; --look2: #0a7a55; --look3: #a1307c; --look4: #6b5a00;
  --look5: #5b4bc4; --look6: #a81c1c; --look7: #3a6f7c; --look8: #7a5c3e; --look9: #555b66; }
@media (prefers-color-scheme: dark) {
  :root { --look0: #6cb8f2; --look1: #f2a35e; --look2: #4fd0a0; --look3: #ef8fca; --look4: #e0cd4a;
    --look5: #b0a5ff; --look6: #ff8a80; --look7: #8fcad8; --look8: #d3b08a; --look9: #b3bac6; }
}
svg.chart .look0 { stroke: var(--look0); }
svg.chart .look1 { stroke: var(--look1); }
svg.chart .look2 { stroke: var(--look2); }
svg.chart .look3 { stroke: var(--look3); }
svg.chart .look4 { stroke: var(--look4); }
svg.chart .look5 { stroke: var(--look5); }
svg.chart .look6 { stroke: var(--look6); }
svg.chart .look7 { stroke: var(--look7); }
svg.chart .look8 { stroke: var(--look8); }
svg.chart .look9 { stroke: var(--look9); }
svg.chart .line.look1 { stroke-dasharray: 7 3; }
svg.chart .line.look2 { stroke-dasharray: 2 3; }
svg.chart .line.look3 { stroke-dasharray: 9 3 2 3; }
svg.chart .line.look4 { stroke-dasharray: 4 2; }
svg.chart .line.look5 { stroke-dasharray: 12 3; }
svg.chart .line.look6 { stroke-dasharray: 1 2; }
svg.chart .line.look7 { stroke-dasharray: 6 2 1 2 1 2; }
svg.chart .line.look8 { stroke-dasharray: 3 6; }
svg.chart .line.look9 { stroke-dasharray: 14 4 4 4; }
)css";

std::vector<double> axis_ticks(double low, double high, bool logarithmic) {
  constexpr double kSlack = 1e-9;
  std::vector<double> ticks;
  if (logarithmic) {
    const int first = static_cast<int>(std::ceil(std::log10(low) - kSlack));
    const int last = static_cast<int>(std::floor(std::log10(high) + kSlack));
    const int step = 1 + (last - first) / 9;
    for (int exponent = first; exponent <= last; exponent += step) {
      ticks.push_back(std::pow(10.0, exponent));
    }
    if (ticks.size() > 1) { return ticks; }
    ticks.clear();
  }
  // The first round step of which no more than about seven fit.
  const double rough = (high - low) / 5.0;
  const double power = std::pow(10.0, std::floor(std::log10(rough)));
  const double ratio = rough / power;
  const double step = power * (ratio < 1.5 ? 1.0 : ratio < 3.5 ? 2.0 : ratio < 7.5 ? 5.0 : 10.0);
  for (double i = std::ceil(low / step - kSlack); i * step <= high + kSlack * step; i += 1.0) {
    ticks.push_back(i * step + 0.0);  // never -0
  }
  return ticks;
}

std::string tick_text(double value) {
  const double size = std::abs(value);
  constexpr std::array<std::pair<double, const char*>, 4> kUnits{
      std::pair{1e12, "T"}, {1e9, "G"}, {1e6, "M"}, {1e3, "k"}};
  if (size < 1e15) {
    for (const auto& [unit, suffix] : kUnits) {
      if (size >= unit) { return fmt::format("{:.3g}{}", value / unit, suffix); }
    }
  }
  return fmt::format("{:.3g}", value);
}

std::string escape_markup(std::string_view text) {
  std::string escaped;
  for (const char c : text) {
    switch (c) {
      case '&':
        escaped += "&amp;";
        break;
      case '<':
        escaped += "&lt;";
        break;
      case '>':
        escaped += "&gt;";
        break;
      case '"':
        escaped += "&quot;";
        break;
      default:
        escaped += c;
    }
  }
  return escaped;
}

std::string make_svg(const Chart& chart) {
  const Layout layout{static_cast<double>(chart.width), static_cast<double>(chart.height)};
  const Scale x(chart.x, coordinates(chart, &ChartPoint::x), kLeft, layout.right());
  const Scale y(chart.y, coordinates(chart, &ChartPoint::y), layout.bottom(), kTop);
  std::string svg = fmt::format(
      "<svg class=\"chart\" role=\"img\" aria-label=\"{}\" viewBox=\"0 0 {} {:.0f}\" "
      "width=\"{}\">\n<desc>{}</desc>\n",
      escape_markup(chart.title), chart.width, layout.height + legend_height(chart), chart.width,
      escape_markup(chart.description));
  svg += axes_svg(chart, layout, x, y);
  if (chart.has_diagonal) { svg += diagonal_svg(x, y); }
  for (const ChartSeries& series : chart.series) {
    svg += series_svg(series, places_of(series, x, y));
  }
  for (const ChartLabel& label : chart.labels) {
    svg += fmt::format("<text class=\"label\" x=\"{:.1f}\" y=\"{:.1f}\">{}</text>\n",
                       x.place(label.at.x) + 7.0, y.place(label.at.y) - 6.0,
                       escape_markup(label.text));
  }
  return svg + legend_svg(chart, layout.height) + "</svg>\n";
}

}  // namespace preheat
