#include "common/film.h"

#include <gtest/gtest.h>

#include <cmath>
#include <csignal>
#include <limits>
#include <random>

namespace preheat {
namespace {

TEST(TileAccumulator, AveragesTheSamplesOfEachPixel) {
  TileAccumulator tile(2);

  EXPECT_TRUE(tile.add(0, Vec3(1.0F, 2.0F, 3.0F)));
  EXPECT_TRUE(tile.add(0, Vec3(3.0F, 2.0F, 1.0F)));
  EXPECT_TRUE(tile.add(1, Vec3(0.5F)));

  const TilePixels pixels = tile.finish(2);
  EXPECT_EQ(pixels.rgb, (std::vector<float>{2.0F, 2.0F, 2.0F, 0.25F, 0.25F, 0.25F}));
}

TEST(TileAccumulator, CountsBadSamplesAsBlack) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const float infinity = std::numeric_limits<float>::infinity();
  TileAccumulator tile(1);

  EXPECT_TRUE(tile.add(0, Vec3(4.0F)));
  EXPECT_FALSE(tile.add(0, Vec3(nan, 1.0F, 1.0F)));
  EXPECT_FALSE(tile.add(0, Vec3(1.0F, infinity, 1.0F)));
  EXPECT_FALSE(tile.add(0, Vec3(1.0F, 1.0F, -1e-20F)));

  EXPECT_EQ(tile.finish(4).rgb, (std::vector<float>{1.0F, 1.0F, 1.0F}));
}

TEST(TileAccumulator, SumsAMillionSamplesWithoutLosingAny) {
  constexpr std::uint32_t kCount = 1U << 20U;
  TileAccumulator tile(1);
  for (std::uint32_t i = 0; i < kCount; ++i) { ASSERT_TRUE(tile.add(0, Vec3(0.1F))); }
  EXPECT_EQ(tile.finish(kCount).rgb[0], 0.1F);
}

TEST(TileAccumulator, EstimatesTheVarianceOfTheMean) {
  TileAccumulator tile(1);
  for (const float value : {1.0F, 2.0F, 3.0F, 6.0F}) { ASSERT_TRUE(tile.add(0, Vec3(value))); }

  // Squared deviations 4 + 1 + 0 + 9 = 14, over n (n - 1) = 12.
  EXPECT_NEAR(tile.finish(4).variance[0], 14.0F / 12.0F, 1e-6F);
}

TEST(TileAccumulator, OneSampleSaysNothingAboutItsSpread) {
  TileAccumulator tile(1);
  ASSERT_TRUE(tile.add(0, Vec3(5.0F)));
  EXPECT_EQ(tile.finish(1).variance[0], 0.0F);
}

TilePixels tile_of(const TileRect& rect, std::uint32_t image_width) {
  TilePixels pixels;
  for (std::uint32_t y = 0; y < rect.height; ++y) {
    for (std::uint32_t x = 0; x < rect.width; ++x) {
      const auto value = static_cast<float>((rect.y + y) * image_width + rect.x + x);
      pixels.rgb.insert(pixels.rgb.end(), {value, value + 0.25F, value + 0.5F});
      pixels.variance.push_back(value);
    }
  }
  return pixels;
}

TEST(Film, TilesOfAnySizeAndOrderMakeTheSameImage) {
  for (const auto& [width, height] : {std::pair{1U, 1U}, {1U, 7U}, {13U, 5U}, {17U, 31U}}) {
    Film whole(width, height);
    whole.assign({0, 0, width, height}, tile_of({0, 0, width, height}, width));
    for (const std::uint32_t tile_size : {1U, 4U, 32U}) {
      const TileGrid grid{width, height, tile_size};
      Film film(width, height);
      for (std::uint32_t tile = grid.count(); tile-- > 0;) {
        const TileRect rect = grid.rect(TileId{tile});
        film.assign(rect, tile_of(rect, width));
      }
      EXPECT_EQ(film.rgb(), whole.rgb());
      EXPECT_EQ(film.pixels_sha256(), whole.pixels_sha256());
      EXPECT_EQ(film.standard_error(), whole.standard_error());
    }
  }
}

TEST(Film, StandardErrorIsTheRootMeanSquare) {
  Film film(2, 1);
  film.assign({0, 0, 2, 1}, {std::vector<float>(6), {0.09F, 0.25F}});
  EXPECT_NEAR(film.standard_error(), std::sqrt(0.17), 1e-7);
}

// SHA-256 of twelve floats 0, 1, 2, ... as 48 little-endian bytes.
TEST(Film, HashIsOverLittleEndianFloats) {
  Film film(2, 2);
  TilePixels pixels;
  for (int i = 0; i < 12; ++i) { pixels.rgb.push_back(static_cast<float>(i)); }
  pixels.variance.resize(4);
  film.assign({0, 0, 2, 2}, pixels);

  EXPECT_EQ(film.pixels_sha256(),
            "29e1889124dc651e7bb488251123910767d042ae6dc47c280ec364655e24ab49");
}

TEST(FilmDeathTest, RefusesATileOutsideTheImage) {
  Film film(4, 4);
  const TilePixels pixels{std::vector<float>(12), std::vector<float>(4)};
  EXPECT_EXIT(film.assign({3, 0, 2, 2}, pixels), testing::KilledBySignal(SIGABRT), "");
}

}  // namespace
}  // namespace preheat
