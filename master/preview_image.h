// The image as far as it is rendered, small, for those who look on.
//
// A pixel of the preview is one of the image, so that a tile which comes again simply replaces what
// it brought before. Black where nothing has arrived.
// Threads: any; a caller waits no longer than it takes to copy the preview's pixels.
#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "common/film.h"
#include "common/render_settings.h"

namespace preheat {

class PreviewImage {
 public:
  static constexpr std::uint32_t kSideMax = 768;

  PreviewImage(std::uint32_t image_width, std::uint32_t image_height, double exposure_ev);

  void assign(const TileRect& rect, const TilePixels& pixels);

  // Grows with every tile.
  [[nodiscard]] std::uint64_t version() const;
  [[nodiscard]] std::uint32_t width() const { return width_; }
  [[nodiscard]] std::uint32_t height() const { return height_; }

  // Encoded afresh where something has changed since the last time.
  [[nodiscard]] std::shared_ptr<const std::string> jpeg();

 private:
  std::uint32_t image_width_;
  std::uint32_t image_height_;
  double gain_;
  std::uint32_t width_;
  std::uint32_t height_;
  mutable std::mutex mutex_;  // of what follows
  std::vector<float> rgb_;    // [height_ * width_ * 3], linear
  std::uint64_t version_ = 0;
  std::mutex jpeg_mutex_;  // of what follows; never taken by who assigns
  std::shared_ptr<const std::string> jpeg_;
  std::uint64_t jpeg_version_ = 0;
};

}  // namespace preheat
