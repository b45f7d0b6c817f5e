#include "common/tile_codec.h"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

namespace preheat {

static_assert(std::endian::native == std::endian::little, "pixels travel as memory holds them");

std::uint64_t tile_bytes(const TileRect& rect) {
  return std::uint64_t{rect.width} * rect.height * 4 * sizeof(float);
}

std::vector<std::byte> encode_tile(const TilePixels& pixels) {
  const std::size_t rgb_bytes = pixels.rgb.size() * sizeof(float);
  const std::size_t variance_bytes = pixels.variance.size() * sizeof(float);
  std::vector<std::byte> bytes(rgb_bytes + variance_bytes);
  std::memcpy(bytes.data(), pixels.rgb.data(), rgb_bytes);
  std::memcpy(bytes.data() + rgb_bytes, pixels.variance.data(), variance_bytes);
  return bytes;
}

Result<TilePixels> decode_tile(std::span<const std::byte> bytes, const TileRect& rect) {
  if (bytes.size() != tile_bytes(rect)) {
    return fail(ExitCode::kFailed,
                fmt::format("a tile of {}x{} pixels came as {} bytes, not {}", rect.width,
                            rect.height, bytes.size(), tile_bytes(rect)));
  }
  const std::size_t pixel_count = std::size_t{rect.width} * rect.height;
  TilePixels pixels;
  pixels.rgb.resize(pixel_count * 3);
  pixels.variance.resize(pixel_count);
  std::memcpy(pixels.rgb.data(), bytes.data(), pixel_count * 3 * sizeof(float));
  std::memcpy(pixels.variance.data(), bytes.data() + pixel_count * 3 * sizeof(float),
              pixel_count * sizeof(float));
  const auto sound = [](float value) { return std::isfinite(value) && value >= 0.0F; };
  if (!std::all_of(pixels.rgb.begin(), pixels.rgb.end(), sound) ||
      !std::all_of(pixels.variance.begin(), pixels.variance.end(), sound)) {
    return fail(ExitCode::kFailed, "a tile holds a value that is not finite or negative");
  }
  return pixels;
}

}  // namespace preheat
