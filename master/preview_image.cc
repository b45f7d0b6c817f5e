#include "master/preview_image.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "master/png_image.h"
#include "master/srgb.h"

namespace preheat {
namespace {

constexpr int kJpegQuality = 88;

std::uint32_t preview_side(std::uint32_t side, std::uint32_t longer) {
  if (longer <= PreviewImage::kSideMax) { return side; }
  return std::max(
      1U, static_cast<std::uint32_t>(std::uint64_t{side} * PreviewImage::kSideMax / longer));
}

// The preview's pixels whose pixel of the image, index * image / preview rounded down, lies in
// [begin, end).
struct Range {
  std::uint32_t begin;
  std::uint32_t end;
};
Range inside(std::uint32_t begin, std::uint32_t end, std::uint32_t image, std::uint32_t preview) {
  const auto first = [&](std::uint32_t edge) {
    return static_cast<std::uint32_t>((std::uint64_t{edge} * preview + image - 1) / image);
  };
  return {first(begin), first(end)};
}

}  // namespace

PreviewImage::PreviewImage(std::uint32_t image_width, std::uint32_t image_height,
                           double exposure_ev)
    : image_width_(image_width),
      image_height_(image_height),
      gain_(std::exp2(exposure_ev)),
      width_(preview_side(image_width, std::max(image_width, image_height))),
      height_(preview_side(image_height, std::max(image_width, image_height))),
      rgb_(std::size_t{3} * width_ * height_) {}

void PreviewImage::assign(const TileRect& rect, const TilePixels& pixels) {
  const Range rows = inside(rect.y, rect.y + rect.height, image_height_, height_);
  const Range columns = inside(rect.x, rect.x + rect.width, image_width_, width_);
  const std::lock_guard lock(mutex_);
  for (std::uint32_t row = rows.begin; row < rows.end; ++row) {
    const auto y = static_cast<std::uint32_t>(std::uint64_t{row} * image_height_ / height_);
    for (std::uint32_t column = columns.begin; column < columns.end; ++column) {
      const auto x = static_cast<std::uint32_t>(std::uint64_t{column} * image_width_ / width_);
      const std::size_t from = (std::size_t{y - rect.y} * rect.width + (x - rect.x)) * 3;
      const std::size_t to = (std::size_t{row} * width_ + column) * 3;
      std::copy_n(pixels.rgb.begin() + static_cast<std::ptrdiff_t>(from), 3,
                  rgb_.begin() + static_cast<std::ptrdiff_t>(to));
    }
  }
  ++version_;
}

std::uint64_t PreviewImage::version() const {
  const std::lock_guard lock(mutex_);
  return version_;
}

std::shared_ptr<const std::string> PreviewImage::jpeg() {
  const std::lock_guard lock(jpeg_mutex_);
  std::vector<float> rgb;
  {
    const std::lock_guard pixels_lock(mutex_);
    if (jpeg_ && jpeg_version_ == version_) { return jpeg_; }
    rgb = rgb_;
    jpeg_version_ = version_;
  }
  std::vector<std::uint8_t> codes;
  codes.reserve(rgb.size());
  for (const float value : rgb) {
    codes.push_back(srgb_from_linear(static_cast<double>(value) * gain_));
  }
  jpeg_ = std::make_shared<const std::string>(encode_jpeg(codes, width_, height_, kJpegQuality));
  return jpeg_;
}

}  // namespace preheat
