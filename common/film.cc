#include "common/film.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <span>

#include "common/check.h"
#include "common/math.h"
#include "common/sha256.h"

namespace preheat {

static_assert(std::endian::native == std::endian::little,
              "pixels are hashed as they lie in memory");

TileAccumulator::TileAccumulator(std::size_t pixel_count) : sums_(pixel_count) {}

bool TileAccumulator::add(std::size_t pixel, const Vec3& radiance) {
  const bool valid =
      is_finite(radiance) && radiance.x >= 0.0F && radiance.y >= 0.0F && radiance.z >= 0.0F;
  if (!valid) { return false; }
  Sum& sum = sums_[pixel];
  sum.r += static_cast<double>(radiance.x);
  sum.g += static_cast<double>(radiance.y);
  sum.b += static_cast<double>(radiance.z);
  const double y = luminance(radiance);
  sum.luminance += y;
  sum.luminance_squared += y * y;
  return true;
}

TilePixels TileAccumulator::finish(std::uint32_t spp) const {
  CHECK(spp > 0);
  const double count = static_cast<double>(spp);
  TilePixels pixels;
  pixels.rgb.reserve(sums_.size() * 3);
  pixels.variance.reserve(sums_.size());
  for (const Sum& sum : sums_) {
    pixels.rgb.push_back(static_cast<float>(sum.r / count));
    pixels.rgb.push_back(static_cast<float>(sum.g / count));
    pixels.rgb.push_back(static_cast<float>(sum.b / count));
    // Of one sample nothing can be said about the spread; 0 stands for that.
    const double spread = sum.luminance_squared - sum.luminance * sum.luminance / count;
    const double variance = spp > 1 ? std::max(0.0, spread) / (count * (count - 1.0)) : 0.0;
    pixels.variance.push_back(static_cast<float>(variance));
  }
  return pixels;
}

Film::Film(std::uint32_t width, std::uint32_t height)
    : width_(width),
      height_(height),
      rgb_(static_cast<std::size_t>(width) * height * 3),
      variance_(static_cast<std::size_t>(width) * height) {}

void Film::assign(const TileRect& rect, const TilePixels& pixels) {
  const std::size_t rect_width = rect.width;
  CHECK(rect.x <= width_ && rect.width <= width_ - rect.x);
  CHECK(rect.y <= height_ && rect.height <= height_ - rect.y);
  CHECK(pixels.variance.size() == rect_width * rect.height);
  CHECK(pixels.rgb.size() == pixels.variance.size() * 3);
  for (std::size_t row = 0; row < rect.height; ++row) {
    const std::size_t from = row * rect_width;
    const std::size_t to = (rect.y + row) * width_ + rect.x;
    std::copy_n(pixels.rgb.data() + from * 3, rect_width * 3, rgb_.data() + to * 3);
    std::copy_n(pixels.variance.data() + from, rect_width, variance_.data() + to);
  }
}

double Film::standard_error() const {
  if (variance_.empty()) { return 0.0; }
  double sum = 0.0;
  for (const float variance : variance_) { sum += static_cast<double>(variance); }
  return std::sqrt(sum / static_cast<double>(variance_.size()));
}

std::string Film::pixels_sha256() const { return sha256_hex(std::as_bytes(std::span(rgb_))); }

}  // namespace preheat
