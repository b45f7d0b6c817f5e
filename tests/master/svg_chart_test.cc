#include "master/svg_chart.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace preheat {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::Not;

std::size_t count_of(const std::string& text, const std::string& part) {
  std::size_t count = 0;
  for (std::size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + 1)) {
    ++count;
  }
  return count;
}

TEST(AxisTicks, AreRoundNumbersInsideTheAxis) {
  EXPECT_THAT(axis_ticks(0.0, 1.0, false),
              ElementsAre(0.0, 0.2, 0.4, testing::DoubleEq(0.6), 0.8, 1.0));
  EXPECT_THAT(axis_ticks(3.0, 47.0, false), ElementsAre(10.0, 20.0, 30.0, 40.0));
  EXPECT_THAT(axis_ticks(0.01, 1000.0, true),
              ElementsAre(testing::DoubleEq(0.01), testing::DoubleEq(0.1), 1.0, 10.0, 100.0,
                          testing::DoubleEq(1000.0)));
}

TEST(AxisTicks, AreFewWhateverTheRange) {
  for (const bool logarithmic : {false, true}) {
    for (double low = 1e-12; low < 1e12; low *= 7.3) {
      for (double high = low * 1.01; high < 1e16; high *= 3.1) {
        const std::vector<double> ticks = axis_ticks(low, high, logarithmic);
        EXPECT_LE(ticks.size(), 10U) << low << ' ' << high;
        EXPECT_GE(ticks.size(), 2U) << low << ' ' << high;
        for (const double tick : ticks) {
          EXPECT_GE(tick, low - 1e-6 * (high - low));
          EXPECT_LE(tick, high + 1e-6 * (high - low));
        }
      }
    }
  }
}

TEST(TickText, IsShort) {
  EXPECT_EQ(tick_text(0.0), "0");
  EXPECT_EQ(tick_text(0.25), "0.25");
  EXPECT_EQ(tick_text(1500.0), "1.5k");
  EXPECT_EQ(tick_text(3e6), "3M");
  EXPECT_EQ(tick_text(-2e9), "-2G");
  EXPECT_EQ(tick_text(1e-5), "1e-05");
  EXPECT_EQ(tick_text(1e18), "1e+18");
}

Chart chart_of(std::vector<ChartPoint> points, ChartSeries::Style style) {
  Chart chart;
  chart.title = "a < b";
  chart.series.push_back({"series", 3, style, std::move(points)});
  return chart;
}

TEST(SvgChart, ScalesPointsBetweenTheAxes) {
  Chart chart = chart_of({{0.0, 0.0}, {10.0, 100.0}}, ChartSeries::Style::kLine);

  const std::string svg = make_svg(chart);

  // 66 units of margin on the left, 14 on the right, 12 above and 48 below, of 480 x 360.
  EXPECT_THAT(svg, HasSubstr("<path class=\"line look3\" d=\"M66 312L466 12\"/>"));
  EXPECT_THAT(svg, HasSubstr("viewBox=\"0 0 480 360\""));
}

TEST(SvgChart, PutsWhatALogarithmicAxisCannotShowOnItsEdge) {
  Chart chart = chart_of({{1.0, 0.0}, {100.0, 10.0}, {10.0, 1000.0}}, ChartSeries::Style::kLine);
  chart.x.logarithmic = true;
  chart.y.logarithmic = true;

  EXPECT_THAT(make_svg(chart), HasSubstr("d=\"M66 312L466 312L266 12\""));
}

TEST(SvgChart, LeavesOutWhatIsNotANumber) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double inf = std::numeric_limits<double>::infinity();
  const std::string svg =
      make_svg(chart_of({{nan, 1.0}, {1.0, inf}, {2.0, 2.0}}, ChartSeries::Style::kDots));

  EXPECT_THAT(svg, Not(HasSubstr("nan")));
  EXPECT_THAT(svg, Not(HasSubstr("inf")));
  EXPECT_EQ(count_of(svg, "h0"), 1U);
}

TEST(SvgChart, DrawsDotsThatFallTogetherOnce) {
  std::vector<ChartPoint> points(1000, {5.0, 5.0});
  points.push_back({10.0, 10.0});

  EXPECT_EQ(count_of(make_svg(chart_of(points, ChartSeries::Style::kDots)), "h0"), 2U);
}

TEST(SvgChart, IsReadOutByTitleAndEscapesIt) {
  const std::string svg = make_svg(chart_of({}, ChartSeries::Style::kMarks));

  EXPECT_THAT(svg, HasSubstr("role=\"img\" aria-label=\"a &lt; b\""));
}

TEST(SvgChart, HasALegendFromTwoSeriesOn) {
  Chart chart = chart_of({{1.0, 1.0}}, ChartSeries::Style::kLine);
  EXPECT_THAT(make_svg(chart), Not(HasSubstr(">series<")));

  chart.series.push_back({"other", 1, ChartSeries::Style::kMarks, {{2.0, 2.0}}});
  EXPECT_THAT(make_svg(chart), HasSubstr(">series<"));
  EXPECT_THAT(make_svg(chart), HasSubstr(">other<"));
}

}  // namespace
}  // namespace preheat
