#include "master/srgb.h"

#include <algorithm>
#include <array>
#include <cstddef>

namespace preheat {
namespace {

// Newton's iteration from above converges monotonically: 60 steps bring any value in [1e-6, 1] to
// its last bit.
double fifth_root(double value) {
  double root = 1.0;
  for (int step = 0; step < 60; ++step) {
    const double fourth_power = root * root * root * root;
    root = (4.0 * root + value / fourth_power) / 5.0;
  }
  return root;
}

// `encoded` in [0,1].
double decode(double encoded) {
  if (encoded <= 0.04045) { return encoded / 12.92; }
  const double base = (encoded + 0.055) / 1.055;
  const double square = base * base;
  return square * fifth_root(square);  // base^2.4
}

// [code]: the linear value from which on `code` is nearer than code - 1.
std::array<double, 256> make_thresholds() {
  std::array<double, 256> thresholds{};
  for (std::size_t code = 1; code < thresholds.size(); ++code) {
    thresholds[code] = decode((static_cast<double>(code) - 0.5) / 255.0);
  }
  return thresholds;
}

std::array<double, 256> make_values() {
  std::array<double, 256> values{};
  for (std::size_t code = 0; code < values.size(); ++code) {
    values[code] = decode(static_cast<double>(code) / 255.0);
  }
  return values;
}

}  // namespace

std::uint8_t srgb_from_linear(double linear) {
  static const std::array<double, 256> thresholds = make_thresholds();
  const auto* const above = std::upper_bound(thresholds.begin() + 1, thresholds.end(), linear);
  return static_cast<std::uint8_t>(above - thresholds.begin() - 1);
}

double linear_from_srgb(std::uint8_t code) {
  static const std::array<double, 256> values = make_values();
  return values[code];
}

}  // namespace preheat
