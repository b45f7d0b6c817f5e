// Pixels: a tile's samples summed in sample order, and the image that tiles are assigned to.
//
// A pixel's value is the sum of its samples in index order in double, divided by their count and
// rounded to float once; so no thread, tile size or order of arrival changes a bit.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "common/render_settings.h"
#include "common/vec3.h"

namespace preheat {

// One finished tile, row by row.
struct TilePixels {
  std::vector<float> rgb{};       // [width * height * 3], linear radiance
  std::vector<float> variance{};  // [width * height] of the pixel's mean luminance, from its samples
};

// Sums the samples of one tile. Samples of a pixel must be added in index order.
class TileAccumulator {
 public:
  explicit TileAccumulator(std::size_t pixel_count);
  // A sample with a NaN, infinite or negative component counts as black; returns false for it.
  bool add(std::size_t pixel, const Vec3& radiance);
  [[nodiscard]] TilePixels finish(std::uint32_t spp) const;

 private:
  struct Sum {
    double r = 0.0, g = 0.0, b = 0.0;
    double luminance = 0.0, luminance_squared = 0.0;
  };
  std::vector<Sum> sums_;
};

// The whole image, linear float RGB. Tiles are assigned, never added.
class Film {
 public:
  Film(std::uint32_t width, std::uint32_t height);
  void assign(const TileRect& rect, const TilePixels& pixels);
  [[nodiscard]] std::uint32_t width() const { return width_; }
  [[nodiscard]] std::uint32_t height() const { return height_; }
  [[nodiscard]] const std::vector<float>& rgb() const { return rgb_; }  // [height * width * 3]
  // Root mean square over pixels of the estimated standard error of the pixel's mean luminance.
  [[nodiscard]] double standard_error() const;
  // SHA-256 in hex of rgb(), row by row, little-endian.
  [[nodiscard]] std::string pixels_sha256() const;

 private:
  std::uint32_t width_;
  std::uint32_t height_;
  std::vector<float> rgb_;
  std::vector<float> variance_;
};

}  // namespace preheat
