// A tile's pixels <-> the bytes that travel: rgb, then variance, float little-endian.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "common/film.h"
#include "common/render_settings.h"
#include "common/result.h"

namespace preheat {

[[nodiscard]] std::uint64_t tile_bytes(const TileRect& rect);

[[nodiscard]] std::vector<std::byte> encode_tile(const TilePixels& pixels);

// An error if the length is not that of the rectangle, or a value is not finite or negative.
[[nodiscard]] Result<TilePixels> decode_tile(std::span<const std::byte> bytes,
                                             const TileRect& rect);

}  // namespace preheat
