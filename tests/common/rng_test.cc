#include "common/rng.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <vector>

namespace preheat {
namespace {

// Every aligned run of 2^k samples has one point in each of the 2^k boxes of every shape 2^-a by
// 2^-(k-a): that the pair is a (0,2)-sequence, which plain random numbers are not.
TEST(Rng, AlignedRunsFillEveryElementaryInterval) {
  for (const std::uint64_t seed : {0ULL, 1ULL, 0xFFFFFFFFFFFFFFFFULL}) {
    const Rng rng(seed);
    for (const std::uint32_t pixel : {0U, 12345U}) {
      for (unsigned k = 0; k <= 10; ++k) {
        const std::uint32_t count = 1U << k;
        for (unsigned a = 0; a <= k; ++a) {
          std::vector<int> boxes(count);
          for (std::uint32_t i = 0; i < count; ++i) {
            const RandomPair pair = rng.pair(pixel, 3 * 1024 + i, 2, Dimension::kDirection);
            const std::uint64_t x = static_cast<std::uint64_t>(pair.x_bits) >> (32 - a);
            const std::uint64_t y = static_cast<std::uint64_t>(pair.y_bits) >> (32 - (k - a));
            ++boxes[static_cast<std::size_t>((x << (k - a)) | y)];
          }
          ASSERT_EQ(*std::max_element(boxes.begin(), boxes.end()), 1)
              << "seed " << seed << " k " << k << " a " << a;
        }
      }
    }
  }
}

TEST(Rng, NumbersAreBelowOne) {
  EXPECT_LT((RandomPair{0xFFFFFFFFU, 0xFFFFFFFFU}).x(), 1.0F);
  EXPECT_EQ((RandomPair{0U, 0U}).y(), 0.0F);
}

// Neighbouring pixels, bounces, dimensions and seeds must not follow each other.
TEST(Rng, DifferentNamesAreUncorrelated) {
  constexpr std::uint32_t kCount = 4096;
  const Rng rng(0);
  const Rng other_seed(1);
  struct Case {
    const char* name;
    RandomPair (*draw)(const Rng&, const Rng&, std::uint32_t);
  };
  const std::vector<Case> cases{{"pixel",
                                 [](const Rng& r, const Rng&, std::uint32_t i) {
                                   return RandomPair{r.pair(i, 0, 0, Dimension::kLight).x_bits,
                                                     r.pair(i + 1, 0, 0, Dimension::kLight).x_bits};
                                 }},
                                {"bounce",
                                 [](const Rng& r, const Rng&, std::uint32_t i) {
                                   return RandomPair{r.pair(5, i, 0, Dimension::kLight).x_bits,
                                                     r.pair(5, i, 1, Dimension::kLight).x_bits};
                                 }},
                                {"dimension",
                                 [](const Rng& r, const Rng&, std::uint32_t i) {
                                   return RandomPair{r.pair(5, i, 0, Dimension::kLight).y_bits,
                                                     r.pair(5, i, 0, Dimension::kDirection).x_bits};
                                 }},
                                {"seed",
                                 [](const Rng& r, const Rng& s, std::uint32_t i) {
                                   return RandomPair{r.pair(i, 7, 0, Dimension::kLight).y_bits,
                                                     s.pair(i, 7, 0, Dimension::kLight).y_bits};
                                 }},
                                {"coordinates", [](const Rng& r, const Rng&, std::uint32_t i) {
                                   return r.pair(i, 7, 0, Dimension::kLight);
                                 }}};

  for (const Case& c : cases) {
    // Chi-square over 8 x 8 cells, 63 degrees of freedom: above 125 by chance once in 10^5.
    std::vector<double> cells(64);
    for (std::uint32_t i = 0; i < kCount; ++i) {
      const RandomPair pair = c.draw(rng, other_seed, i);
      cells[(pair.x_bits >> 29U) * 8 + (pair.y_bits >> 29U)] += 1.0;
    }
    double chi_square = 0.0;
    for (const double cell : cells) { chi_square += (cell - 64.0) * (cell - 64.0) / 64.0; }
    EXPECT_LT(chi_square, 125.0) << c.name;
  }
}

TEST(Rng, FillsLowBitsToo) {
  const Rng rng(3);
  std::uint32_t ones = 0;
  for (std::uint32_t i = 0; i < 4096; ++i) {
    ones += rng.pair(i, 0, 0, Dimension::kLight).x_bits & 1U;
    ones += rng.pair(i, 0, 0, Dimension::kLight).y_bits & 1U;
  }
  EXPECT_NEAR(ones, 4096, 5.0 * std::sqrt(8192.0 / 4.0));
}

// The numbers are part of the image: the same on every machine and in every build.
TEST(Rng, NumbersAreTheSameEverywhere) {
  std::uint64_t digest = 0;
  for (std::uint32_t i = 0; i < 10000; ++i) {
    const RandomPair pair = Rng(i % 3).pair(i * 7919U, i, i % 65, static_cast<Dimension>(i % 5));
    digest = std::rotl(digest, 7) * 0x9E3779B97F4A7C15ULL + pair.x_bits;
    digest = std::rotl(digest, 7) * 0x9E3779B97F4A7C15ULL + pair.y_bits;
  }
  EXPECT_EQ(digest, 16067429962677545613ULL);
}

}  // namespace
}  // namespace preheat
