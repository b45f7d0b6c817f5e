#include "master/heat_colors.h"

#include <gtest/gtest.h>

#include <cmath>

#include "master/srgb.h"

namespace preheat {
namespace {

// CIE L*, another measure of lightness than the one that the colours are made with.
double lightness(const Rgb8& color) {
  const double luminance = 0.2126 * linear_from_srgb(color[0]) +
                           0.7152 * linear_from_srgb(color[1]) +
                           0.0722 * linear_from_srgb(color[2]);
  return 116.0 * std::cbrt(luminance) - 16.0;
}

TEST(HeatColors, GetLighterInEvenSteps) {
  constexpr int kSteps = 20;
  for (int i = 1; i <= kSteps; ++i) {
    const double step =
        lightness(heat_color(i / double{kSteps})) - lightness(heat_color((i - 1) / double{kSteps}));
    EXPECT_GT(step, 2.0) << i;
    EXPECT_LT(step, 6.0) << i;
  }
}

TEST(HeatColors, ClampWhatIsOutside) {
  EXPECT_EQ(heat_color(-1.0), heat_color(0.0));
  EXPECT_EQ(heat_color(7.0), heat_color(1.0));
  EXPECT_EQ(difference_color(-9.0), difference_color(-1.0));
}

TEST(DifferenceColors, AreBlueBelowOrangeAboveAndNearlyWhiteBetween) {
  const Rgb8 below = difference_color(-1.0);
  const Rgb8 middle = difference_color(0.0);
  const Rgb8 above = difference_color(1.0);

  EXPECT_GT(below[2], below[0] + 60);
  EXPECT_GT(above[0], above[2] + 60);
  EXPECT_GT(middle[0], 225);
  EXPECT_NEAR(middle[0], middle[2], 2);
  EXPECT_NEAR(lightness(below), lightness(above), 8.0);
}

TEST(HeatColors, AreWrittenForStyleSheets) { EXPECT_EQ(css_color({0, 10, 255}), "#000aff"); }

}  // namespace
}  // namespace preheat
