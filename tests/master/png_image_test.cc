#include "master/png_image.h"

#include <gtest/gtest.h>
#include <stb/stb_image.h>

#include <vector>

namespace preheat {
namespace {

// RFC 4648, section 10.
TEST(Base64, EncodesTheStandardsExamples) {
  EXPECT_EQ(base64(""), "");
  EXPECT_EQ(base64("f"), "Zg==");
  EXPECT_EQ(base64("fo"), "Zm8=");
  EXPECT_EQ(base64("foo"), "Zm9v");
  EXPECT_EQ(base64("foob"), "Zm9vYg==");
  EXPECT_EQ(base64("fooba"), "Zm9vYmE=");
  EXPECT_EQ(base64("foobar"), "Zm9vYmFy");
  EXPECT_EQ(base64("\xff\xfe\xfd"), "//79");
}

TEST(PngImage, KeepsEveryPixelAndItsAlpha) {
  const std::vector<std::uint8_t> pixels{1, 2, 3, 255, 4, 5, 6, 0, 7, 8, 9, 128};

  const std::string png = encode_png(pixels, 3, 1, 4);

  int width = 0;
  int height = 0;
  int channels = 0;
  stbi_uc* const read =
      stbi_load_from_memory(reinterpret_cast<const stbi_uc*>(png.data()),
                            static_cast<int>(png.size()), &width, &height, &channels, 4);
  ASSERT_NE(read, nullptr);
  EXPECT_EQ(width, 3);
  EXPECT_EQ(height, 1);
  EXPECT_EQ(std::vector<std::uint8_t>(read, read + pixels.size()), pixels);
  stbi_image_free(read);
}

}  // namespace
}  // namespace preheat
