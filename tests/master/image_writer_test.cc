#include "master/image_writer.h"

#include <ImfHeader.h>
#include <ImfInputFile.h>
#include <ImfStringAttribute.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <random>

#include "master/image_compare.h"
#include "master/srgb.h"

namespace preheat {
namespace {

namespace fs = std::filesystem;

constexpr std::uint32_t kWidth = 7;
constexpr std::uint32_t kHeight = 5;

Film random_film(unsigned seed) {
  std::mt19937 generator(seed);
  std::uniform_real_distribution<float> radiance(0.0F, 1.5F);
  TilePixels pixels;
  for (std::uint32_t value = 0; value < kWidth * kHeight * 3; ++value) {
    pixels.rgb.push_back(radiance(generator));
  }
  pixels.variance.resize(kWidth * kHeight);
  Film film(kWidth, kHeight);
  film.assign(TileRect{0, 0, kWidth, kHeight}, pixels);
  return film;
}

class ImageFiles : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = (fs::temp_directory_path() / "preheat_images_XXXXXX").string();
    folder_ = ::mkdtemp(name.data());
  }
  void TearDown() override { fs::remove_all(folder_); }
  fs::path folder_{};
};

TEST_F(ImageFiles, ExrKeepsEveryBitAndTheMetadata) {
  const Film film = random_film(1);
  const fs::path file = folder_ / "image.exr";

  ASSERT_TRUE(write_image(file, film, 2.0, {{"preheat.seed", "17"}}).has_value());
  const auto image = read_image(file);

  ASSERT_TRUE(image.has_value());
  EXPECT_EQ(image->width, kWidth);
  EXPECT_EQ(image->height, kHeight);
  EXPECT_EQ(image->rgb, film.rgb());
  const Imf::InputFile input(file.c_str());
  EXPECT_EQ(input.header().typedAttribute<Imf::StringAttribute>("preheat.seed").value(), "17");
}

TEST_F(ImageFiles, PngHoldsTheExposedSrgbCodes) {
  const Film film = random_film(2);
  const fs::path file = folder_ / "image.png";

  ASSERT_TRUE(write_image(file, film, -1.0, {}).has_value());
  const auto image = read_image(file);

  ASSERT_TRUE(image.has_value());
  ASSERT_EQ(image->rgb.size(), film.rgb().size());
  for (std::size_t value = 0; value < image->rgb.size(); ++value) {
    const auto code = srgb_from_linear(0.5 * static_cast<double>(film.rgb()[value]));
    EXPECT_EQ(image->rgb[value], static_cast<float>(linear_from_srgb(code)));
  }
}

TEST_F(ImageFiles, AFailedWriteLeavesTheOldImage) {
  const fs::path file = folder_ / "sub" / "image.png";

  const auto written = write_image(file, random_film(3), 0.0, {});

  ASSERT_FALSE(written.has_value());
  EXPECT_EQ(written.error().code, ExitCode::kOutputUnwritable);
}

TEST_F(ImageFiles, OnlyPngAndExrAreKnown) {
  EXPECT_EQ(image_format("a/b.png").value(), ImageFormat::kPng);
  EXPECT_EQ(image_format("b.exr").value(), ImageFormat::kExr);
  for (const char* name : {"b.jpg", "png", "b", "", "b.png.tmp"}) {
    const auto format = image_format(name);
    ASSERT_FALSE(format.has_value()) << name;
    EXPECT_EQ(format.error().code, ExitCode::kUsage);
  }
}

}  // namespace
}  // namespace preheat
