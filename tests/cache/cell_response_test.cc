#include "cache/cell_response.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numeric>

#include "common/math.h"

namespace preheat {
namespace {

// One cell around the origin, with one surface of each material that looks along +z.
struct Bench {
  DirectionBins bins{18, 36};
  SceneTables tables{};
  RenderSettings settings{};
  CellContent cell{};
  std::vector<double> scatter = std::vector<double>(bins.size(), 0.0);
  std::vector<double> shadow = std::vector<double>(bins.size(), 0.0);

  Bench() { settings.sky = Vec3(0.0F); }

  Material& add_surface(const Vec3& normal = {0.0F, 0.0F, 1.0F}, double area = 1.0) {
    const auto material = static_cast<std::uint32_t>(tables.materials.size());
    cell.surfaces.push_back({glm::normalize(normal), material, area});
    tables.materials.emplace_back().specular_color = Vec3(0.0F);
    return tables.materials.back();
  }

  OutgoingRays respond(const Vec3& direction, std::uint32_t bounce = 0, double throughput = 1.0) {
    const CellResponse response(tables, settings, bins);
    cell.lights = response.look_at_lights({Vec3(-0.1F), Vec3(0.1F)}, 0);
    std::fill(scatter.begin(), scatter.end(), 0.0);
    std::fill(shadow.begin(), shadow.end(), 0.0);
    OutgoingRays outgoing{.scatter = scatter, .shadow = shadow};
    CellResponse::Scratch scratch;
    const std::vector<IncomingRays> incoming{{glm::normalize(direction), 100.0}};
    response.respond(cell, incoming, bounce, throughput, scratch, outgoing);
    return outgoing;
  }
  [[nodiscard]] double towards(const std::vector<double>& rays, const Vec3d& direction) const {
    return rays[bins.bin_of(direction).value()];
  }
  [[nodiscard]] static double sum(const std::vector<double>& rays) {
    return std::accumulate(rays.begin(), rays.end(), 0.0);
  }
};

PunctualLight lamp_at(const Vec3& position) {
  PunctualLight lamp;
  lamp.position = position;
  lamp.intensity = Vec3(1.0F);
  return lamp;
}

TEST(CellResponse, OfAMirrorIsTheMirroredDirection) {
  Bench bench;
  Material& mirror = bench.add_surface();
  mirror.metallic = 1.0F;
  mirror.roughness = 0.0F;
  mirror.base_color = Vec3(1.0F);

  bench.respond({0.5F, 0.2F, -0.8F});

  EXPECT_NEAR(bench.towards(bench.scatter, {0.5, 0.2, 0.8}), 100.0, 1e-6);
  EXPECT_NEAR(Bench::sum(bench.scatter), 100.0, 1e-6);
  EXPECT_EQ(Bench::sum(bench.shadow), 0.0);
}

TEST(CellResponse, OfAThinPaneGoesOnOrIsMirrored) {
  Bench bench;
  Material& pane = bench.add_surface();
  pane.transmission = 1.0F;
  pane.roughness = 0.0F;
  pane.base_color = Vec3(1.0F);
  pane.specular_color = Vec3(1.0F);

  bench.respond({0.5F, 0.2F, -0.8F});

  const double on = bench.towards(bench.scatter, {0.5, 0.2, -0.8});
  const double back = bench.towards(bench.scatter, {0.5, 0.2, 0.8});
  EXPECT_GT(on, 80.0);
  EXPECT_NEAR(on + back, 100.0, 1e-6);
}

// Snell's law: sin 45 / 1.5 = sin 28.1.
TEST(CellResponse, OfASolidIsRefracted) {
  Bench bench;
  Material& glass = bench.add_surface();
  glass.transmission = 1.0F;
  glass.roughness = 0.0F;
  glass.base_color = Vec3(1.0F);
  glass.thin_walled = false;

  bench.respond({1.0F, 0.1F, -1.0F});

  const double refracted = std::asin(std::sin(kPiDouble / 4.0) / 1.5);
  EXPECT_GT(bench.towards(bench.scatter,
                          {std::sin(refracted), 0.1 * std::sin(refracted), -std::cos(refracted)}),
            80.0);
}

TEST(CellResponse, OfAMattSurfaceIsACosineLobeOnItsSide) {
  Bench bench;
  bench.add_surface().base_color = Vec3(1.0F);
  for (const float side : {1.0F, -1.0F}) {
    bench.respond({0.5F, 0.2F, -side});
    EXPECT_NEAR(Bench::sum(bench.scatter), 100.0, 1e-9);
    for (std::uint32_t bin = 0; bin < bench.bins.size(); ++bin) {
      const double flux = static_cast<double>(side) * bench.bins.flux(bin).z;
      EXPECT_NEAR(bench.scatter[bin], std::max(0.0, flux) / kPiDouble * 100.0, 1e-9);
    }
  }
}

TEST(CellResponse, OfSeveralSurfacesIsSharedByWhatTheyShow) {
  Bench bench;
  bench.add_surface({0, 0, 1}, 3.0).base_color = Vec3(1.0F);
  Material& mirror = bench.add_surface({1, 0, 0}, 1.0);
  mirror.metallic = 1.0F;
  mirror.roughness = 0.0F;
  mirror.base_color = Vec3(1.0F);

  bench.respond({-0.6F, 0.01F, -0.8F});

  // The mirror shows 0.6 of 0.6 + 3 * 0.8; the floor sends some there too.
  const double mirrored = 100.0 * 0.6 / (0.6 + 2.4);
  EXPECT_NEAR(Bench::sum(bench.scatter), 100.0, 1e-6);
  EXPECT_NEAR(bench.towards(bench.scatter, {0.6, 0.01, -0.8}), mirrored, 0.01);
}

TEST(CellResponse, OfSurfacesSeenEdgeOnIsSharedByTheirSize) {
  Bench bench;
  bench.add_surface({0, 0, 1}, 3.0).base_color = Vec3(1.0F);
  bench.respond({1.0F, 0.0F, 0.0F});
  EXPECT_NEAR(Bench::sum(bench.scatter), 100.0, 1e-9);
}

TEST(CellResponse, SendsShadowRaysToLightsThatItsSurfacesFace) {
  Bench bench;
  bench.add_surface().base_color = Vec3(1.0F);
  bench.tables.lights = {lamp_at({0.3F, 0.2F, 2.0F}), lamp_at({0.3F, 0.2F, -2.0F})};

  const OutgoingRays outgoing = bench.respond({0.1F, 0.0F, -1.0F});

  EXPECT_NEAR(bench.towards(bench.shadow, {0.3, 0.2, 2.0}), 50.0, 1e-9) << "chosen by power";
  EXPECT_NEAR(Bench::sum(bench.shadow), 50.0, 1e-9) << "the other one is behind the surface";
  EXPECT_EQ(outgoing.shadow_inside, 0.0);
}

TEST(CellResponse, KeepsShadowRaysToItsOwnLights) {
  Bench bench;
  bench.add_surface().base_color = Vec3(1.0F);
  for (const Vec3& place : {Vec3(0.05F, 0.0F, 0.0F), Vec3(0.1F), Vec3(0.0F)}) {
    bench.tables.lights = {lamp_at(place)};
    const OutgoingRays outgoing = bench.respond({0.1F, 0.0F, -1.0F});
    EXPECT_EQ(Bench::sum(bench.shadow), 0.0);
    // From a point, no ray leads to itself.
    EXPECT_EQ(outgoing.shadow_inside, place == Vec3(0.0F) ? 0.0 : 50.0);
  }
}

TEST(CellResponse, SharesShadowRaysBetweenLampsAndSky) {
  Bench bench;
  bench.add_surface().base_color = Vec3(1.0F);
  bench.tables.lights = {lamp_at({0.3F, 0.2F, 2.0F})};
  bench.settings.sky = Vec3(1000.0F);

  bench.respond({0.1F, 0.0F, -1.0F});

  EXPECT_NEAR(Bench::sum(bench.shadow), 100.0, 1e-9);
  EXPECT_NEAR(bench.towards(bench.shadow, {0.3, 0.2, 2.0}), 50.0, 1.0);
}

TEST(CellResponse, EndsPathsByRussianRoulette) {
  Bench bench;
  bench.add_surface().base_color = Vec3(0.5F);
  bench.settings.bounces = 10;
  bench.settings.sky = Vec3(1.0F);

  const OutgoingRays early = bench.respond({0.1F, 0.0F, -1.0F}, 1, 0.25);
  EXPECT_NEAR(Bench::sum(bench.scatter), 100.0, 1e-9);
  EXPECT_NEAR(early.throughput, 0.125, 1e-6);
  const OutgoingRays late = bench.respond({0.1F, 0.0F, -1.0F}, 2, 0.25);
  EXPECT_NEAR(Bench::sum(bench.scatter), 12.5, 1e-5);
  EXPECT_NEAR(late.throughput, 1.0, 1e-6) << "survivors carry the others' light";
}

TEST(CellResponse, EndsAfterTheLastBounce) {
  Bench bench;
  bench.add_surface().base_color = Vec3(1.0F);
  bench.tables.lights = {lamp_at({0.3F, 0.2F, 2.0F})};
  bench.settings.bounces = 2;
  bench.respond({0.1F, 0.0F, -1.0F}, 1);
  EXPECT_EQ(Bench::sum(bench.scatter), 0.0) << "no ray could meet a point light";
  EXPECT_EQ(Bench::sum(bench.shadow), 100.0);
  bench.respond({0.1F, 0.0F, -1.0F}, 2);
  EXPECT_EQ(Bench::sum(bench.shadow), 0.0);
}

}  // namespace
}  // namespace preheat
