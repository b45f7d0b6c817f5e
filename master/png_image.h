// 8-bit pixels as a PNG in memory, and bytes as text for a page.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>

namespace preheat {

// `pixels` is [height * width * channels], row by row; 3 channels are RGB, 4 with alpha. Empty if
// it cannot be encoded. Requires: width and height positive.
[[nodiscard]] std::string encode_png(std::span<const std::uint8_t> pixels, std::uint32_t width,
                                     std::uint32_t height, std::uint32_t channels);
// As encode_png for RGB; quality 1 to 100. Smaller and sooner done, for what is looked at once.
[[nodiscard]] std::string encode_jpeg(std::span<const std::uint8_t> pixels, std::uint32_t width,
                                      std::uint32_t height, int quality);

// RFC 4648, with padding.
[[nodiscard]] std::string base64(std::string_view bytes);

}  // namespace preheat
