#include "common/bsdf.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <string>
#include <vector>

#include "common/math.h"

namespace preheat {
namespace {

constexpr std::uint64_t kSeed = 99;
constexpr int kAngles = 32;

struct Case {
  std::string name;
  Material material;
  bool front = true;
  double albedo_min = 0.0;  // of a white one, at every angle
};

Material white(float metallic, float roughness) {
  Material material;
  material.base_color = Vec3(1.0F);
  material.metallic = metallic;
  material.roughness = roughness;
  return material;
}

Material lambert(float albedo) {
  Material material;
  material.base_color = Vec3(albedo);
  material.specular_color = Vec3(0.0F);
  return material;
}

Material glass(float ior, float roughness, bool thin) {
  Material material = white(0.0F, roughness);
  material.transmission = 1.0F;
  material.ior = ior;
  material.thin_walled = thin;
  return material;
}

Material mixture() {
  Material material = white(0.3F, 0.4F);
  material.transmission = 0.5F;
  material.thin_walled = false;
  return material;
}

std::vector<Case> cases() {
  return {{"lambert", lambert(1.0F), true, 1.0},
          {"coat_mirror", white(0.0F, 0.0F), true, 1.0},
          {"coat_glossy", white(0.0F, 0.25F), true, 1.0},
          {"coat_rough", white(0.0F, 1.0F), true, 1.0},
          {"metal_mirror", white(1.0F, 0.0F), true, 1.0},
          {"metal_polished", white(1.0F, 0.2F), true, 1.0},
          {"metal_glossy", white(1.0F, 0.3F), true, 1.0},
          {"metal_rough", white(1.0F, 0.8F), true, 1.0},
          {"half_metal", white(0.5F, 0.5F), true, 1.0},
          {"sheet", glass(1.5F, 0.0F, true), true, 1.0},
          {"sheet_rough", glass(1.5F, 0.5F, true), true, 0.7},
          {"solid_outside", glass(1.5F, 0.0F, false), true, 0.0},
          {"solid_rough_outside", glass(1.5F, 0.4F, false), true, 0.0},
          {"solid_rough_inside", glass(1.5F, 0.4F, false), false, 0.0},
          {"diamond_rough_outside", glass(2.4F, 0.3F, false), true, 0.0},
          {"mixture", mixture(), true, 0.0}};
}

class EveryBsdf : public testing::TestWithParam<Case> {
 protected:
  [[nodiscard]] PreparedMaterial prepared() const {
    return prepare_materials(std::vector<Material>{GetParam().material}).front();
  }
};

INSTANTIATE_TEST_SUITE_P(Materials, EveryBsdf, testing::ValuesIn(cases()),
                         [](const auto& each) { return each.param.name; });

Vec3 direction(double cos_polar, double azimuth) {
  const double sin_polar = std::sqrt(std::max(0.0, 1.0 - cos_polar * cos_polar));
  return {static_cast<float>(sin_polar * std::cos(azimuth)),
          static_cast<float>(sin_polar * std::sin(azimuth)), static_cast<float>(cos_polar)};
}

RandomPair pair_of(double u, double v) {
  return {static_cast<std::uint32_t>(u * 0x1p32), static_cast<std::uint32_t>(v * 0x1p32)};
}

// Evenly spread in the unit cube (additive recurrence by powers of 1 / 1.2207, M. Roberts).
struct CubePoint {
  double lobe;
  double u;
  double v;
};

CubePoint cube_point(int index) {
  const auto fraction = [&](double step) {
    const double x = 0.5 + step * index;
    return x - std::floor(x);
  };
  return {fraction(0.8191725133961645), fraction(0.6710436067037893), fraction(0.5497004779019703)};
}

BsdfSample sample_at(const Bsdf& bsdf, const CubePoint& point) {
  return bsdf.sample(static_cast<float>(point.lobe) * 0.99999994F, pair_of(point.u, point.v));
}

// Radiance inside a solid of index n is n^2 times that outside; in basic radiance L / n^2 a surface
// conserves energy on both sides.
double basic_weight(const BsdfSample& sample, const Case& c) {
  const bool crosses = sample.direction.z < 0.0F && !c.material.thin_walled;
  const double n2 = static_cast<double>(c.material.ior) * static_cast<double>(c.material.ior);
  const double scale = !crosses ? 1.0 : (c.front ? n2 : 1.0 / n2);
  return scale * static_cast<double>(mean_component(sample.weight));
}

// Within a thousandth and 4 standard errors.
TEST_P(EveryBsdf, ReflectsNoMoreThanItReceives) {
  const PreparedMaterial material = prepared();
  std::mt19937_64 random(kSeed);
  std::uniform_real_distribution<double> unit(0.0, 1.0);
  constexpr int kCount = 10000;
  for (int angle = 0; angle < kAngles; ++angle) {
    const double cos_out = (angle + 0.5) / kAngles;
    const Bsdf bsdf(material, direction(cos_out, 0.3), GetParam().front);
    double sum = 0.0;
    double sum_of_squares = 0.0;
    for (int i = 0; i < kCount; ++i) {
      const BsdfSample sample = sample_at(bsdf, {unit(random), unit(random), unit(random)});
      if (sample.direction == Vec3(0.0F)) { continue; }
      const double weight = basic_weight(sample, GetParam());
      sum += weight;
      sum_of_squares += weight * weight;
    }
    const double albedo = sum / kCount;
    const double error =
        std::sqrt(std::max(0.0, sum_of_squares / kCount - albedo * albedo) / kCount);
    EXPECT_LE(albedo, 1.0 + 1e-3 + 4.0 * error) << "cos " << cos_out << " seed " << kSeed;
    EXPECT_GE(albedo, GetParam().albedo_min - 1e-3 - 4.0 * error)
        << "cos " << cos_out << " seed " << kSeed;
    EXPECT_LE(error, angle < 4 ? 0.03 : 0.007);
  }
}

// The density integrates to what is not lost to directions below the surface.
TEST_P(EveryBsdf, DensityIntegratesToOne) {
  const PreparedMaterial material = prepared();
  constexpr int kCosines = 1200;
  constexpr int kAzimuths = 300;
  for (const double cos_out : {0.9, 0.35}) {
    const Bsdf bsdf(material, direction(cos_out, 0.0), GetParam().front);
    double integral = 0.0;
    for (int i = 0; i < kCosines; ++i) {
      const double cos_in = -1.0 + 2.0 * (i + 0.5) / kCosines;
      for (int j = 0; j < kAzimuths; ++j) {
        const Vec3 in = direction(cos_in, kPiDouble * (j + 0.5) / kAzimuths);
        integral += static_cast<double>(bsdf.evaluate(in).pdf_solid_angle);
      }
    }
    integral *= 4.0 * kPiDouble / (kCosines * kAzimuths);

    constexpr int kCount = 50000;
    int scattered = 0;
    for (int i = 0; i < kCount; ++i) {
      scattered += sample_at(bsdf, cube_point(i)).pdf_solid_angle > 0.0F ? 1 : 0;
    }
    EXPECT_NEAR(integral, scattered / static_cast<double>(kCount), 3e-3) << "cos " << cos_out;
  }
}

// Wilson and Hilferty's approximation of the chi-square distribution's upper tail, as a normal
// score.
double chi_square_score(double chi_square, double degrees) {
  const double k = 2.0 / (9.0 * degrees);
  return (std::cbrt(chi_square / degrees) - (1.0 - k)) / std::sqrt(k);
}

TEST_P(EveryBsdf, SamplesFollowTheirDensity) {
  const PreparedMaterial material = prepared();
  constexpr int kCosines = 20;
  constexpr int kAzimuths = 16;
  constexpr int kFine = 16;
  constexpr int kSamples = 100000;
  std::mt19937_64 random(kSeed);
  std::uniform_real_distribution<double> unit(0.0, 1.0);
  for (const double cos_out : {0.8, 0.3}) {
    const Bsdf bsdf(material, direction(cos_out, 0.0), GetParam().front);
    std::vector<double> observed(kCosines * kAzimuths);
    for (int i = 0; i < kSamples; ++i) {
      const BsdfSample sample = sample_at(bsdf, {unit(random), unit(random), unit(random)});
      if (!(sample.pdf_solid_angle > 0.0F)) { continue; }
      const double azimuth = std::atan2(static_cast<double>(sample.direction.y),
                                        static_cast<double>(sample.direction.x));
      const auto row =
          static_cast<int>((static_cast<double>(sample.direction.z) + 1.0) / 2.0 * kCosines);
      const auto column = static_cast<int>((azimuth / kPiDouble + 1.0) / 2.0 * kAzimuths);
      const int bin = std::min(row, kCosines - 1) * kAzimuths + std::min(column, kAzimuths - 1);
      observed[static_cast<std::size_t>(bin)] += 1.0;
    }

    double chi_square = 0.0;
    int bins = 0;
    for (int bin = 0; bin < kCosines * kAzimuths; ++bin) {
      double expected = 0.0;
      for (int i = 0; i < kFine * kFine; ++i) {
        const double cos_in = -1.0 + 2.0 * (bin / kAzimuths + (i % kFine + 0.5) / kFine) / kCosines;
        const double azimuth = -kPiDouble + 2.0 * kPiDouble *
                                                (bin % kAzimuths + (i / kFine + 0.5) / kFine) /
                                                kAzimuths;
        expected += static_cast<double>(bsdf.evaluate(direction(cos_in, azimuth)).pdf_solid_angle);
      }
      expected *= 4.0 * kPiDouble / (kCosines * kAzimuths) / (kFine * kFine) * kSamples;
      if (expected < 10.0) { continue; }
      const double difference = observed[static_cast<std::size_t>(bin)] - expected;
      chi_square += difference * difference / expected;
      ++bins;
    }
    // p = 10^-4 over 32 tests is a score of 4.5.
    if (bins > 1) { EXPECT_LT(chi_square_score(chi_square, bins - 1.0), 4.5) << cos_out; }
  }
}

// Light that crosses into a solid of index n scatters by f / n^2 as light that leaves it by f
// (Veach 1997, section 5.2).
TEST_P(EveryBsdf, IsReciprocal) {
  const PreparedMaterial material = prepared();
  const Case& c = GetParam();
  const double n2 = static_cast<double>(c.material.ior) * static_cast<double>(c.material.ior);
  std::mt19937 random(kSeed);
  std::uniform_real_distribution<double> unit(0.02, 1.0);
  for (int i = 0; i < 2000; ++i) {
    const Vec3 a = direction(unit(random), 6.0 * unit(random));
    Vec3 b = direction(unit(random), 6.0 * unit(random));
    const bool crosses = i % 2 == 1;
    if (!crosses) {
      const Vec3 there = Bsdf(material, a, c.front).evaluate(b).value_cos / b.z;
      const Vec3 back = Bsdf(material, b, c.front).evaluate(a).value_cos / a.z;
      ASSERT_NEAR(there.y, back.y, 1e-5F * std::max(1.0F, there.y)) << "seed " << kSeed;
      continue;
    }
    // Seen from b the surface is upside down: half a turn about x keeps the frame right-handed.
    const Vec3 b_below(b.x, b.y, -b.z);
    const Vec3 a_below(a.x, a.y, -a.z);
    const Vec3 there = Bsdf(material, a, c.front).evaluate(b_below).value_cos / b.z;
    const bool other_front = c.material.thin_walled ? c.front : !c.front;
    const Vec3 back = Bsdf(material, b, other_front).evaluate(a_below).value_cos / a.z;
    const double squeeze = c.material.thin_walled ? 1.0 : (c.front ? n2 : 1.0 / n2);
    const double there_basic = static_cast<double>(there.y) * squeeze;
    ASSERT_NEAR(there_basic, static_cast<double>(back.y), 1e-4 * std::max(1.0, there_basic))
        << "seed " << kSeed;
  }
}

TEST(Bsdf, SmoothGlassSplitsAllLightAtEveryAngle) {
  for (const float ior : {1.0F, 1.00005F, 1.33F, 1.5F, 1000.0F}) {
    const PreparedMaterial material =
        prepare_materials(std::vector<Material>{glass(ior, 0.0F, false)}).front();
    for (const bool front : {true, false}) {
      for (const double cos_out : {1e-8, 1e-4, 0.01, 0.3, std::sqrt(5.0) / 3.0, 0.7453559, 1.0}) {
        const Bsdf bsdf(material, direction(cos_out, 0.0), front);
        constexpr int kCount = 4096;
        double sum = 0.0;
        for (int i = 0; i < kCount; ++i) {
          const BsdfSample sample = bsdf.sample((static_cast<float>(i) + 0.5F) / kCount, {});
          const double n = static_cast<double>(material.ior);
          const double squeeze = front ? n * n : 1.0 / (n * n);
          sum += static_cast<double>(sample.weight.x) * (sample.direction.z < 0.0F ? squeeze : 1.0);
          ASSERT_NEAR(glm::length(sample.direction), 1.0F, 1e-6F);
        }
        EXPECT_NEAR(sum / kCount, 1.0, 3e-6) << ior << ' ' << front << ' ' << cos_out;
      }
    }
  }
}

TEST(Bsdf, NothingLeavesGlassBeyondTheCriticalAngle) {
  const PreparedMaterial material =
      prepare_materials(std::vector<Material>{glass(1.5F, 0.0F, false)}).front();
  const double cos_critical = std::sqrt(1.0 - 1.0 / 2.25);
  for (int i = 0; i < 1000; ++i) {
    const float u = static_cast<float>(i) / 1000.0F;
    const Bsdf beyond(material, direction(cos_critical - 1e-5, 0.0), /*front=*/false);
    ASSERT_GT(beyond.sample(u, {}).direction.z, 0.0F);
  }
  const Bsdf within(material, direction(cos_critical + 1e-3, 0.0), /*front=*/false);
  EXPECT_LT(within.sample(0.999F, {}).direction.z, 0.0F);
}

TEST(Bsdf, RefractsBySnellsLaw) {
  const PreparedMaterial material =
      prepare_materials(std::vector<Material>{glass(1.5F, 0.0F, false)}).front();

  const BsdfSample entering = Bsdf(material, direction(0.6, 0.0), true).sample(0.99F, {});
  const BsdfSample leaving = Bsdf(material, direction(0.9, 0.0), false).sample(0.99F, {});

  EXPECT_NEAR(entering.direction.x, -0.8F / 1.5F, 1e-6F);
  EXPECT_EQ(entering.index_squared, 2.25F);
  EXPECT_NEAR(leaving.direction.x, -1.5F * std::sqrt(0.19F), 1e-6F);
  EXPECT_EQ(leaving.index_squared, 1.0F);
}

TEST(Bsdf, ReflectsAtNormalIncidenceAsTheIndexSays) {
  const double r = 0.04;
  const auto reflected = [](const Material& m) {
    const PreparedMaterial material = prepare_materials(std::vector<Material>{m}).front();
    const Bsdf bsdf(material, Vec3(0.0F, 0.0F, 1.0F), true);
    constexpr int kCount = 10000;
    int count = 0;
    for (int i = 0; i < kCount; ++i) {
      const BsdfSample sample = bsdf.sample((static_cast<float>(i) + 0.5F) / kCount, {});
      count += sample.direction.z > 0.0F && sample.pdf_solid_angle == 0.0F ? 1 : 0;
    }
    return static_cast<double>(count) / kCount;
  };

  EXPECT_NEAR(reflected(glass(1.5F, 0.0F, false)), r, 2e-4);
  EXPECT_NEAR(reflected(glass(1.5F, 0.0F, true)), 2.0 * r / (1.0 + r), 2e-4);
  EXPECT_NEAR(reflected(white(0.0F, 0.0F)), r, 2e-4);
}

TEST(Bsdf, WithoutSpecularColourIsPureLambert) {
  Material material = lambert(0.5F);
  material.roughness = 0.2F;
  const PreparedMaterial prepared = prepare_materials(std::vector<Material>{material}).front();
  for (const double cos_in : {1.0, 0.5, 0.01}) {
    const BsdfValue value =
        Bsdf(prepared, direction(0.3, 0.0), true).evaluate(direction(cos_in, 1.0));
    EXPECT_NEAR(value.value_cos.x, 0.5 * cos_in / kPiDouble, 1e-7);
    EXPECT_NEAR(value.pdf_solid_angle, cos_in / kPiDouble, 1e-7);
  }
}

TEST(Bsdf, BlackAbsorbsEverything) {
  const PreparedMaterial prepared = prepare_materials(std::vector<Material>{lambert(0.0F)}).front();
  const Bsdf bsdf(prepared, direction(0.5, 0.0), true);
  EXPECT_EQ(bsdf.sample(0.5F, pair_of(0.5, 0.5)).direction, Vec3(0.0F));
  EXPECT_TRUE(bsdf.is_delta());
}

TEST(MicrofacetAlbedoTable, MirrorsLoseNothingAndRoughnessLosesMore) {
  double lost = 1e-5;
  for (const float alpha : {0.01F, 0.1F, 0.3F, 0.6F, 1.0F}) {
    const MicrofacetAlbedoTable table(alpha, kAlbedoStrata);
    const double lost_here = 1.0 - static_cast<double>(table.mean().total);
    EXPECT_GT(lost_here, lost * 0.9) << alpha;
    EXPECT_LT(lost_here, 0.6);
    lost = lost_here;
  }
}

TEST(MicrofacetAlbedoTable, IsWithinAFiftiethWhereItIsCoarse) {
  for (const float alpha : {0.002F, 0.01F, 0.1F, 0.3F, 0.6F, 1.0F}) {
    const MicrofacetAlbedoTable fine(alpha, kAlbedoStrata);
    const MicrofacetAlbedoTable coarse(alpha, kAlbedoStrataCoarse);
    for (int i = 0; i <= 64; ++i) {
      const float cos_normal = static_cast<float>(i) / 64.0F;
      EXPECT_NEAR(coarse.at(cos_normal).total, fine.at(cos_normal).total, 0.02F)
          << alpha << " at " << cos_normal;
      EXPECT_NEAR(coarse.at(cos_normal).grazing, fine.at(cos_normal).grazing, 0.02F)
          << alpha << " at " << cos_normal;
    }
  }
}

}  // namespace
}  // namespace preheat
