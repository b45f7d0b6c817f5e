// Everything besides the scene that the image is a function of, and how it is cut into tiles.
#pragma once

#include <algorithm>
#include <cstdint>

#include "common/ids.h"
#include "common/scene.h"
#include "common/vec3.h"

namespace preheat {

// A pinhole in the scene frame, ready to make rays: the direction through raster (x, y), with x to
// the right and y downwards in pixels, is forward + (2x/width - 1) * right - (2y/height - 1) * up,
// normalised. Orthographic: the origin moves by right and up instead and the direction is forward.
struct View {
  Vec3 origin{0.0F};
  Vec3 forward{0.0F, 0.0F, -1.0F};  // unit
  Vec3 right{1.0F, 0.0F, 0.0F};     // scaled by tan(fov/2) * aspect
  Vec3 up{0.0F, 1.0F, 0.0F};        // scaled by tan(fov/2)
  bool orthographic = false;
};

struct RenderSettings {
  View view{};
  std::uint32_t width = 512;
  std::uint32_t height = 512;
  std::uint32_t spp = 16;
  std::uint32_t bounces = 4;  // scattering events after the camera ray; 0 = emission seen directly
  std::uint64_t seed = 0;
  Vec3 sky{0.0F};             // radiance of the constant environment; 0 = none
};

// Of the whole image; each begins with a camera ray.
[[nodiscard]] inline double sample_count(const RenderSettings& settings) {
  return static_cast<double>(settings.width) * static_cast<double>(settings.height) *
         static_cast<double>(settings.spp);
}

// The view of a camera for an image of the given aspect; the camera's vertical field is kept.
[[nodiscard]] View make_view(const Camera& camera, const Frame& frame, std::uint32_t width,
                             std::uint32_t height);

struct TileRect {
  std::uint32_t x = 0;
  std::uint32_t y = 0;
  std::uint32_t width = 0;
  std::uint32_t height = 0;
};

// Row-major tiles of tile_size, the last ones cut at the image's edge.
struct TileGrid {
  std::uint32_t width = 0;
  std::uint32_t height = 0;
  std::uint32_t tile_size = 32;

  [[nodiscard]] std::uint32_t columns() const { return (width + tile_size - 1) / tile_size; }
  [[nodiscard]] std::uint32_t rows() const { return (height + tile_size - 1) / tile_size; }
  [[nodiscard]] std::uint32_t count() const { return columns() * rows(); }
  [[nodiscard]] TileRect rect(TileId tile) const {
    const std::uint32_t x = index_of(tile) % columns() * tile_size;
    const std::uint32_t y = index_of(tile) / columns() * tile_size;
    return {x, y, std::min(tile_size, width - x), std::min(tile_size, height - y)};
  }
};

enum class AccessCounting : std::uint8_t { kNone = 0, kSampled = 1, kExact = 2 };

}  // namespace preheat
