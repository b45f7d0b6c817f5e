#include "common/lights.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "common/math.h"
#include "tests/common/triangle_scene.h"

namespace preheat {
namespace {

constexpr std::uint64_t kSeed = 5;

TEST(DiscreteChoice, GivesEachEntryItsShareOfTheNumbers) {
  const std::vector<double> weights{1.0, 0.0, 3.0, 1e-30, 4.0};
  const DiscreteChoice choice(weights);

  EXPECT_NEAR(choice.probability(0), 0.125F, 1e-8F);
  EXPECT_EQ(choice.probability(1), 0.0F);
  EXPECT_NEAR(choice.probability(2), 0.375F, 1e-7F);
  EXPECT_EQ(choice.probability(3), 0x1p-32F);  // never impossible
  EXPECT_EQ(choice.choose(0), 0U);
  EXPECT_EQ(choice.choose(0x1FFFFFFFU), 0U);
  EXPECT_EQ(choice.choose(0x20000001U), 2U);
  EXPECT_EQ(choice.choose(0xFFFFFFFFU), 4U);
}

// The guide table only skips ahead: a search without it finds the same.
TEST(DiscreteChoice, AgreesWithALinearSearch) {
  std::mt19937_64 random(kSeed);
  for (const std::size_t count : {1U, 2U, 3U, 64U, 1000U}) {
    std::vector<double> weights(count);
    for (double& weight : weights) {
      const double u = static_cast<double>(random() >> 11U) * 0x1p-53;
      weight = random() % 4 == 0 ? 0.0 : u * u * u * u * u;
    }
    weights[count / 2] += 1e-3;
    const DiscreteChoice choice(weights);

    double probability_sum = 0.0;
    for (std::uint32_t i = 0; i < count; ++i) {
      probability_sum += static_cast<double>(choice.probability(i));
      EXPECT_EQ(choice.probability(i) > 0.0F, weights[i] > 0.0);
    }
    EXPECT_NEAR(probability_sum, 1.0, 1e-6);
    std::uint32_t last = 0;
    for (std::uint64_t u = 0; u < (1ULL << 32U); u += (1ULL << 32U) / 5003) {
      const std::uint32_t index = choice.choose(static_cast<std::uint32_t>(u));
      ASSERT_GE(index, last);
      ASSERT_GT(weights[index], 0.0) << "seed " << kSeed;
      last = index;
    }
  }
}

// The lights of a scene with two triangles of areas 1/2 and 1/8.
struct TwoTriangles {
  explicit TwoTriangles(bool double_sided, const Vec3& sky = Vec3(0.0F)) {
    Material material = test::emitter(Vec3(2.0F));
    material.double_sided = double_sided;
    const auto id = scene.add_material(material);
    scene.add_triangle(Vec3(0.0F), Vec3(1.0F, 0.0F, 0.0F), Vec3(0.0F, 1.0F, 0.0F), id);
    scene.add_triangle(Vec3(0.0F, 0.0F, 1.0F), Vec3(0.5F, 0.0F, 1.0F), Vec3(0.0F, 0.5F, 1.0F), id);
    materials = prepare_materials(scene.tables().materials);
    lights.emplace(scene.tables(), materials, sky);
  }
  test::TriangleScene scene{};
  std::vector<PreparedMaterial> materials{};
  std::optional<Lights> lights{};
};

TEST(Lights, DensityOfAHitIsThatOfTheSample) {
  const TwoTriangles two(/*double_sided=*/true);
  std::mt19937 random(kSeed);
  int checked = 0;
  for (int i = 0; i < 2000; ++i) {
    const auto bits = [&] { return static_cast<std::uint32_t>(random()); };
    const Vec3 from(0.3F, 0.2F, 3.0F * (static_cast<float>(i) / 1000.0F - 1.0F) + 0.01F);
    const LightSample sample =
        two.lights->sample(from, Vec3(0.0F, 0.0F, 1.0F), bits(), {bits(), bits()});
    Ray ray;
    ray.origin = from;
    ray.direction = sample.direction;
    // The point's own triangle is the one at its height.
    const std::uint32_t triangle = std::abs(sample.point.z) < 0.5F ? 0 : 1;
    const float distance = glm::length(sample.point - from);
    const float pdf = two.lights->pdf_triangle(triangle, distance, std::abs(sample.direction.z));
    ASSERT_NEAR(pdf / sample.pdf_solid_angle, 1.0F, 1e-4F) << "seed " << kSeed;
    ++checked;
  }
  EXPECT_EQ(checked, 2000);
}

TEST(Lights, AreChosenByPower) {
  const TwoTriangles two(/*double_sided=*/false);
  // Straight above a point, at distance 1 the density is probability / area.
  EXPECT_NEAR(two.lights->pdf_triangle(0, 1.0F, 1.0F), 0.8F / 0.5F, 1e-5F);
  EXPECT_NEAR(two.lights->pdf_triangle(1, 1.0F, 1.0F), 0.2F / 0.125F, 1e-5F);
  EXPECT_EQ(two.lights->pdf_triangle(2, 1.0F, 1.0F), 0.0F);
  EXPECT_EQ(two.lights->pdf_triangle(0, 1.0F, 0.0F), 0.0F);
  EXPECT_EQ(two.lights->pdf_sky(1.0F), 0.0F);
}

TEST(Lights, OneSidedTrianglesDoNotLightWhatIsBehindThem) {
  const TwoTriangles one_sided(/*double_sided=*/false);
  const TwoTriangles two_sided(/*double_sided=*/true);
  const Vec3 behind(0.1F, 0.1F, -1.0F);
  const Vec3 up(0.0F, 0.0F, 1.0F);
  EXPECT_EQ(one_sided.lights->sample(behind, up, 0, {0, 0}).pdf_solid_angle, 0.0F);
  EXPECT_GT(two_sided.lights->sample(behind, up, 0, {0, 0}).pdf_solid_angle, 0.0F);
}

TEST(Lights, SkyTakesAtMostItsShareBesideOthers) {
  const TwoTriangles with_sky(/*double_sided=*/false, /*sky=*/Vec3(1000.0F));
  EXPECT_NEAR(with_sky.lights->pdf_sky(1.0F), kEnvironmentProbabilityMax * kInversePi, 1e-6F);
  EXPECT_EQ(with_sky.lights->pdf_sky(-0.5F), 0.0F);

  const Lights only_sky(SceneTables{}, {}, Vec3(0.5F));
  EXPECT_FALSE(only_sky.empty());
  EXPECT_TRUE(only_sky.emission_can_be_met());
  EXPECT_NEAR(only_sky.pdf_sky(1.0F), kInversePi, 1e-6F);
}

TEST(Lights, NothingShinesInADarkScene) {
  const Lights dark(SceneTables{}, {}, Vec3(0.0F));
  EXPECT_TRUE(dark.empty());
  EXPECT_FALSE(dark.emission_can_be_met());

  test::TriangleScene scene;
  scene.add_triangle(Vec3(0.0F), Vec3(1.0F), Vec3(2.0F),
                     scene.add_material(test::emitter(Vec3(1.0F))));
  const Lights without_area(scene.tables(), prepare_materials(scene.tables().materials),
                            Vec3(0.0F));
  EXPECT_TRUE(without_area.empty());
  EXPECT_EQ(without_area.pdf_triangle(0, 1.0F, 1.0F), 0.0F);
}

TEST(Lights, TrianglesAreSampledUniformly) {
  const TwoTriangles two(/*double_sided=*/true);
  constexpr std::uint32_t kSide = 256;
  Vec3d sum(0.0);
  int near_corner = 0;
  for (std::uint32_t i = 0; i < kSide * kSide; ++i) {
    const RandomPair u{(i % kSide) << 24U | 0x800000U, (i / kSide) << 24U | 0x800000U};
    const Vec3 point =
        two.lights->sample(Vec3(0.3F, 0.3F, 0.5F), Vec3(0.0F, 0.0F, 1.0F), 0, u).point;
    ASSERT_GE(point.x, -1e-5F);
    ASSERT_GE(point.y, -1e-5F);
    ASSERT_LE(point.x + point.y, 1.0F + 1e-5F);
    sum += Vec3d(point);
    near_corner += point.x + point.y < 0.5F ? 1 : 0;
  }
  EXPECT_NEAR(sum.x / (kSide * kSide), 1.0 / 3.0, 1e-3);
  EXPECT_NEAR(sum.y / (kSide * kSide), 1.0 / 3.0, 1e-3);
  EXPECT_NEAR(near_corner, kSide * kSide / 4, kSide);
}

TEST(Lights, WindowAndConeAreThoseOfTheExtension) {
  EXPECT_EQ(range_factor(0.0F, 1e6F), 1.0F);
  EXPECT_EQ(range_factor(2.0F, 2.0F), 0.0F);
  EXPECT_EQ(range_factor(2.0F, 3.0F), 0.0F);
  EXPECT_NEAR(range_factor(2.0F, 1.0F), 1.0F - 1.0F / 16.0F, 1e-7F);

  PunctualLight spot;
  spot.cos_inner = 0.9F;
  spot.cos_outer = 0.5F;
  EXPECT_EQ(spot_factor(spot, 0.95F), 1.0F);
  EXPECT_NEAR(spot_factor(spot, 0.7F), 0.25F, 1e-6F);
  EXPECT_EQ(spot_factor(spot, 0.4F), 0.0F);
}

}  // namespace
}  // namespace preheat
