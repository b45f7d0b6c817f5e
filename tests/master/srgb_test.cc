#include "master/srgb.h"

#include <gtest/gtest.h>

#include <cmath>

namespace preheat {
namespace {

double encode_reference(double linear) {
  return linear <= 0.0031308 ? 12.92 * linear : 1.055 * std::pow(linear, 1.0 / 2.4) - 0.055;
}

TEST(Srgb, RoundsToTheNearestCodeOfTheStandardCurve) {
  for (int step = 0; step <= 100'000; ++step) {
    const double linear = step / 100'000.0;
    const double exact = 255.0 * encode_reference(linear);
    // The standard's own two constants leave its curve a break of some 1e-7 where they meet.
    EXPECT_NEAR(srgb_from_linear(linear), exact, 0.5 + 1e-3) << linear;
  }
}

TEST(Srgb, EveryCodeSurvivesDecodingAndEncoding) {
  for (int code = 0; code < 256; ++code) {
    EXPECT_EQ(srgb_from_linear(linear_from_srgb(static_cast<std::uint8_t>(code))), code);
  }
}

TEST(Srgb, ClampsWhatIsOutOfRange) {
  EXPECT_EQ(srgb_from_linear(-1.0), 0);
  EXPECT_EQ(srgb_from_linear(7.0), 255);
  EXPECT_EQ(srgb_from_linear(INFINITY), 255);
}

}  // namespace
}  // namespace preheat
