#include "common/blocking.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "tests/scenes/soups.h"

namespace preheat {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

void expect_relative(double value, double expected, double error) {
  EXPECT_NEAR(value, expected, error * std::abs(expected));
}

TEST(PassProbability, OfACellThatBlocksNothingIsExactlyOne) {
  for (const double cells : {0.0, 1.0, 3.7, 1e9, 0x1p1000}) {
    EXPECT_EQ(pass_probability(0.0, cells), 1.0);
    EXPECT_EQ(stop_probability(0.0, cells), 0.0);
  }
}

TEST(PassProbability, OfACellThatBlocksAllIsZeroUnlessThereIsNoCell) {
  EXPECT_EQ(pass_probability(1.0, 0.0), 1.0);
  EXPECT_EQ(stop_probability(1.0, 0.0), 0.0);
  for (const double cells : {0.5, 1.0, 2.0, 1e9, 0x1p1000}) {
    EXPECT_EQ(pass_probability(1.0, cells), 0.0);
    EXPECT_EQ(stop_probability(1.0, cells), 1.0);
  }
}

struct Power {
  double p;
  int depth;
  double passed;   // (1-p)^(2^depth), computed with 60 digits
  double stopped;  // 1 - passed
};

class PassProbabilityOfSubtree : public ::testing::TestWithParam<Power> {};

TEST_P(PassProbabilityOfSubtree, KeepsTheDigitsThatThePlainPowerLoses) {
  const auto& [p, depth, passed, stopped] = GetParam();
  const double cells = std::ldexp(1.0, depth);

  expect_relative(pass_probability(p, cells), passed, 1e-12);
  expect_relative(stop_probability(p, cells), stopped, 1e-12);
  EXPECT_EQ(pass_probability(p, cells), std::exp(std::ldexp(std::log1p(-p), depth)));
  const float naive = std::pow(1.0F - static_cast<float>(p), std::ldexp(1.0F, depth));
  EXPECT_GT(std::abs(static_cast<double>(naive) - passed), 5e-4 * passed);
}

INSTANTIATE_TEST_SUITE_P(
    Section2, PassProbabilityOfSubtree,
    ::testing::Values(Power{1e-8, 30, 2.1716932683877478365e-5, 0.99997828306731612252},
                      Power{1e-9, 30, 0.34172743801377496997, 0.65827256198622503003},
                      Power{1e-7, 30, 2.3333653973417363808e-47, 1.0},
                      Power{1e-6, 16, 0.93656529911146072632, 0.063434700888539273682}));

TEST(PassProbability, GoesToZeroHoweverDeepTheTree) {
  for (int depth = 0; depth <= 1000; ++depth) {
    const double passed = pass_probability(1e-3, std::ldexp(1.0, depth));
    EXPECT_GE(passed, 0.0);
    if (depth >= 20) { EXPECT_EQ(passed, 0.0) << depth; }
  }
}

TEST(PassProbability, TakesAnythingForAProbability) {
  EXPECT_EQ(pass_probability(-1e-9, 10.0), 1.0);
  EXPECT_EQ(pass_probability(1.0 + 1e-9, 10.0), 0.0);
  EXPECT_EQ(pass_probability(kNan, 10.0), 1.0);
  EXPECT_EQ(pass_probability(0.5, -1.0), 1.0);
}

// The sum of [P] section 2 term by term, in extended precision, of as many cells as double says.
double traversal_cost_by_terms(double depth_mean, double blocking) {
  const long double p = blocking;
  const long double cells = std::exp2(depth_mean);
  const long double part = cells - std::floor(cells);
  long double sum = 0.0L;
  for (long double i = std::floor(cells); i >= 1.0L; --i) {
    sum += i * p * std::exp((i - 1.0L) * std::log1p(-p));
  }
  sum += cells * part * p * std::exp(part * std::log1p(-p));
  return static_cast<double>(sum + cells * std::exp(cells * std::log1p(-p)));
}

TEST(TraversalCost, OfAnyDepthIsThePapersSumToTwelveDigits) {
  for (const double depth : {0.0, 0.3, 1.0, 2.7, 5.0, 9.99, 14.2}) {
    for (const double p : {1e-300, 1e-12, 1e-7, 3e-5, 1e-3, 0.03, 0.2, 0.5, 0.9, 0.999999}) {
      SCOPED_TRACE(testing::Message() << "depth " << depth << " p " << p);
      expect_relative(traversal_cost(depth, p), traversal_cost_by_terms(depth, p), 1e-12);
    }
  }
}

// Where the closed form takes over from the series: n p = 1/4.
TEST(TraversalCost, HasNoStepWhereItsFormulaChanges) {
  for (const double depth : {4.0, 10.0, 14.0}) {
    const double border = 0.25 / std::exp2(depth);
    for (const double p : {border * (1.0 - 1e-9), border * (1.0 + 1e-9)}) {
      expect_relative(traversal_cost(depth, p), traversal_cost_by_terms(depth, p), 1e-12);
    }
  }
}

TEST(TraversalCost, OfAnEndlessPathIsTheMeanDistanceToABlocker) {
  expect_relative(traversal_cost(1000.0, 0.5), 2.0, 1e-12);
  expect_relative(traversal_cost(60.0, 1e-6), 1e6, 1e-12);
  expect_relative(traversal_cost(40.0, 0.0), 0x1p40, 1e-15);
  EXPECT_TRUE(std::isfinite(traversal_cost(1000.0, 1e-301)));
  EXPECT_TRUE(std::isfinite(traversal_cost(kNan, kNan)));
}

Aabb box(const Vec3& low, const Vec3& high) { return {low, high}; }

TEST(BlockingFactor, IsTheSumOverTheObjectsBoxes) {
  BlockingFactor blocking(box(Vec3(0.0F), Vec3(1.0F)));
  EXPECT_EQ(blocking.sum(), 0.0);

  blocking.add(box({0.0F, 0.0F, 0.5F}, {1.0F, 0.5F, 0.5F}));  // a plate of half a face
  EXPECT_DOUBLE_EQ(blocking.sum(), 0.5 / 3.0);

  blocking.add(box({-5.0F, 0.0F, 0.0F}, {0.5F, 1.0F, 1.0F}));  // half of it lies in the cell
  EXPECT_DOUBLE_EQ(blocking.sum(), 0.5 / 3.0 + 2.0 / 3.0);
}

TEST(BlockingFactor, IsAProbabilityHoweverManyBoxesHideOneAnother) {
  constexpr std::uint32_t kSeed = 11;
  SCOPED_TRACE(kSeed);
  test::SoupRandom random(kSeed);
  std::size_t above_one = 0;
  for (int cell = 0; cell < 2000; ++cell) {
    const Vec3 low = random.in_cube(-1.0F, 0.0F);
    BlockingFactor blocking(box(low, low + random.in_cube(0.0F, 1.0F)));
    double before = 0.0;
    for (int triangle = 0; triangle < 50; ++triangle) {
      const Vec3 corner = random.in_cube(-1.2F, 1.0F);
      blocking.add(box(corner, corner + random.in_cube(0.0F, random.in(0.0F, 1.0F))));
      ASSERT_GE(blocking.probability(), before) << "a triangle made the cell block less";
      ASSERT_LE(blocking.probability(), 1.0);
      ASSERT_GE(pass_probability(blocking.probability(), 8.0), 0.0);
      before = blocking.probability();
    }
    if (blocking.sum() > 1.0) {
      ++above_one;
      EXPECT_EQ(blocking.probability(), 1.0);
    }
  }
  EXPECT_GT(above_one, 100U);
}

TEST(BlockingFactor, OfACellWithoutSurfaceIsAllOrNothing) {
  const Aabb point = box(Vec3(0.5F), Vec3(0.5F));
  BlockingFactor blocking(point);
  EXPECT_EQ(blocking.probability(), 0.0);
  blocking.add(box(Vec3(0.6F), Vec3(1.0F)));
  EXPECT_EQ(blocking.probability(), 0.0) << "a box beside the cell";
  blocking.add(box(Vec3(0.0F), Vec3(1.0F)));
  EXPECT_EQ(blocking.probability(), 1.0);

  BlockingFactor plane(box(Vec3(0.0F), {1.0F, 1.0F, 0.0F}));
  plane.add(box(Vec3(0.0F), {0.5F, 1.0F, 0.0F}));
  EXPECT_DOUBLE_EQ(plane.probability(), 0.5);
}

TEST(BlockingFactor, CountsWhatIsNoBoxAsNothing) {
  constexpr float kFloatNan = std::numeric_limits<float>::quiet_NaN();
  BlockingFactor blocking(box(Vec3(0.0F), Vec3(1.0F)));
  blocking.add(Aabb{});
  blocking.add(box({2.0F, 0.0F, 0.0F}, {3.0F, 0.0F, 1.0F}));
  EXPECT_EQ(blocking.probability(), 0.0);
  BlockingFactor odd(box(Vec3(0.0F), {kFloatNan, 1.0F, 1.0F}));
  odd.add(box(Vec3(0.0F), Vec3(1.0F)));
  EXPECT_GE(odd.probability(), 0.0);
  EXPECT_LE(odd.probability(), 1.0);
}

}  // namespace
}  // namespace preheat
