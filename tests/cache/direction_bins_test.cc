#include "cache/direction_bins.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "common/math.h"

namespace preheat {
namespace {

constexpr unsigned kSeed = 23;

Vec3d random_direction(std::mt19937_64& random) {
  std::normal_distribution<double> normal;
  return {normal(random), normal(random), normal(random)};
}

// The bin by its definition: angles from the arc functions.
std::uint32_t bin_by_angles(const DirectionBins& bins, const Vec3d& direction) {
  const Vec3d d = glm::normalize(direction);
  const double polar = std::acos(std::clamp(d.z, -1.0, 1.0));
  double azimuth = std::atan2(d.y, d.x);
  if (azimuth < 0.0) { azimuth += 2.0 * kPiDouble; }
  const auto row =
      std::min(bins.polar() - 1, static_cast<unsigned>(polar / kPiDouble * bins.polar()));
  const auto column = std::min(bins.azimuth() - 1,
                               static_cast<unsigned>(azimuth / (2.0 * kPiDouble) * bins.azimuth()));
  return row * bins.azimuth() + column;
}

TEST(DirectionBins, HoldEachDirectionInTheBinOfItsAngles) {
  SCOPED_TRACE(kSeed);
  for (const auto& [polar, azimuth] :
       {std::pair{6U, 12U}, {1U, 1U}, {5U, 7U}, {64U, 128U}, {2U, 3U}}) {
    const DirectionBins bins(polar, azimuth);
    std::mt19937_64 random(kSeed);
    std::vector<int> counts(bins.size(), 0);
    std::size_t elsewhere = 0;
    for (int i = 0; i < 200'000; ++i) {
      const Vec3d direction = random_direction(random);
      const auto bin = bins.bin_of(direction);
      ASSERT_TRUE(bin);
      ASSERT_LT(*bin, bins.size());
      ++counts[*bin];
      elsewhere += *bin != bin_by_angles(bins, direction) ? 1U : 0U;
    }
    EXPECT_LE(elsewhere, 2U) << "on a border, up to rounding";
    for (std::uint32_t bin = 0; bin < bins.size(); ++bin) {
      const double expected = 200'000.0 * bins.solid_angle(bin) / (4.0 * kPiDouble);
      EXPECT_NEAR(counts[bin], expected, 6.0 * std::sqrt(expected) + 6.0);
    }
  }
}

// The 26 directions of the lattice with every sign of their zeros.
TEST(DirectionBins, DoNotSeeTheSignOfZero) {
  for (const auto& [polar, azimuth] : {std::pair{6U, 12U}, {5U, 7U}, {1U, 1U}, {4U, 8U}}) {
    const DirectionBins bins(polar, azimuth);
    for (int x = -1; x <= 1; ++x) {
      for (int y = -1; y <= 1; ++y) {
        for (int z = -1; z <= 1; ++z) {
          const auto bin = bins.bin_of(Vec3d(x, y, z));
          ASSERT_EQ(bin.has_value(), x != 0 || y != 0 || z != 0);
          for (unsigned signs = 0; signs < 8; ++signs) {
            const Vec3d other(x != 0              ? x
                              : (signs & 1U) != 0 ? -0.0
                                                  : 0.0,
                              y != 0              ? y
                              : (signs & 2U) != 0 ? -0.0
                                                  : 0.0,
                              z != 0              ? z
                              : (signs & 4U) != 0 ? -0.0
                                                  : 0.0);
            EXPECT_EQ(bins.bin_of(other), bin) << x << y << z << " signs " << signs;
          }
        }
      }
    }
  }
}

TEST(DirectionBins, HaveTheirPolesInTheFirstColumnAndWrapAround) {
  const DirectionBins bins(6, 12);
  EXPECT_EQ(bins.bin_of({0, 0, 1}), 0U);
  EXPECT_EQ(bins.bin_of({0, 0, -1}), 60U);
  EXPECT_EQ(bins.bin_of({1, 0, 0.5}), 24U) << "azimuth 0";
  EXPECT_EQ(bins.bin_of({1, 1e-300, 0.5}), 24U);
  EXPECT_EQ(bins.bin_of({1, -1e-300, 0.5}), 35U) << "the last column, not one beyond";
  EXPECT_EQ(bins.bin_of({-1, 1e-300, 0.5}), 29U) << "just below pi";
  EXPECT_EQ(bins.bin_of({-1, 0, 0.5}), 30U) << "pi";
}

TEST(DirectionBins, TakeVectorsOfAnyLengthButNothingThatIsNone) {
  const DirectionBins bins(6, 12);
  const Vec3d direction(0.3, -0.5, 0.7);
  for (const double length : {1e-300, 1e-160, 1.0, 1.0000001, 1e160, 1e300}) {
    EXPECT_EQ(bins.bin_of(direction * length), bins.bin_of(direction)) << length;
  }
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  constexpr double kInf = std::numeric_limits<double>::infinity();
  for (const double bad : {kNan, kInf, -kInf}) {
    EXPECT_FALSE(bins.bin_of({bad, 0, 0}));
    EXPECT_FALSE(bins.bin_of({0, bad, 1}));
    EXPECT_FALSE(bins.bin_of({1, 1, bad}));
  }
}

TEST(DirectionBins, CoverTheSphereOnce) {
  for (const auto& [polar, azimuth] : {std::pair{6U, 12U}, {1U, 1U}, {5U, 7U}, {64U, 128U}}) {
    const DirectionBins bins(polar, azimuth);
    double sum = 0.0;
    Vec3d flux(0.0);
    for (std::uint32_t bin = 0; bin < bins.size(); ++bin) {
      EXPECT_GT(bins.solid_angle(bin), 0.0);
      sum += bins.solid_angle(bin);
      flux += bins.flux(bin);
    }
    EXPECT_NEAR(sum, 4.0 * kPiDouble, 1e-12);
    EXPECT_NEAR(glm::length(flux), 0.0, 1e-12);
  }
}

// Of a cosine lobe around an axis, whose bins lie wholly on one side.
TEST(DirectionBins, HaveTheFluxOfACosineLobe) {
  const DirectionBins bins(6, 12);
  for (const Vec3d& normal : {Vec3d(0, 0, 1), Vec3d(0, 0, -1), Vec3d(1, 0, 0), Vec3d(0, -1, 0)}) {
    double sum = 0.0;
    for (std::uint32_t bin = 0; bin < bins.size(); ++bin) {
      sum += std::max(0.0, glm::dot(normal, bins.flux(bin)));
    }
    EXPECT_NEAR(sum, kPiDouble, 1e-12);
  }
}

TEST(DirectionBins, AreSymmetricUnderQuarterTurnsAndMirroring) {
  SCOPED_TRACE(kSeed);
  const DirectionBins bins(6, 12);
  std::mt19937_64 random(kSeed);
  std::uniform_int_distribution<int> lattice(-6, 6);
  for (int i = 0; i < 100'000; ++i) {
    // Half of them on a lattice, where borders are hit.
    const Vec3d d = i % 2 == 0 ? random_direction(random)
                               : Vec3d(lattice(random), lattice(random), lattice(random));
    const auto bin = bins.bin_of(d);
    if (!bin) { continue; }
    const unsigned row = *bin / 12;
    const unsigned column = *bin % 12;
    if (d.x != 0.0 || d.y != 0.0) {  // a pole turns into itself
      EXPECT_EQ(bins.bin_of({-d.y, d.x, d.z}), row * 12 + (column + 3) % 12);
      EXPECT_EQ(bins.bin_of({-d.x, -d.y, d.z}), row * 12 + (column + 6) % 12);
    }
    if (d.z != 0.0) { EXPECT_EQ(bins.bin_of({d.x, d.y, -d.z}), (5 - row) * 12 + column); }
  }
}

// ---- boxes ----

double hit_share(const DirectionBins& bins, std::uint32_t bin, const Vec3d& from, const Aabb& box,
                 std::mt19937_64& random) {
  int hits = 0;
  int count = 0;
  while (count < 4000) {
    const double polar = kPiDouble / bins.polar();
    const double azimuth = 2.0 * kPiDouble / bins.azimuth();
    std::uniform_real_distribution<double> unit;
    const double upper = std::cos(polar * (bin / bins.azimuth()));
    const double lower = std::cos(polar * (bin / bins.azimuth() + 1));
    const double z = lower + (upper - lower) * unit(random);
    const double phi = azimuth * (bin % bins.azimuth() + unit(random));
    const double r = std::sqrt(1.0 - z * z);
    const Vec3d d(r * std::cos(phi), r * std::sin(phi), z);
    double enter = 0.0;
    double exit = 1e300;
    for (int axis = 0; axis < 3; ++axis) {
      const double a = (static_cast<double>(box.low[axis]) - from[axis]) / d[axis];
      const double b = (static_cast<double>(box.high[axis]) - from[axis]) / d[axis];
      enter = std::max(enter, std::min(a, b));
      exit = std::min(exit, std::max(a, b));
    }
    hits += enter <= exit ? 1 : 0;
    ++count;
  }
  return static_cast<double>(hits) / count;
}

TEST(BoxInBins, CoversTheShareOfEachBinThatRaysFind) {
  SCOPED_TRACE(kSeed);
  std::mt19937_64 random(kSeed);
  std::uniform_real_distribution<float> unit(-1.0F, 1.0F);
  for (const auto& [polar, azimuth] : {std::pair{6U, 12U}, {3U, 5U}}) {
    const DirectionBins bins(polar, azimuth);
    BoxInBins look(bins);
    for (int i = 0; i < 30; ++i) {
      const Vec3 low(unit(random), unit(random), unit(random));
      const Aabb box{low, low + Vec3(0.5F + 0.4F * unit(random))};
      const Vec3d from(unit(random) * 2.0F, unit(random) * 2.0F, unit(random) * 2.0F);
      std::vector<double> share(bins.size(), 0.0);
      double solid_angle = 0.0;
      for (const auto& [bin, weight] : look.look(from, box)) {
        EXPECT_EQ(share[bin], 0.0) << "a bin comes once";
        share[bin] = weight;
        solid_angle += weight * bins.solid_angle(bin);
      }
      double expected_solid_angle = 0.0;
      for (std::uint32_t bin = 0; bin < bins.size(); ++bin) {
        const double expected = hit_share(bins, bin, from, box, random);
        expected_solid_angle += expected * bins.solid_angle(bin);
        // A patch goes to one bin as a whole.
        EXPECT_NEAR(share[bin], expected, 0.4) << bin;
      }
      EXPECT_NEAR(solid_angle, expected_solid_angle, 0.06 * expected_solid_angle + 0.01);
    }
  }
}

TEST(BoxInBins, NeverWeighsMoreThanAllOfABin) {
  SCOPED_TRACE(kSeed);
  const DirectionBins bins(6, 12);
  BoxInBins look(bins);
  const Aabb box{Vec3(0.0F), Vec3(1.0F)};
  std::mt19937_64 random(kSeed);
  std::uniform_real_distribution<double> unit(-0.2, 1.2);
  for (const double distance : {0.0, 1e-300, 1e-12, 1e-6, 1e-3, 0.1, 10.0, 1e6, 1e12}) {
    for (int i = 0; i < 50; ++i) {
      const Vec3d from(-distance, unit(random), unit(random));
      for (const auto& [bin, weight] : look.look(from, box)) {
        ASSERT_GE(weight, 0.0);
        ASSERT_LE(weight, 1.0);
      }
    }
  }
}

TEST(BoxInBins, CoversEverythingFromInsideAndNothingOfABoxWithoutExtent) {
  const DirectionBins bins(6, 12);
  BoxInBins look(bins);
  const Aabb box{Vec3(0.0F), Vec3(1.0F)};
  for (const Vec3d& inside : {Vec3d(0.5), Vec3d(0.0), Vec3d(1.0, 0.5, 0.5)}) {
    const auto shares = look.look(inside, box);
    ASSERT_EQ(shares.size(), bins.size());
    for (const auto& [bin, weight] : shares) { EXPECT_DOUBLE_EQ(weight, 1.0); }
  }
  for (const auto& [bin, weight] : look.look(Vec3d(2.0), {Vec3(0.5F), Vec3(0.5F)})) {
    EXPECT_EQ(weight, 0.0);
  }
}

}  // namespace
}  // namespace preheat
