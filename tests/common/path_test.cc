#include "common/path.h"

#include <gtest/gtest.h>

#include <random>
#include <string>

#include "common/path_rules.h"
#include "tests/common/triangle_scene.h"

namespace preheat {
namespace {

using test::diffuse;
using test::emitter;
using test::Estimate;
using test::look_at;
using test::TriangleScene;

constexpr std::uint64_t kSeed = 20240611;

RenderSettings settings_of(std::uint32_t size, std::uint32_t spp, std::uint32_t bounces) {
  RenderSettings settings;
  settings.width = size;
  settings.height = size;
  settings.spp = spp;
  settings.bounces = bounces;
  settings.seed = kSeed;
  return settings;
}

// Within 4 standard errors, and rounding.
void expect_within_error(const Estimate& estimate, double expected) {
  EXPECT_NEAR(estimate.mean, expected, 4.0 * estimate.standard_error + 2e-6 * expected)
      << "standard error " << estimate.standard_error << ", seed " << kSeed;
}

// Neither alike by luck: the estimates also have to be precise.
void expect_same(const Estimate& a, const Estimate& b, double relative_error_max) {
  const double error = std::hypot(a.standard_error, b.standard_error);
  EXPECT_NEAR(a.mean, b.mean, 4.0 * error + 2e-6 * a.mean) << "seed " << kSeed;
  EXPECT_LE(error, relative_error_max * b.mean);
}

Material coated(float roughness) {
  Material material;
  material.base_color = Vec3(1.0F);
  material.roughness = roughness;
  return material;
}

Material metal(float roughness) {
  Material material = coated(roughness);
  material.metallic = 1.0F;
  return material;
}

Material glass(float ior, float roughness, bool thin) {
  Material material = coated(roughness);
  material.transmission = 1.0F;
  material.ior = ior;
  material.thin_walled = thin;
  return material;
}

// A room that emits e everywhere and reflects rho has radiance e (1 + rho + ... + rho^bounces).
struct ClosedBox {
  std::uint32_t bounces;
  float albedo;
};

class PathInClosedBox : public testing::TestWithParam<ClosedBox> {};

TEST_P(PathInClosedBox, SeesTheTruncatedGeometricSeries) {
  const auto [bounces, albedo] = GetParam();
  TriangleScene scene;
  const float emission = 1.0F - albedo;
  const auto walls = scene.add_material(emitter(Vec3(emission), Vec3(albedo)));
  scene.add_box(Vec3(-0.5F, -0.4F, -0.3F), Vec3(0.5F, 0.6F, 0.45F), walls, /*outwards=*/false);
  RenderSettings settings = settings_of(24, bounces > 16 ? 32 : 64, bounces);
  settings.view = look_at(Vec3(0.1F, 0.2F, 0.3F), Vec3(-0.3F, -0.2F, -0.1F), 0.8F);

  const Estimate estimate = scene.render(settings);

  const double expected = 1.0 - std::pow(static_cast<double>(albedo), bounces + 1.0);
  expect_within_error(estimate, expected);
  EXPECT_LE(estimate.standard_error, 0.006 * expected);
}

INSTANTIATE_TEST_SUITE_P(Depths, PathInClosedBox,
                         testing::Values(ClosedBox{0, 0.5F}, ClosedBox{1, 0.5F}, ClosedBox{4, 0.5F},
                                         ClosedBox{64, 0.5F}, ClosedBox{2, 0.9F},
                                         ClosedBox{64, 0.9F}));

struct Furnace {
  std::string name;
  Material material;
  double radiance_min;  // what may be lost between rough glass facets
};

class PathInWhiteFurnace : public testing::TestWithParam<Furnace> {};

TEST_P(PathInWhiteFurnace, CannotSeeAWhiteBody) {
  const Furnace& furnace = GetParam();
  TriangleScene scene;
  const auto white = scene.add_material(furnace.material);
  scene.add_sphere(Vec3(0.0F), 0.5F, /*levels=*/1, white);
  RenderSettings settings = settings_of(24, 32, 64);
  settings.sky = Vec3(1.0F);
  settings.view = look_at(Vec3(0.0F, 0.3F, 0.9F), Vec3(0.0F), 0.25F);

  const Estimate estimate = scene.render(settings);

  EXPECT_LE(estimate.mean, 1.0 + 1e-3 + 4.0 * estimate.standard_error) << "seed " << kSeed;
  EXPECT_GE(estimate.mean, furnace.radiance_min - 4.0 * estimate.standard_error);
  EXPECT_LE(estimate.standard_error, 0.004);
}

INSTANTIATE_TEST_SUITE_P(Materials, PathInWhiteFurnace,
                         testing::Values(Furnace{"lambert", diffuse(Vec3(1.0F)), 0.999},
                                         Furnace{"mirror_coat", coated(0.0F), 0.999},
                                         Furnace{"glossy_coat", coated(0.3F), 0.999},
                                         Furnace{"rough_coat", coated(1.0F), 0.999},
                                         Furnace{"mirror", metal(0.0F), 0.999},
                                         Furnace{"polished_metal", metal(0.05F), 0.999},
                                         Furnace{"rough_metal", metal(0.7F), 0.999},
                                         Furnace{"sheet", glass(1.5F, 0.0F, true), 0.999},
                                         Furnace{"rough_sheet", glass(1.5F, 0.4F, true), 0.9},
                                         Furnace{"solid", glass(1.5F, 0.0F, false), 0.99},
                                         Furnace{"rough_solid", glass(1.5F, 0.4F, false), 0.8}),
                         [](const auto& furnace) { return furnace.param.name; });

// The share of a hemisphere's cosine that a rectangle covers, seen from below its corner at
// distance c (configuration factor of a parallel rectangle).
double corner_factor(double a, double b, double c) {
  const double x = a / c;
  const double y = b / c;
  const double root_x = std::sqrt(1.0 + x * x);
  const double root_y = std::sqrt(1.0 + y * y);
  return (x / root_x * std::atan(y / root_x) + y / root_y * std::atan(x / root_y)) /
         (2.0 * kPiDouble);
}

// A floor and a light of half size `half` at height 0.5, seen from the side.
TriangleScene floor_and_light(const Material& floor, float half, float radiance) {
  TriangleScene scene;
  const auto floor_id = scene.add_material(floor);
  const auto light_id = scene.add_material(emitter(Vec3(radiance)));
  scene.add_parallelogram(Vec3(-1.0F, 0.0F, -1.0F), Vec3(0.0F, 0.0F, 2.0F), Vec3(2.0F, 0.0F, 0.0F),
                          floor_id);
  scene.add_parallelogram(Vec3(-half, 0.5F, -half), Vec3(2.0F * half, 0.0F, 0.0F),
                          Vec3(0.0F, 0.0F, 2.0F * half), light_id);
  return scene;
}

RenderSettings looking_at_floor(std::uint32_t spp, std::uint32_t bounces) {
  RenderSettings settings = settings_of(16, spp, bounces);
  settings.view = look_at(Vec3(0.6F, 0.4F, 0.5F), Vec3(0.0F), 1e-5F);
  return settings;
}

TEST(Path, RectangleLightsAFloorAsTheClosedFormSays) {
  for (const float half : {0.001F, 0.05F, 0.4F, 0.9F}) {
    const TriangleScene scene = floor_and_light(diffuse(Vec3(0.6F)), half, 3.0F);

    const Estimate estimate = scene.render(looking_at_floor(256, 1));

    const double h = static_cast<double>(half);
    const double expected = 0.6 * 3.0 * 4.0 * corner_factor(h, h, 0.5);
    expect_within_error(estimate, expected);
    EXPECT_LE(estimate.standard_error, 0.003 * expected) << "half size " << half;
  }
}

// Without the emitters in its tables, shading finds them by scattering alone; a sky too dark to
// count keeps the last scatter ray alive.
TEST(Path, LightSamplingAndScatteringAloneAgree) {
  for (const float roughness : {1.0F, 0.25F}) {
    for (const float half : {0.05F, 0.9F}) {
      Material floor = coated(roughness);
      floor.base_color = Vec3(0.4F);
      TriangleScene both = floor_and_light(floor, half, 2.0F);
      TriangleScene scatter_only = both;
      scatter_only.tables().emissive_triangles.clear();
      RenderSettings settings = looking_at_floor(256, 3);
      RenderSettings settings_scatter_only = looking_at_floor(half < 0.1F ? 2048 : 256, 3);
      settings_scatter_only.sky = Vec3(1e-30F);

      expect_same(both.render(settings), scatter_only.render(settings_scatter_only), 0.03);
    }
  }
}

TEST(Path, SkySamplingAndScatteringAgreeUnderARoof) {
  TriangleScene scene;
  const auto floor = scene.add_material(diffuse(Vec3(0.8F)));
  scene.add_parallelogram(Vec3(-1.0F, 0.0F, -1.0F), Vec3(0.0F, 0.0F, 2.0F), Vec3(2.0F, 0.0F, 0.0F),
                          floor);
  scene.add_parallelogram(Vec3(-0.3F, 0.5F, -0.3F), Vec3(0.6F, 0.0F, 0.0F), Vec3(0.0F, 0.0F, 0.6F),
                          scene.add_material(diffuse(Vec3(0.0F))));
  RenderSettings settings = looking_at_floor(128, 1);
  settings.sky = Vec3(2.0F);

  const Estimate estimate = scene.render(settings);

  expect_within_error(estimate, 0.8 * 2.0 * (1.0 - 4.0 * corner_factor(0.3, 0.3, 0.5)));
  EXPECT_LE(estimate.standard_error, 0.003);
}

TEST(Path, GlassOfIndexOneIsInvisible) {
  for (const bool rough : {false, true}) {
    const TriangleScene without = floor_and_light(diffuse(Vec3(0.6F)), 0.3F, 2.0F);
    TriangleScene with = without;
    with.add_sphere(Vec3(0.0F, 0.2F, 0.0F), 0.15F, 1,
                    with.add_material(glass(1.0F, rough ? 0.5F : 0.0F, /*thin=*/false)));

    // Shadow rays end at the glass, so scattering has to find the light: four events more.
    const Estimate clear = without.render(looking_at_floor(256, 1));
    const Estimate through = with.render(looking_at_floor(256, 5));

    expect_same(clear, through, 0.02);
  }
}

TEST(Path, MirrorRoomEndsAndKeepsItsEnergy) {
  TriangleScene scene;
  Material mirror = metal(0.0F);
  mirror.base_color = Vec3(0.5F);
  mirror.emission = Vec3(0.5F);
  mirror.double_sided = false;
  scene.add_box(Vec3(-0.5F), Vec3(0.5F), scene.add_material(mirror), /*outwards=*/false);
  RenderSettings settings = settings_of(16, 64, 64);
  settings.view = look_at(Vec3(0.1F, 0.2F, 0.3F), Vec3(-0.3F, -0.2F, -0.1F), 0.8F);

  TriangleScene::Counts counts;
  const Estimate estimate = scene.render(settings, &counts);

  // Schlick's term lifts the reflectance above one half towards grazing angles.
  EXPECT_GE(estimate.mean, 1.0 - 4.0 * estimate.standard_error) << "seed " << kSeed;
  EXPECT_LE(estimate.mean, 1.2);
  EXPECT_EQ(counts.shadow, 0U);
}

// The radiance of a white floor in direct light of one punctual light.
double punctual_radiance(const PunctualLight& light) {
  TriangleScene scene = floor_and_light(diffuse(Vec3(1.0F)), 0.01F, 0.0F);
  scene.tables().lights.push_back(light);
  return scene.render(looking_at_floor(1, 1)).mean;
}

TEST(Path, PunctualLightsFollowTheirFormulas) {
  PunctualLight light;
  light.intensity = Vec3(2.0F);
  light.position = Vec3(0.3F, 0.4F, 0.0F);  // distance 0.5, cos 0.8
  const double unlimited = 2.0 / 0.25 * 0.8 / kPiDouble;

  EXPECT_NEAR(punctual_radiance(light), unlimited, 1e-4 * unlimited);
  light.range = 1.0F;
  EXPECT_NEAR(punctual_radiance(light), unlimited * (1.0 - 1.0 / 16.0), 1e-4 * unlimited);
  light.range = 0.4F;
  EXPECT_EQ(punctual_radiance(light), 0.0);

  light.range = 0.0F;
  light.kind = PunctualLightKind::kSpot;
  light.direction = Vec3(-0.6F, -0.8F, 0.0F);
  light.cos_inner = 0.99F;
  light.cos_outer = 0.9F;
  EXPECT_NEAR(punctual_radiance(light), unlimited, 1e-4 * unlimited);
  light.direction = Vec3(-0.28F, -0.96F, 0.0F);  // cos 0.936: 0.4 of the ramp
  EXPECT_NEAR(punctual_radiance(light), 0.16 * unlimited, 1e-3 * unlimited);
  light.direction = Vec3(0.6F, -0.8F, 0.0F);
  EXPECT_EQ(punctual_radiance(light), 0.0);

  light.kind = PunctualLightKind::kDirectional;
  light.direction = Vec3(-0.6F, -0.8F, 0.0F);
  EXPECT_NEAR(punctual_radiance(light), 2.0 * 0.8 / kPiDouble, 1e-4);
}

SurfaceHit hit_at(const Vec3& position, const Vec3& normal) {
  SurfaceHit hit;
  hit.position = position;
  hit.position_error = 1e-6F;
  hit.normal_geometric = normal;
  hit.normal_shading = normal;
  hit.distance = 1.0F;
  hit.triangle = 1000;
  return hit;
}

Ray ray_along(const Vec3& direction) {
  Ray ray;
  ray.direction = glm::normalize(direction);
  return ray;
}

TEST(Path, NoShadowRayWithoutAContribution) {
  // The light at height 0.5 faces down.
  TriangleScene scene = floor_and_light(diffuse(Vec3(0.5F)), 0.2F, 1.0F);
  scene.add_triangle(Vec3(0.0F), Vec3(0.0F), Vec3(1.0F), 1);  // a light without area
  const RenderSettings settings = settings_of(1, 1, 4);
  const Shading shading(scene.tables(), settings);
  const Vec3 up(0.0F, 1.0F, 0.0F);
  struct Case {
    std::string name;
    Ray ray;
    SurfaceHit hit;
    bool lit;
  };
  const std::vector<Case> cases{
      {"below the light", ray_along(-up), hit_at(Vec3(0.0F), up), true},
      {"turned away", ray_along(up), hit_at(Vec3(0.0F), -up), false},
      {"behind the light", ray_along(-up), hit_at(Vec3(0.0F, 0.9F, 0.0F), up), false},
      {"above, facing it", ray_along(up), hit_at(Vec3(0.0F, 0.9F, 0.0F), -up), false},
      {"on the light", ray_along(up), hit_at(Vec3(0.05F, 0.5F, 0.05F), -up), false},
      {"level with it but for rounding", ray_along(-up), hit_at(Vec3(0.9F, 0.4999997F, 0.0F), up),
       false},
      {"just below its level", ray_along(-up), hit_at(Vec3(0.9F, 0.4999F, 0.0F), up), true}};

  for (const Case& c : cases) {
    PathState path;
    const ShadedVertex vertex = shading.shade_hit(c.ray, c.hit, path);
    EXPECT_EQ(vertex.has_shadow_ray, c.lit) << c.name;
    EXPECT_EQ(vertex.direct != Vec3(0.0F), c.lit) << c.name;
  }
}

// An interpolated normal that leans by 60 degrees: what is above it and below the true surface must
// stay dark, or light would leak through walls.
TEST(Path, LeaningNormalsLetNoLightThrough) {
  TriangleScene scene;
  const auto floor = scene.add_material(coated(0.5F));
  PunctualLight light;
  light.kind = PunctualLightKind::kDirectional;
  light.intensity = Vec3(1.0F);
  light.direction = glm::normalize(Vec3(-1.0F, 0.2F, 0.0F));  // from below the horizon
  scene.tables().lights.push_back(light);
  const Shading shading(scene.tables(), settings_of(64, 1, 4));
  SurfaceHit hit = hit_at(Vec3(0.0F), Vec3(0.0F, 1.0F, 0.0F));
  hit.normal_shading = Vec3(0.8660254F, 0.5F, 0.0F);
  hit.material = floor;
  int scattered = 0;

  for (std::uint32_t pixel = 0; pixel < 4096; ++pixel) {
    for (const Vec3& from : {Vec3(0.3F, -1.0F, 0.2F), Vec3(0.9F, -0.2F, 0.0F)}) {
      PathState path;
      path.pixel = pixel;
      const ShadedVertex vertex = shading.shade_hit(ray_along(from), hit, path);
      ASSERT_FALSE(vertex.has_shadow_ray);
      if (!vertex.has_scatter_ray) { continue; }
      ++scattered;
      ASSERT_GT(vertex.scatter.direction.y, 0.0F) << "seed " << kSeed;
    }
  }
  EXPECT_GT(scattered, 2000);
}

TEST(Path, CountsRaysByItsRules) {
  struct Case {
    std::uint32_t bounces;
    bool emission;
    std::uint64_t scatter;
    std::uint64_t shadow;
  };
  // One camera ray to the floor of a black room with a light; nothing is lost to roulette yet.
  for (const Case& c : {Case{0, true, 0, 0}, Case{1, true, 1, 1}, Case{2, true, 2, 2},
                        Case{1, false, 0, 1}, Case{2, false, 1, 2}}) {
    TriangleScene scene;
    const auto walls = scene.add_material(diffuse(Vec3(0.999F)));
    scene.add_box(Vec3(-0.5F), Vec3(0.5F), walls, /*outwards=*/false);
    PunctualLight light;
    light.intensity = Vec3(1.0F);
    scene.tables().lights.push_back(light);
    RenderSettings settings = settings_of(1, 1, c.bounces);
    settings.sky = Vec3(c.emission ? 1e-30F : 0.0F);
    settings.view = look_at(Vec3(0.1F), Vec3(0.0F, -0.5F, 0.1F), 0.01F);

    TriangleScene::Counts counts;
    static_cast<void>(scene.render(settings, &counts));

    EXPECT_EQ(counts.scatter, c.scatter) << c.bounces << ' ' << c.emission;
    EXPECT_LE(counts.shadow, c.shadow) << c.bounces << ' ' << c.emission;
  }
}

TEST(Path, OneSidedEmittersAreDarkBehind) {
  TriangleScene scene;
  const auto light = scene.add_material(emitter(Vec3(2.0F)));
  scene.add_parallelogram(Vec3(-1.0F, -1.0F, 0.0F), Vec3(2.0F, 0.0F, 0.0F), Vec3(0.0F, 2.0F, 0.0F),
                          light);
  RenderSettings settings = settings_of(2, 1, 0);

  settings.view = look_at(Vec3(0.0F, 0.0F, 0.5F), Vec3(0.0F), 0.1F);
  EXPECT_EQ(scene.render(settings).mean, 2.0);
  settings.view = look_at(Vec3(0.0F, 0.0F, -0.5F), Vec3(0.0F), 0.1F);
  EXPECT_EQ(scene.render(settings).mean, 0.0);
  scene.tables().materials[light].double_sided = true;
  EXPECT_EQ(scene.render(settings).mean, 2.0);
}

TEST(Path, ClosedRoomLetsNoLightIn) {
  for (const int exponent : {0, -10, -20}) {
    const float scale = std::ldexp(1.0F, exponent);
    TriangleScene scene;
    const auto walls = scene.add_material(diffuse(Vec3(0.9F)));
    scene.add_box(Vec3(-0.5F, -0.4F, -0.3F) * scale, Vec3(0.5F, 0.6F, 0.45F) * scale, walls, false);
    const auto light = scene.add_material(emitter(Vec3(100.0F)));
    scene.add_box(Vec3(-0.9F) * scale, Vec3(0.9F) * scale, light, /*outwards=*/false);
    RenderSettings settings = settings_of(16, 16, 8);
    settings.sky = Vec3(1.0F);
    settings.view = look_at(Vec3(0.1F, 0.2F, 0.3F) * scale, Vec3(0.0F), 0.8F);

    EXPECT_EQ(scene.render(settings).mean, 0.0) << "scale 2^" << exponent;
  }
}

TEST(Path, LightInAOneSidedRoomSeenFromAGlassCase) {
  // A light inside a sheet of glass is found by scattering through it alone.
  TriangleScene scene = floor_and_light(diffuse(Vec3(0.6F)), 0.3F, 2.0F);
  const TriangleScene bare = scene;
  Material clear = glass(1.0F, 0.0F, /*thin=*/true);
  clear.specular_color = Vec3(0.0F);
  scene.add_box(Vec3(-0.35F, 0.45F, -0.35F), Vec3(0.35F, 0.55F, 0.35F), scene.add_material(clear),
                true);

  expect_same(bare.render(looking_at_floor(256, 1)), scene.render(looking_at_floor(512, 2)), 0.02);
}

// The recipe of pbrt-v4's Triangle.Reintersect, in our frame of unit size.
TEST(Path, RaysFromASurfaceDoNotMeetItAgain) {
  std::mt19937 random(kSeed);
  std::uniform_real_distribution<float> unit(-1.0F, 1.0F);
  std::uint64_t rays = 0;
  std::uint64_t met = 0;
  for (int i = 0; i < 2000; ++i) {
    const float scale = std::exp2(10.0F * unit(random) - 10.0F);
    const auto point = [&] { return Vec3(unit(random), unit(random), unit(random)); };
    const Vec3 centre = point() * (1.0F - scale);
    const std::array<Vec3, 3> corners{centre + point() * scale, centre + point() * scale,
                                      centre + point() * scale};
    Ray ray;
    ray.origin = point();
    const float a = 0.5F * (unit(random) + 1.0F);
    const float b = 0.5F * (unit(random) + 1.0F) * (1.0F - a);
    const Vec3 target = corners[0] * (1.0F - a - b) + corners[1] * a + corners[2] * b;
    ray.direction = glm::normalize(target - ray.origin);
    const std::optional<SurfaceHit> hit = test::intersect(ray, corners);
    if (!hit) { continue; }
    for (int j = 0; j < 200; ++j) {
      Ray leaving;
      leaving.direction = glm::normalize(point());
      leaving.origin = offset_origin(hit->position, hit->position_error, hit->normal_geometric,
                                     leaving.direction);
      ++rays;
      met += test::intersect(leaving, corners) ? 1U : 0U;
    }
  }
  EXPECT_GT(rays, 300000U);
  EXPECT_EQ(met, 0U) << "seed " << kSeed;
}

TEST(Path, OffsetsScaleWithTheScene) {
  std::mt19937 random(kSeed);
  std::uniform_real_distribution<float> unit(-1.0F, 1.0F);
  for (int i = 0; i < 10000; ++i) {
    const Vec3 point(unit(random), unit(random), unit(random));
    const Vec3 normal = glm::normalize(Vec3(unit(random), unit(random), unit(random)));
    const Vec3 direction = glm::normalize(Vec3(unit(random), unit(random), unit(random)));
    const Vec3 moved = offset_origin(point, 3e-7F, normal, direction);
    const Vec3 moved_small = offset_origin(point * 0x1p-40F, 3e-7F * 0x1p-40F, normal, direction);
    ASSERT_EQ(moved * 0x1p-40F, moved_small) << "seed " << kSeed;
  }
}

// Everything that a hostile scene can put into a hit: what comes out is finite, or nothing.
TEST(Path, DegenerateInputEndsThePath) {
  std::mt19937 random(kSeed);
  std::uniform_real_distribution<float> unit(0.0F, 1.0F);
  const auto pick = [&](std::initializer_list<float> values) {
    const auto index =
        static_cast<std::ptrdiff_t>(unit(random) * static_cast<float>(values.size()));
    return *(values.begin() +
             std::min<std::ptrdiff_t>(index, static_cast<std::ptrdiff_t>(values.size()) - 1));
  };
  TriangleScene scene;
  for (int i = 0; i < 300; ++i) {
    Material material;
    material.base_color = Vec3(pick({0.0F, 0.5F, 1.0F}), unit(random), 1.0F);
    material.metallic = pick({0.0F, 0.3F, 1.0F});
    material.roughness = pick({0.0F, 1e-6F, 0.02F, 0.3F, 1.0F});
    material.transmission = pick({0.0F, 0.5F, 1.0F});
    material.ior = pick({1.0F, 1.00001F, 1.0002F, 1.5F, 1000.0F});
    material.thin_walled = unit(random) < 0.5F;
    material.specular_color = Vec3(pick({0.0F, 1.0F}));
    scene.add_material(material);
  }
  const auto light = scene.add_material(emitter(Vec3(1.0F)));
  scene.add_triangle(Vec3(0.0F), Vec3(1e-8F, 0.0F, 0.0F), Vec3(0.0F, 1e-8F, 0.0F), light);
  scene.add_parallelogram(Vec3(-0.9F), Vec3(1.8F, 0.0F, 0.0F), Vec3(0.0F, 0.0F, 1.8F), light);
  scene.tables().lights.push_back(PunctualLight{});
  RenderSettings settings = settings_of(64, 1, 64);
  settings.sky = Vec3(1.0F);
  const Shading shading(scene.tables(), settings);
  const float tiny = std::numeric_limits<float>::denorm_min();
  float throughput_max = 0.0F;
  int scattered = 0;

  for (std::uint32_t i = 0; i < 200000; ++i) {
    const auto component = [&] { return pick({0.0F, -1.0F, 1.0F, 1e-8F, -1e-4F, 1e-3F, tiny}); };
    const auto direction = [&] {
      const Vec3 v(component() + 0.1F * unit(random), component(), component());
      return glm::dot(v, v) > 0.0F ? glm::normalize(v) : v;
    };
    SurfaceHit hit = hit_at(Vec3(component(), component(), component()), direction());
    hit.normal_shading = direction();
    if (glm::dot(hit.normal_shading, hit.normal_geometric) < 0.0F) {
      hit.normal_shading = -hit.normal_shading;
    }
    hit.material = i % 300;
    Ray ray;
    ray.direction = direction();
    PathState path;
    path.pixel = i;
    const ShadedVertex vertex = shading.shade_hit(ray, hit, path);

    ASSERT_TRUE(is_finite(vertex.direct) && is_finite(path.throughput) && is_finite(path.radiance));
    ASSERT_GE(std::min({vertex.direct.x, vertex.direct.y, vertex.direct.z}), 0.0F);
    ASSERT_GE(std::min({path.throughput.x, path.throughput.y, path.throughput.z}), 0.0F);
    if (vertex.has_scatter_ray) {
      ++scattered;
      throughput_max = std::max(throughput_max, max_component(path.throughput));
      ASSERT_TRUE(is_finite(vertex.scatter.origin));
      ASSERT_NEAR(glm::length(vertex.scatter.direction), 1.0F, 1e-5F);
    }
    if (vertex.has_shadow_ray) {
      ASSERT_TRUE(is_finite(vertex.shadow.origin) && is_finite(vertex.shadow.direction));
      ASSERT_GT(vertex.shadow.t_max, 0.0F);
    }
  }
  EXPECT_GT(scattered, 50000);
  // A ray that leaves glass of index 1000 regains what entering took.
  EXPECT_LE(throughput_max, 1.1e6F);
}

TEST(Path, CameraInsideALightSeesItsRadianceExactly) {
  TriangleScene scene;
  scene.add_box(Vec3(-0.5F), Vec3(0.5F), scene.add_material(emitter(Vec3(0.7F))), false);
  RenderSettings settings = settings_of(4, 16, 4);
  settings.view = look_at(Vec3(0.1F), Vec3(0.3F), 2.0F);

  EXPECT_EQ(scene.render(settings).mean, static_cast<double>(mean_component(Vec3(0.7F))));
}

TEST(Path, OrthographicRaysAreParallel) {
  RenderSettings settings = settings_of(8, 1, 0);
  settings.view = look_at(Vec3(0.0F), Vec3(0.0F, 0.0F, -1.0F), 0.5F);
  settings.view.orthographic = true;
  const Shading shading(SceneTables{}, settings);
  float reach = 0.0F;
  for (std::uint32_t pixel = 0; pixel < 64; ++pixel) {
    PathState path;
    const Ray ray = shading.start_path(pixel, 0, path);
    EXPECT_EQ(ray.direction, Vec3(0.0F, 0.0F, -1.0F));
    EXPECT_EQ(ray.origin.z, 0.0F);
    reach = std::max(reach, glm::length(ray.origin));
  }
  EXPECT_GT(reach, 0.5F);
  EXPECT_LE(reach, 0.7072F);
}

// x to the right and y downwards, each sample inside its pixel.
TEST(Path, PixelsAreRowByRowFromTheTopLeft) {
  RenderSettings settings;
  settings.width = 4;
  settings.height = 3;
  settings.seed = kSeed;
  const Shading shading(SceneTables{}, settings);
  for (std::uint32_t pixel = 0; pixel < 12; ++pixel) {
    for (std::uint32_t sample = 0; sample < 64; ++sample) {
      PathState path;
      const Ray ray = shading.start_path(pixel, sample, path);
      const float x = 2.0F * (ray.direction.x / -ray.direction.z + 1.0F);
      const float y = 1.5F * (1.0F - ray.direction.y / -ray.direction.z);
      ASSERT_NEAR(x, static_cast<float>(pixel % 4) + 0.5F, 0.50001F);
      ASSERT_NEAR(y, static_cast<float>(pixel / 4) + 0.5F, 0.50001F);
    }
  }
}

// A room with every kind of material and light, as bits. It may change only where the image is
// meant to change; never with the compiler, its options or the machine.
TEST(Path, ImageIsTheSameEverywhere) {
  TriangleScene scene;
  scene.add_box(Vec3(-0.5F), Vec3(0.5F), scene.add_material(diffuse(Vec3(0.7F, 0.6F, 0.5F))),
                false);
  scene.add_parallelogram(Vec3(-0.2F, 0.49F, -0.2F), Vec3(0.4F, 0.0F, 0.0F), Vec3(0.0F, 0.0F, 0.4F),
                          scene.add_material(emitter(Vec3(8.0F, 7.0F, 6.0F))));
  scene.add_sphere(Vec3(-0.2F, -0.3F, -0.2F), 0.15F, 1, scene.add_material(metal(0.3F)));
  scene.add_sphere(Vec3(0.2F, -0.3F, -0.2F), 0.15F, 1,
                   scene.add_material(glass(1.5F, 0.0F, false)));
  scene.add_sphere(Vec3(0.2F, 0.0F, -0.3F), 0.1F, 1, scene.add_material(glass(1.3F, 0.4F, false)));
  scene.add_sphere(Vec3(-0.2F, 0.1F, -0.3F), 0.1F, 1, scene.add_material(coated(0.2F)));
  PunctualLight spot;
  spot.kind = PunctualLightKind::kSpot;
  spot.position = Vec3(0.4F, 0.4F, 0.4F);
  spot.direction = glm::normalize(Vec3(-1.0F));
  spot.intensity = Vec3(0.5F);
  scene.tables().lights.push_back(spot);
  RenderSettings settings = settings_of(24, 4, 6);
  settings.sky = Vec3(0.1F);
  settings.view = look_at(Vec3(0.0F, 0.0F, 0.45F), Vec3(0.0F, -0.1F, -0.3F), 0.8F);
  const Shading shading(scene.tables(), settings);

  TileAccumulator tile(24 * 24);
  TriangleScene::Counts counts;
  for (std::uint32_t pixel = 0; pixel < 24 * 24; ++pixel) {
    for (std::uint32_t sample = 0; sample < settings.spp; ++sample) {
      ASSERT_TRUE(tile.add(pixel, scene.trace(shading, pixel, sample, counts)));
    }
  }
  Film film(24, 24);
  film.assign({0, 0, 24, 24}, tile.finish(settings.spp));

  EXPECT_EQ(film.pixels_sha256(),
            "6617e0aa23dedccc640774119bf7005749216672f25b8b8c01644d69e30e31f0");
}

TEST(Path, SurvivalIsAProbabilityOnceRouletteBegins) {
  EXPECT_EQ(roulette_survival(kRouletteScatteringsMin - 1, Vec3(0.0F)), 1.0F);
  EXPECT_EQ(roulette_survival(kRouletteScatteringsMin, Vec3(0.2F, 0.5F, 0.1F)), 0.5F);
  EXPECT_EQ(roulette_survival(kRouletteScatteringsMin, Vec3(7.0F)), kRouletteSurvivalMax);
  EXPECT_FALSE(may_scatter(0, 0));
  EXPECT_TRUE(may_continue(0, 1, /*emission_can_be_met=*/true));
  EXPECT_FALSE(may_continue(0, 1, /*emission_can_be_met=*/false));
}

}  // namespace
}  // namespace preheat
