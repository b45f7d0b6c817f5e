// The sRGB transfer curve (IEC 61966-2-1), with + - * / only, so that an 8-bit image has the same
// bytes on every machine, which pow of the C library does not promise.
#pragma once

#include <cstdint>

namespace preheat {

// Rounds to the nearest code value; clamps to [0,1] first.
[[nodiscard]] std::uint8_t srgb_from_linear(double linear);

[[nodiscard]] double linear_from_srgb(std::uint8_t code);

}  // namespace preheat
