#include "master/heat_colors.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "master/srgb.h"

namespace preheat {
namespace {

using Linear = std::array<double, 3>;

// From polar OKLab to linear sRGB, which may lie outside [0,1].
Linear linear_from(double lightness, double chroma, double hue_deg) {
  const double hue = hue_deg * 3.14159265358979 / 180.0;
  const double a = chroma * std::cos(hue);
  const double b = chroma * std::sin(hue);
  const auto cube = [](double value) { return value * value * value; };
  const double l = cube(lightness + 0.3963377774 * a + 0.2158037573 * b);
  const double m = cube(lightness - 0.1055613458 * a - 0.0638541728 * b);
  const double s = cube(lightness - 0.0894841775 * a - 1.2914855480 * b);
  return {4.0767416621 * l - 3.3077115913 * m + 0.2309699292 * s,
          -1.2684380046 * l + 2.6097574011 * m - 0.3413193965 * s,
          -0.0041960863 * l - 0.7034186147 * m + 1.7076147010 * s};
}

bool is_displayable(const Linear& color) {
  return std::all_of(color.begin(), color.end(),
                     [](double value) { return value >= 0.0 && value <= 1.0; });
}

// Lightness and hue stay; a colour that no screen shows loses chroma until one does.
Rgb8 displayable(double lightness, double chroma, double hue_deg) {
  double shown = 0.0;
  double step = chroma;
  for (int i = 0; i < 12; ++i) {
    if (is_displayable(linear_from(lightness, shown + step, hue_deg))) { shown += step; }
    step *= 0.5;
  }
  const Linear color = linear_from(lightness, std::min(shown, chroma), hue_deg);
  return {srgb_from_linear(color[0]), srgb_from_linear(color[1]), srgb_from_linear(color[2])};
}

}  // namespace

Rgb8 heat_color(double share) {
  const double t = std::clamp(share, 0.0, 1.0);
  // Violet at 290 degrees, through red at 30, to yellow at 105.
  return displayable(0.22 + 0.72 * t, 0.19, 290.0 + 175.0 * t);
}

Rgb8 difference_color(double share) {
  const double t = std::clamp(share, -1.0, 1.0);
  return displayable(0.95 - 0.45 * std::abs(t), 0.17 * std::abs(t), t < 0.0 ? 255.0 : 50.0);
}

std::string css_color(const Rgb8& color) {
  return fmt::format("#{:02x}{:02x}{:02x}", color[0], color[1], color[2]);
}

}  // namespace preheat
