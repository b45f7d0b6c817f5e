// How far two images are apart. EXR is taken as stored, PNG is decoded from sRGB to linear, so that
// either may be compared with either.
#pragma once

#include <cstdint>
#include <filesystem>
#include <vector>

#include "common/result.h"

namespace preheat {

struct Image {
  std::uint32_t width = 0;
  std::uint32_t height = 0;
  std::vector<float> rgb{};  // [height * width * 3], linear
};

// Missing, damaged or of another kind: kFailed.
[[nodiscard]] Result<Image> read_image(const std::filesystem::path& file);

struct ImageDifference {
  std::uint64_t pixels = 0;
  std::uint64_t pixels_differing = 0;  // in any bit of any channel
  double mse = 0.0;                    // mean over channel values
  double rmse = 0.0;
  double max_abs = 0.0;
  // Squared error over (reference^2 + 1e-2), averaged; the reference is the second image.
  double relative_mse = 0.0;
  double psnr_db = 0.0;  // against a peak of 1; infinite for equal images
};

// Of different sizes: a usage error that names both. A value that is not finite on one side only
// counts as infinitely far.
[[nodiscard]] Result<ImageDifference> compare_images(const Image& image, const Image& reference);

}  // namespace preheat
