#include "master/image_writer.h"

#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfIO.h>
#include <ImfOutputFile.h>
#include <ImfStringAttribute.h>
#include <fmt/format.h>

#include <cmath>
#include <cstdint>
#include <exception>
#include <string>

#include "master/file_output.h"
#include "master/png_image.h"
#include "master/srgb.h"

namespace preheat {
namespace {

// OpenEXR writes into a string; the file itself is write_output's.
class StringStream : public Imf::OStream {
 public:
  StringStream() : Imf::OStream("image") {}
  void write(const char* bytes, int count) override {
    content_.replace(position_, static_cast<std::size_t>(count), bytes,
                     static_cast<std::size_t>(count));
    position_ += static_cast<std::size_t>(count);
  }
  std::uint64_t tellp() override { return position_; }
  void seekp(std::uint64_t position) override { position_ = position; }
  [[nodiscard]] const std::string& content() const { return content_; }

 private:
  std::string content_;
  std::uint64_t position_ = 0;
};

std::string encode_exr(const Film& film, double exposure_ev, const ImageMetadata& metadata) {
  const auto width = static_cast<int>(film.width());
  const auto height = static_cast<int>(film.height());
  Imf::Header header(width, height);
  header.compression() = Imf::ZIP_COMPRESSION;
  header.insert("preheat.exposure_ev", Imf::StringAttribute(fmt::format("{}", exposure_ev)));
  for (const auto& [name, value] : metadata) { header.insert(name, Imf::StringAttribute(value)); }

  Imf::FrameBuffer frame;
  const std::size_t pixel_bytes = 3 * sizeof(float);
  const std::size_t row_bytes = pixel_bytes * film.width();
  const char* const names[] = {"R", "G", "B"};
  for (std::size_t channel = 0; channel < 3; ++channel) {
    header.channels().insert(names[channel], Imf::Channel(Imf::FLOAT));
    // OpenEXR's slices are for reading and writing alike, hence not const; output only reads.
    float* const first = const_cast<float*>(film.rgb().data()) + channel;
    frame.insert(names[channel],
                 Imf::Slice(Imf::FLOAT, reinterpret_cast<char*>(first), pixel_bytes, row_bytes));
  }
  StringStream stream;
  {
    Imf::OutputFile file(stream, header);
    file.setFrameBuffer(frame);
    file.writePixels(height);
  }
  return stream.content();
}

std::string encode_film_png(const Film& film, double exposure_ev) {
  const double gain = std::exp2(exposure_ev);
  std::vector<std::uint8_t> codes;
  codes.reserve(film.rgb().size());
  for (const float radiance : film.rgb()) {
    codes.push_back(srgb_from_linear(static_cast<double>(radiance) * gain));
  }
  return encode_png(codes, film.width(), film.height(), 3);
}

}  // namespace

Result<ImageFormat> image_format(const std::filesystem::path& file) {
  const std::string extension = file.extension().string();
  if (extension == ".png") { return ImageFormat::kPng; }
  if (extension == ".exr") { return ImageFormat::kExr; }
  return fail(ExitCode::kUsage,
              fmt::format("image {}: its name must end in .png or .exr", file.string()));
}

Result<void> write_image(const std::filesystem::path& file, const Film& film, double exposure_ev,
                         const ImageMetadata& metadata) {
  const auto format = image_format(file);
  if (!format) { return tl::unexpected(format.error()); }
  std::string content;
  try {
    content = *format == ImageFormat::kExr ? encode_exr(film, exposure_ev, metadata)
                                           : encode_film_png(film, exposure_ev);
  } catch (const std::exception& error) {
    return fail(ExitCode::kOutputUnwritable,
                fmt::format("cannot encode {}: {}", file.string(), error.what()));
  }
  if (content.empty()) {
    return fail(ExitCode::kOutputUnwritable,
                fmt::format("cannot encode {} at {}x{} pixels", file.string(), film.width(),
                            film.height()));
  }
  return write_output(file, content);
}

}  // namespace preheat
