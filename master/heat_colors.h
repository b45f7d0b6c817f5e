// Colours that stand for numbers, even in lightness as the eye sees it (Ottosson's OKLab), so that
// equal steps look equal, in print without colours too.
#pragma once

#include <array>
#include <cstdint>
#include <string>

namespace preheat {

using Rgb8 = std::array<std::uint8_t, 3>;  // sRGB

// Dark violet for 0 over red to light yellow for 1; clamped.
[[nodiscard]] Rgb8 heat_color(double share);

// Blue for -1, nearly white for 0, orange for 1; clamped.
[[nodiscard]] Rgb8 difference_color(double share);

// "#rrggbb".
[[nodiscard]] std::string css_color(const Rgb8& color);

}  // namespace preheat
