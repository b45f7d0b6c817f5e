// A film as an image file: PNG for looking at, EXR for measuring.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "common/film.h"
#include "common/result.h"

namespace preheat {

enum class ImageFormat : std::uint8_t { kPng, kExr };

// By the file name's ending; another one is a usage error that lists these.
[[nodiscard]] Result<ImageFormat> image_format(const std::filesystem::path& file);

// Names and values for the EXR header, e.g. {"preheat.seed", "0"}. PNG carries none.
using ImageMetadata = std::vector<std::pair<std::string, std::string>>;

// PNG: 8 bits of sRGB of radiance * 2^exposure_ev, clamped. EXR: 32-bit float R, G, B as rendered,
// zip compressed; the exposure is metadata there.
[[nodiscard]] Result<void> write_image(const std::filesystem::path& file, const Film& film,
                                       double exposure_ev, const ImageMetadata& metadata);

}  // namespace preheat
