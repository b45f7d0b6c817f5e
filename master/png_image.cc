#include "master/png_image.h"

#include <stb/stb_image_write.h>

#include <algorithm>
#include <cstddef>

namespace preheat {
namespace {

void append_to_string(void* context, void* data, int size) {
  static_cast<std::string*>(context)->append(static_cast<const char*>(data),
                                             static_cast<std::size_t>(size));
}

}  // namespace

std::string encode_png(std::span<const std::uint8_t> pixels, std::uint32_t width,
                       std::uint32_t height, std::uint32_t channels) {
  std::string content;
  const bool done = stbi_write_png_to_func(append_to_string, &content, static_cast<int>(width),
                                           static_cast<int>(height), static_cast<int>(channels),
                                           pixels.data(), static_cast<int>(width * channels)) != 0;
  return done ? content : std::string();
}

std::string encode_jpeg(std::span<const std::uint8_t> pixels, std::uint32_t width,
                        std::uint32_t height, int quality) {
  std::string content;
  const bool done =
      stbi_write_jpg_to_func(append_to_string, &content, static_cast<int>(width),
                             static_cast<int>(height), 3, pixels.data(), quality) != 0;
  return done ? content : std::string();
}

std::string base64(std::string_view bytes) {
  constexpr std::string_view kAlphabet =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  text.reserve((bytes.size() + 2) / 3 * 4);
  for (std::size_t begin = 0; begin < bytes.size(); begin += 3) {
    const std::size_t count = std::min<std::size_t>(3, bytes.size() - begin);
    std::uint32_t group = 0;
    for (std::size_t i = 0; i < 3; ++i) {
      const unsigned byte = i < count ? static_cast<unsigned char>(bytes[begin + i]) : 0U;
      group = group << 8U | byte;
    }
    for (std::size_t i = 0; i < 4; ++i) {
      text += i <= count ? kAlphabet[group >> (18U - 6U * i) & 63U] : '=';
    }
  }
  return text;
}

}  // namespace preheat
