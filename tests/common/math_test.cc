#include "common/math.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace preheat {
namespace {

constexpr std::uint64_t kSeed = 7;

// Error in units of the last place of `exact` as a double.
double ulps(double value, double exact) {
  const double spacing = std::nextafter(std::abs(exact), INFINITY) - std::abs(exact);
  return std::abs(value - exact) / spacing;
}

TEST(Math, SinAndCosOfTurnsStayWithinThreeFloatRoundings) {
  std::mt19937 random(kSeed);
  std::uniform_real_distribution<float> unit(0.0F, 1.0F);
  double error_max = 0.0;
  for (int i = 0; i < 1000000; ++i) {
    const float turns = i < 9 ? static_cast<float>(i) / 8.0F : unit(random);
    const SinCos got = sin_cos_turns(turns);
    const double angle = 2.0 * kPiDouble * static_cast<double>(turns);
    error_max = std::max({error_max, std::abs(static_cast<double>(got.sin) - std::sin(angle)),
                          std::abs(static_cast<double>(got.cos) - std::cos(angle))});
  }
  EXPECT_LE(error_max, 3.0 * 0x1p-24) << "seed " << kSeed;
}

TEST(Math, DoubleFunctionsAgreeWithTheLibrary) {
  std::mt19937_64 random(kSeed);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  for (int i = 0; i < 300000; ++i) {
    const double angle = unit(random) * (i % 2 == 0 ? 4.0 : 1e4);
    ASSERT_NEAR(sin_of(angle), std::sin(angle), 2e-16 + 1e-16 * std::abs(angle)) << angle;
    ASSERT_NEAR(cos_of(angle), std::cos(angle), 2e-16 + 1e-16 * std::abs(angle)) << angle;
    const double power = unit(random) * (i % 2 == 0 ? 2.0 : 700.0);
    ASSERT_LE(ulps(exp_of(power), std::exp(power)), 1.5) << power;
    const double positive = std::exp(power);
    ASSERT_LE(ulps(log_of(positive), std::log(positive)), 1.5) << positive;
    const double base = std::abs(unit(random)) + 1e-9;
    ASSERT_NEAR(pow_of(base, 1.0 / 2.4) / std::pow(base, 1.0 / 2.4), 1.0, 5e-15) << base;
  }
}

TEST(Math, DoubleFunctionsAreDefinedAtTheirEnds) {
  const double infinity = std::numeric_limits<double>::infinity();

  EXPECT_EQ(exp_of(0.0), 1.0);
  EXPECT_EQ(exp_of(-infinity), 0.0);
  EXPECT_EQ(exp_of(infinity), infinity);
  EXPECT_TRUE(std::isnan(exp_of(std::nan(""))));
  EXPECT_EQ(log_of(1.0), 0.0);
  EXPECT_EQ(log_of(0.0), -infinity);
  EXPECT_EQ(log_of(infinity), infinity);
  EXPECT_TRUE(std::isnan(log_of(-1.0)));
  EXPECT_EQ(pow_of(0.0, 0.0), 1.0);
  EXPECT_EQ(pow_of(0.0, 2.0), 0.0);
  EXPECT_EQ(pow_of(1.0, 123.0), 1.0);
}

TEST(Math, NeighboursOfFloatsAreThoseOfTheLibrary) {
  for (const float value : {1.0F, -1.0F, 0.999999F, 3e-20F, -5e10F}) {
    EXPECT_EQ(next_float_towards(value, 2.0F), std::nextafter(value, INFINITY));
    EXPECT_EQ(next_float_towards(value, -0.5F), std::nextafter(value, -INFINITY));
    EXPECT_EQ(next_float_towards(value, 0.0F), value);
  }
  EXPECT_GT(next_float_towards(0.0F, 1.0F), 0.0F);
  EXPECT_LT(next_float_towards(0.0F, -1.0F), 0.0F);
}

TEST(Math, FramesAreOrthonormalAndRightHanded) {
  std::mt19937 random(kSeed);
  std::normal_distribution<float> normal;
  for (int i = 0; i < 100000; ++i) {
    Vec3 axis(normal(random), normal(random), normal(random));
    if (i < 6) {
      axis = Vec3(0.0F);
      axis[i / 2] = i % 2 == 0 ? 1.0F : -1.0F;
    }
    const Vec3 n = glm::normalize(axis);
    const OrthonormalFrame frame(n);
    ASSERT_NEAR(glm::dot(frame.tangent, frame.bitangent), 0.0F, 1e-6F);
    ASSERT_NEAR(glm::dot(frame.tangent, n), 0.0F, 1e-6F);
    ASSERT_NEAR(glm::length(frame.tangent), 1.0F, 1e-6F);
    ASSERT_NEAR(glm::dot(glm::cross(frame.tangent, frame.bitangent), n), 1.0F, 1e-6F);
    const Vec3 v(0.3F, -0.7F, 0.2F);
    ASSERT_NEAR(glm::length(frame.scene_from_local(frame.local_from_scene(v)) - v), 0.0F, 1e-6F);
  }
}

TEST(Math, DiskIsCoveredUniformly) {
  constexpr int kSide = 512;
  int inner = 0;
  int right = 0;
  double cos_sum = 0.0;
  for (int i = 0; i < kSide * kSide; ++i) {
    const float u = (static_cast<float>(i % kSide) + 0.5F) / kSide;
    const float v = (static_cast<float>(i / kSide) + 0.5F) / kSide;
    const DiskPoint point = disk_from_square(u, v);
    const float radius_squared = point.x * point.x + point.y * point.y;
    ASSERT_LE(radius_squared, 1.0F + 1e-6F);
    inner += radius_squared < 0.25F ? 1 : 0;
    right += point.x > 0.0F && point.y > 0.0F ? 1 : 0;
    cos_sum += static_cast<double>(cosine_direction(u, v).z);
  }
  EXPECT_NEAR(inner, kSide * kSide / 4, kSide);
  EXPECT_NEAR(right, kSide * kSide / 4, kSide);
  EXPECT_NEAR(cos_sum / (kSide * kSide), 2.0 / 3.0, 1e-4);
}

}  // namespace
}  // namespace preheat
