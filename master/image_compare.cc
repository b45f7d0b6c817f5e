#include "master/image_compare.h"

#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfInputFile.h>
#include <fmt/format.h>
#include <stb/stb_image.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <exception>
#include <fstream>
#include <iterator>
#include <limits>
#include <memory>
#include <string>

#include "master/srgb.h"

namespace preheat {
namespace {

constexpr std::int64_t kPixelsMax = std::int64_t{1} << 31;

Error unreadable(const std::filesystem::path& file, const std::string& why) {
  return Error{ExitCode::kFailed, fmt::format("cannot read image {}: {}", file.string(), why)};
}

Result<Image> read_exr(const std::filesystem::path& file) {
  try {
    Imf::InputFile input(file.c_str());
    const auto& window = input.header().dataWindow();
    const std::int64_t width = std::int64_t{window.max.x} - window.min.x + 1;
    const std::int64_t height = std::int64_t{window.max.y} - window.min.y + 1;
    if (width < 1 || height < 1 || width > kPixelsMax / height) {
      return tl::unexpected(unreadable(file, fmt::format("{}x{} pixels", width, height)));
    }
    Image image{static_cast<std::uint32_t>(width), static_cast<std::uint32_t>(height), {}};
    image.rgb.resize(static_cast<std::size_t>(width * height) * 3);

    Imf::FrameBuffer frame;
    const char* const names[] = {"R", "G", "B"};
    for (std::size_t channel = 0; channel < 3; ++channel) {
      frame.insert(
          names[channel],
          Imf::Slice::Make(Imf::FLOAT, image.rgb.data() + channel, window.min, width, height,
                           3 * sizeof(float), 3 * sizeof(float) * static_cast<std::size_t>(width)));
    }
    input.setFrameBuffer(frame);
    input.readPixels(window.min.y, window.max.y);
    return image;
  } catch (const std::exception& error) { return tl::unexpected(unreadable(file, error.what())); }
}

Result<Image> read_png(const std::filesystem::path& file, const std::string& content) {
  if (content.size() > static_cast<std::size_t>(std::numeric_limits<int>::max())) {
    return tl::unexpected(unreadable(file, fmt::format("{} bytes", content.size())));
  }
  int width = 0;
  int height = 0;
  int channels = 0;
  const std::unique_ptr<stbi_uc, decltype(&stbi_image_free)> codes(
      stbi_load_from_memory(reinterpret_cast<const stbi_uc*>(content.data()),
                            static_cast<int>(content.size()), &width, &height, &channels, 3),
      &stbi_image_free);
  if (codes == nullptr) { return tl::unexpected(unreadable(file, stbi_failure_reason())); }
  Image image{static_cast<std::uint32_t>(width), static_cast<std::uint32_t>(height), {}};
  image.rgb.resize(std::size_t{image.width} * image.height * 3);
  std::transform(codes.get(), codes.get() + image.rgb.size(), image.rgb.begin(),
                 [](stbi_uc code) { return static_cast<float>(linear_from_srgb(code)); });
  return image;
}

}  // namespace

Result<Image> read_image(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  const std::string content{std::istreambuf_iterator<char>(stream), {}};
  if (!stream.is_open() || content.empty()) {
    return tl::unexpected(unreadable(file, "missing or empty"));
  }
  if (content.starts_with("\x76\x2f\x31\x01")) { return read_exr(file); }
  if (content.starts_with("\x89PNG")) { return read_png(file, content); }
  return tl::unexpected(unreadable(file, "neither PNG nor EXR"));
}

Result<ImageDifference> compare_images(const Image& image, const Image& reference) {
  if (image.width != reference.width || image.height != reference.height) {
    return fail(ExitCode::kUsage,
                fmt::format("images differ in size: {}x{} and {}x{} pixels", image.width,
                            image.height, reference.width, reference.height));
  }
  ImageDifference difference;
  difference.pixels = std::uint64_t{image.width} * image.height;
  double squared = 0.0;
  double relative = 0.0;
  for (std::size_t pixel = 0; pixel < difference.pixels; ++pixel) {
    bool differs = false;
    for (std::size_t value = 3 * pixel; value < 3 * pixel + 3; ++value) {
      const float a = image.rgb[value];
      const float b = reference.rgb[value];
      if (std::bit_cast<std::uint32_t>(a) == std::bit_cast<std::uint32_t>(b)) { continue; }
      differs = true;
      const double expected = static_cast<double>(b);
      double error = std::abs(static_cast<double>(a) - expected);
      if (std::isnan(error)) { error = std::numeric_limits<double>::infinity(); }
      difference.max_abs = std::max(difference.max_abs, error);
      squared += error * error;
      const double weight = std::isfinite(expected) ? expected * expected + 1e-2 : 1.0;
      relative += error * error / weight;
    }
    difference.pixels_differing += differs ? 1 : 0;
  }
  const double values = 3.0 * static_cast<double>(difference.pixels);
  difference.mse = squared / values;
  difference.rmse = std::sqrt(difference.mse);
  difference.relative_mse = relative / values;
  difference.psnr_db = -10.0 * std::log10(difference.mse);
  return difference;
}

}  // namespace preheat
