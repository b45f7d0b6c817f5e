#include "master/image_compare.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <fstream>
#include <limits>

namespace preheat {
namespace {

Image image_of(std::uint32_t width, std::uint32_t height, std::vector<float> rgb) {
  return Image{width, height, std::move(rgb)};
}

TEST(CompareImages, EqualImagesDifferInNothing) {
  const Image image = image_of(2, 1, {0.1F, 0.2F, 0.3F, 0.4F, 0.5F, 0.6F});

  const auto difference = compare_images(image, image);

  ASSERT_TRUE(difference.has_value());
  EXPECT_EQ(difference->pixels, 2U);
  EXPECT_EQ(difference->pixels_differing, 0U);
  EXPECT_EQ(difference->mse, 0.0);
  EXPECT_TRUE(std::isinf(difference->psnr_db));
}

TEST(CompareImages, FiguresAreThoseDoneByHand) {
  const Image image = image_of(2, 1, {1.0F, 0.5F, 0.0F, 0.0F, 0.0F, 0.0F});
  const Image reference = image_of(2, 1, {0.5F, 0.5F, 0.0F, 0.0F, 0.0F, 0.0F});

  const auto difference = compare_images(image, reference);

  ASSERT_TRUE(difference.has_value());
  EXPECT_EQ(difference->pixels_differing, 1U);
  EXPECT_DOUBLE_EQ(difference->mse, 0.25 / 6.0);
  EXPECT_DOUBLE_EQ(difference->rmse, std::sqrt(0.25 / 6.0));
  EXPECT_DOUBLE_EQ(difference->max_abs, 0.5);
  EXPECT_DOUBLE_EQ(difference->relative_mse, 0.25 / (0.25 + 1e-2) / 6.0);
  EXPECT_NEAR(difference->psnr_db, 13.802, 1e-3);
}

TEST(CompareImages, SeesASignOfZeroAndANotANumber) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const Image zeros = image_of(1, 1, {0.0F, 0.0F, 0.0F});

  EXPECT_EQ(compare_images(image_of(1, 1, {-0.0F, 0.0F, 0.0F}), zeros)->pixels_differing, 1U);
  const auto broken = compare_images(image_of(1, 1, {nan, 0.0F, 0.0F}), zeros);
  EXPECT_EQ(broken->pixels_differing, 1U);
  EXPECT_TRUE(std::isinf(broken->max_abs));
}

TEST(CompareImages, RefusesImagesOfDifferentSizes) {
  const auto difference =
      compare_images(image_of(2, 1, std::vector<float>(6)), image_of(1, 2, std::vector<float>(6)));

  ASSERT_FALSE(difference.has_value());
  EXPECT_EQ(difference.error().code, ExitCode::kUsage);
  EXPECT_NE(difference.error().message.find("2x1 and 1x2"), std::string::npos);
}

TEST(ReadImage, RefusesWhatIsMissingForeignOrTruncated) {
  namespace fs = std::filesystem;
  std::string name = (fs::temp_directory_path() / "preheat_read_XXXXXX").string();
  const fs::path folder = ::mkdtemp(name.data());
  std::ofstream(folder / "text.png") << "hello";
  std::ofstream(folder / "empty.exr") << "";
  std::ofstream(folder / "cut.exr") << "\x76\x2f\x31\x01 and no more";
  std::ofstream(folder / "cut.png") << "\x89PNG and no more";

  for (const char* file : {"missing.exr", "text.png", "empty.exr", "cut.exr", "cut.png"}) {
    const auto image = read_image(folder / file);
    ASSERT_FALSE(image.has_value()) << file;
    EXPECT_NE(image.error().message.find(file), std::string::npos);
  }
  fs::remove_all(folder);
}

}  // namespace
}  // namespace preheat
