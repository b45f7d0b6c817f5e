#include "cache/paper_model.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "cache/cell_response.h"
#include "cache/cell_surfaces.h"
#include "cache/voxel_projection.h"
#include "common/math.h"
#include "tests/cache/transport_truth.h"
#include "tests/common/triangle_scene.h"
#include "tests/scenes/scratch_folder.h"
#include "tests/scenes/soups.h"
#include "tests/scenes/store_of_scene.h"

namespace preheat {
namespace {

using test::look_at;
using test::ScratchFolder;
using testing::HasSubstr;

double sum_of(const std::vector<double>& values) {
  return std::accumulate(values.begin(), values.end(), 0.0);
}

RenderSettings settings_of(const View& view, std::uint32_t size = 64, std::uint32_t spp = 4) {
  RenderSettings settings;
  settings.view = view;
  settings.width = settings.height = size;
  settings.spp = spp;
  return settings;
}

void add_quad(Scene& scene, const Vec3& corner, const Vec3& u, const Vec3& v, int cuts,
              std::uint32_t material = 0) {
  const Vec3 du = u / static_cast<float>(cuts);
  const Vec3 dv = v / static_cast<float>(cuts);
  for (int i = 0; i < cuts; ++i) {
    for (int j = 0; j < cuts; ++j) {
      const Vec3 at = corner + static_cast<float>(i) * du + static_cast<float>(j) * dv;
      test::add_triangle(scene, at, at + du, at + du + dv, material);
      test::add_triangle(scene, at, at + du + dv, at + dv, material);
    }
  }
}

// A room of [-0.9, 0.9]^3 whose walls are finely cut, with normals inwards.
Scene room(int cuts) {
  Scene scene = test::empty_scene();
  scene.materials[0].specular_color = Vec3(0.0F);
  const float a = 0.9F;
  const Vec3 x(2.0F * a, 0.0F, 0.0F);
  const Vec3 y(0.0F, 2.0F * a, 0.0F);
  const Vec3 z(0.0F, 0.0F, 2.0F * a);
  add_quad(scene, Vec3(-a), x, z, cuts);
  add_quad(scene, Vec3(-a, a, -a), z, x, cuts);
  add_quad(scene, Vec3(-a), z, y, cuts);
  add_quad(scene, Vec3(a, -a, -a), y, z, cuts);
  add_quad(scene, Vec3(-a), y, x, cuts);
  add_quad(scene, Vec3(-a, -a, a), x, y, cuts);
  return scene;
}

PunctualLight lamp_at(const Vec3& position) {
  PunctualLight lamp;
  lamp.position = position;
  lamp.intensity = Vec3(1.0F);
  return lamp;
}

class PaperModel : public ::testing::Test {
 protected:
  // Voxels far smaller than the cells of a cut at depth 2.
  void compile(const Scene& scene, std::uint32_t voxel_references_max = 64) {
    Result<Store> store = test::store_of_scene(scene, voxel_references_max, folder_ / "a.store");
    ASSERT_TRUE(store) << store.error().message;
    store_ = *std::move(store);
  }
  [[nodiscard]] Result<Prediction> run(const RenderSettings& settings, const PaperKnobs& knobs = {},
                                       unsigned threads = 2) const {
    return predict("paper", PredictionInput{store_->tables(), store_->proxy(), settings, threads,
                                            &*store_, PredictionKnobs{.paper = knobs}});
  }
  [[nodiscard]] Prediction predicted(const RenderSettings& settings,
                                     const PaperKnobs& knobs = {}) const {
    Result<Prediction> prediction = run(settings, knobs);
    EXPECT_TRUE(prediction) << (prediction ? "" : prediction.error().message);
    return *std::move(prediction);
  }
  [[nodiscard]] OctreeCut cut(std::uint32_t depth = 2) const {
    return cut_octree(store_->octree_summary(), depth);
  }

  ScratchFolder folder_{};
  std::optional<Store> store_{};
};

void expect_sane(const Prediction& prediction) {
  for (const auto* rays : {&prediction.rays_camera, &prediction.rays_scatter,
                           &prediction.rays_shadow, &prediction.nodes.rays_camera,
                           &prediction.nodes.rays_scatter, &prediction.nodes.rays_shadow}) {
    for (const double value : *rays) {
      ASSERT_TRUE(std::isfinite(value));
      ASSERT_GE(value, 0.0);
    }
  }
  ASSERT_TRUE(std::isfinite(prediction.rays_total()));
}

TEST_F(PaperModel, WantsAStore) {
  compile(room(4));
  const RenderSettings settings;
  const auto prediction =
      predict("paper", PredictionInput{store_->tables(), store_->proxy(), settings, 1});
  ASSERT_FALSE(prediction);
  EXPECT_EQ(prediction.error().code, ExitCode::kUsage);
  EXPECT_THAT(prediction.error().message, HasSubstr("needs a store"));
}

TEST_F(PaperModel, NamesAKnobThatIsOutOfRange) {
  compile(room(4));
  const RenderSettings settings = settings_of(look_at({0, 0, -0.5F}, Vec3(0.0F), 0.5F));
  for (const auto& [knobs, what] :
       {std::pair{PaperKnobs{.depth = 6}, "depth is 6, must be within 0..5"},
        std::pair{PaperKnobs{.bins_polar = 0}, "polar bins is 0"},
        std::pair{PaperKnobs{.bins_azimuth = 129}, "azimuth bins is 129"}}) {
    const auto prediction = run(settings, knobs);
    ASSERT_FALSE(prediction);
    EXPECT_EQ(prediction.error().code, ExitCode::kUsage);
    EXPECT_THAT(prediction.error().message, HasSubstr(what));
  }
}

TEST_F(PaperModel, RefusesMoreBinsThanItsTimeIsBoundedFor) {
  compile(room(60));
  ASSERT_GT(cut(5).cells.size(), 512U);
  const auto prediction = run(settings_of(look_at({0, 0, -0.5F}, Vec3(0.0F), 0.5F)),
                              {.depth = 5, .bins_polar = 64, .bins_azimuth = 128});
  ASSERT_FALSE(prediction);
  EXPECT_EQ(prediction.error().code, ExitCode::kUsage);
  EXPECT_THAT(prediction.error().message, HasSubstr("at most 4194304"));
}

// Section 4: pixels of the clipped projection times samples; section 7: times C_t.
TEST_F(PaperModel, CountsPrimaryRaysByPixels) {
  compile(room(24));
  const RenderSettings settings =
      settings_of(look_at({0.1F, 0.2F, -0.6F}, {0.3F, 0.0F, 1.0F}, 0.5F));
  const auto projection = VoxelProjection::create(settings.view, settings.width, settings.height);

  const Prediction prediction = predicted(settings, {.bounces_exchanged = 0});

  const OctreeCut cells = cut();
  ASSERT_EQ(prediction.nodes.rays_camera.size(), cells.cells.size());
  for (std::size_t i = 0; i < cells.cells.size(); ++i) {
    const OctreeSums& sums = store_->octree_summary().nodes[cells.cells[i].node].sums;
    EXPECT_DOUBLE_EQ(
        prediction.nodes.rays_camera[i],
        4.0 * projection->pixels(projection->outline(cells.cells[i].cell)) * sums.traversal_cost());
  }
  EXPECT_EQ(prediction.camera_total, 64.0 * 64.0 * 4.0);
  EXPECT_EQ(prediction.scatter_total, 0.0);
  EXPECT_EQ(prediction.shadow_total, 0.0);
  EXPECT_GT(sum_of(prediction.rays_camera), prediction.camera_total);
}

TEST_F(PaperModel, ShowsTheFaultOfFigure7WhenAsked) {
  compile(room(24));
  // Beside a cell that lies behind the eye but for a strip that the image does not reach.
  const RenderSettings settings =
      settings_of(look_at({0.4F, 0.1F, -0.05F}, {0.4F, 0.1F, 1.0F}, 0.5F));
  const Prediction mended = predicted(settings, {.bounces_exchanged = 0});
  const Prediction printed = predicted(settings, {.bounces_exchanged = 0, .as_printed = true});
  std::size_t more = 0;
  for (std::size_t i = 0; i < mended.nodes.rays_camera.size(); ++i) {
    more += printed.nodes.rays_camera[i] > mended.nodes.rays_camera[i] + 1.0 ? 1U : 0U;
  }
  EXPECT_GT(more, 0U);
}

// A closed white room: each camera ray scatters, and samples the lamp, once per vertex.
TEST_F(PaperModel, FollowsAsManyRaysAsTheRendererTraces) {
  Scene scene = room(24);
  scene.materials[0].base_color = Vec3(1.0F);
  scene.lights = {lamp_at(Vec3(0.0F, 0.5F, 0.0F))};
  compile(scene);
  RenderSettings settings = settings_of(look_at({0.1F, 0.2F, -0.6F}, {0.3F, 0.0F, 1.0F}, 0.5F));
  settings.bounces = 2;

  const Prediction prediction = predicted(settings);

  const double camera = prediction.camera_total;
  // With nothing but a point light, the last scattered ray could find no emission.
  EXPECT_NEAR(prediction.scatter_total, camera, 1e-9 * camera);
  EXPECT_LE(prediction.shadow_total, 2.0 * camera * (1.0 + 1e-9));
  EXPECT_GT(prediction.shadow_total, 1.2 * camera);
  EXPECT_GT(sum_of(prediction.nodes.rays_scatter), prediction.scatter_total);
  expect_sane(prediction);
}

TEST_F(PaperModel, HasNoRayThatTheSceneDoesNotCallFor) {
  const View view = look_at({0.1F, 0.2F, -0.6F}, {0.3F, 0.0F, 1.0F}, 0.5F);
  compile(room(12));
  Prediction prediction = predicted(settings_of(view));
  EXPECT_EQ(prediction.shadow_total, 0.0) << "no light";

  RenderSettings sky = settings_of(view);
  sky.sky = Vec3(1.0F);
  prediction = predicted(sky);
  EXPECT_GT(prediction.shadow_total, 0.0);
  sky.bounces = 0;
  prediction = predicted(sky);
  EXPECT_EQ(prediction.shadow_total + prediction.scatter_total, 0.0) << "no bounce";

  Scene mirrors = room(12);
  mirrors.materials[0].metallic = 1.0F;
  mirrors.materials[0].roughness = 0.0F;
  mirrors.lights = {lamp_at(Vec3(0.0F))};
  compile(mirrors);
  prediction = predicted(settings_of(view));
  EXPECT_EQ(prediction.shadow_total, 0.0) << "mirrors sample no light";
  EXPECT_GT(prediction.scatter_total, 0.0);

  Scene black = room(12);
  black.materials[0].base_color = Vec3(0.0F);
  compile(black);
  prediction = predicted(sky);
  EXPECT_EQ(prediction.scatter_total, 0.0) << "nothing scatters";
}

TEST_F(PaperModel, IsTheSameOnAnyNumberOfThreads) {
  compile(test::make_room(2, 3));
  const RenderSettings settings = test::room_settings(64, 2);
  for (const PaperOcclusion occlusion :
       {PaperOcclusion::kRatio, PaperOcclusion::kAsPrinted, PaperOcclusion::kArrival}) {
    const auto one = run(settings, {.occlusion = occlusion}, 1);
    const auto many = run(settings, {.occlusion = occlusion}, 7);
    ASSERT_TRUE(one && many);
    expect_sane(*one);
    EXPECT_EQ(one->nodes.rays_camera, many->nodes.rays_camera);
    EXPECT_EQ(one->nodes.rays_scatter, many->nodes.rays_scatter);
    EXPECT_EQ(one->nodes.rays_shadow, many->nodes.rays_shadow);
    EXPECT_EQ(one->rays_shadow, many->rays_shadow);
    EXPECT_EQ(one->shadow_total, many->shadow_total);
  }
}

TEST_F(PaperModel, IsSaneAtEveryDepthAndNumberOfBins) {
  compile(test::make_room(1, 3));
  const RenderSettings settings = test::room_settings(32, 1);
  for (unsigned depth = 0; depth <= 3; ++depth) {
    for (const auto& [polar, azimuth] : {std::pair{1U, 1U}, {6U, 12U}, {5U, 7U}}) {
      const Prediction prediction =
          predicted(settings, {.depth = depth, .bins_polar = polar, .bins_azimuth = azimuth});
      EXPECT_EQ(prediction.nodes.depth, depth);
      EXPECT_LE(prediction.nodes.rays_camera.size(), std::size_t{1} << 3U * depth);
      expect_sane(prediction);
    }
  }
}

Vec3 quarter_turn(const Vec3& v) { return {-v.y, v.x, v.z}; }

// E8: a room that looks the same after a quarter turn about z, with its camera and its lamp turned.
TEST_F(PaperModel, TurnsWithTheScene) {
  Scene scene = room(24);
  scene.lights = {lamp_at({0.2F, 0.5F, 0.1F})};
  RenderSettings settings = settings_of(look_at({0.1F, 0.3F, -0.6F}, {0.3F, 0.0F, 1.0F}, 0.5F));
  compile(scene);
  const OctreeCut cells = cut(1);
  const Prediction before = predicted(settings, {.depth = 1});

  scene.lights[0].position = quarter_turn(scene.lights[0].position);
  for (Vec3* axis :
       {&settings.view.origin, &settings.view.forward, &settings.view.right, &settings.view.up}) {
    *axis = quarter_turn(*axis);
  }
  compile(scene);
  const Prediction after = predicted(settings, {.depth = 1});

  ASSERT_EQ(cells.cells.size(), 8U);
  const auto rays_of = [&](const std::vector<double>& traversals, std::size_t i) {
    return traversals[i] /
           store_->octree_summary().nodes[cells.cells[i].node].sums.traversal_cost();
  };
  for (std::size_t i = 0; i < 8; ++i) {
    const Vec3 centre = quarter_turn(0.5F * (cells.cells[i].cell.low + cells.cells[i].cell.high));
    std::size_t turned = 0;
    for (std::size_t j = 0; j < 8; ++j) {
      const Aabb& cell = cells.cells[j].cell;
      if (glm::length(0.5F * (cell.low + cell.high) - centre) < 0.01F) { turned = j; }
    }
    for (const auto rays : {&NodePrediction::rays_camera, &NodePrediction::rays_scatter,
                            &NodePrediction::rays_shadow}) {
      const double expected = rays_of(before.nodes.*rays, i);
      EXPECT_NEAR(rays_of(after.nodes.*rays, turned), expected, 1e-3 * expected + 1e-9) << i;
    }
  }
  EXPECT_GT(sum_of(after.nodes.rays_scatter), 0.0);
}

// The prediction for voxels of some cells, for the same cells in another order.
Prediction in_order_of(const Prediction& prediction, const std::vector<Aabb>& from,
                       const std::vector<Aabb>& to) {
  Prediction ordered = prediction;
  for (std::size_t voxel = 0; voxel < to.size(); ++voxel) {
    const auto found = std::find_if(from.begin(), from.end(), [&](const Aabb& cell) {
      return cell.low == to[voxel].low && cell.high == to[voxel].high;
    });
    const auto place = static_cast<std::size_t>(found - from.begin());
    EXPECT_LT(place, from.size());
    ordered.rays_camera[voxel] = prediction.rays_camera.at(place);
    ordered.rays_scatter[voxel] = prediction.rays_scatter.at(place);
    ordered.rays_shadow[voxel] = prediction.rays_shadow.at(place);
  }
  return ordered;
}

// The room of the transport tests against counted rays: what is hot is found, and the number of
// rays is about right.
TEST_F(PaperModel, FindsWhatIsHotInARoom) {
  const test::CompiledScene compiled = test::compile_in_memory(test::make_room(6, 3), 200);
  const RenderSettings settings = test::room_settings(48, 2);
  const Prediction counted = test::count_accesses(compiled, settings);
  const Result<Store> store = test::store_of_scene(compiled.scene, 200, folder_ / "room.store");
  ASSERT_TRUE(store);

  const auto prediction =
      predict("paper", PredictionInput{store->tables(), store->proxy(), settings, 2, &*store});

  ASSERT_TRUE(prediction) << prediction.error().message;
  const Prediction ordered = in_order_of(*prediction, store->proxy().cells, compiled.proxy.cells);
  const test::Agreement agreement = test::compare(compiled.tables, ordered, counted);
  EXPECT_GT(agreement.pearson, 0.7);
  EXPECT_NEAR(agreement.total, 1.0, 0.35);
  EXPECT_GT(agreement.capture[1], 0.9 * agreement.capture_best[1]);
  EXPECT_EQ(prediction->camera_total, counted.camera_total);
  EXPECT_NEAR(prediction->scatter_total / counted.scatter_total, 1.0, 0.25);
  EXPECT_NEAR(prediction->shadow_total / counted.shadow_total, 1.0, 0.35);
}

// E10
TEST_F(PaperModel, AnswersForScenesWithNearlyNothing) {
  const View view = look_at({0.1F, 0.2F, -3.0F}, Vec3(0.0F), 0.5F);
  compile(test::empty_scene());
  const Prediction nothing = predicted(settings_of(view));
  EXPECT_EQ(nothing.camera_total, 64.0 * 64.0 * 4.0);
  EXPECT_TRUE(nothing.rays_camera.empty());

  Scene one = test::empty_scene();
  test::add_triangle(one, {0, 0, 0}, {0.5F, 0, 0}, {0, 0.5F, 0});
  compile(one);
  for (const unsigned depth : {0U, 2U, 5U}) {
    const Prediction prediction = predicted(settings_of(view), {.depth = depth});
    ASSERT_EQ(prediction.rays_camera.size(), 1U);
    EXPECT_EQ(prediction.nodes.rays_camera.size(), 1U);
    EXPECT_GT(prediction.rays_camera[0], 0.0);
    EXPECT_EQ(prediction.nodes.rays_scatter[0], 0.0) << "a cell sends nothing to itself";
    expect_sane(prediction);
  }
  const Prediction away =
      predicted(settings_of(look_at({0.1F, 0.2F, -3.0F}, {0.0F, 0.0F, -9.0F}, 0.5F)));
  EXPECT_EQ(away.rays_camera[0], 0.0);
  EXPECT_EQ(away.scatter_total, 0.0);
  expect_sane(away);
}

// E11: point lights in a cell, on its faces, at its very centre and outside the octree; area
// lights.
TEST_F(PaperModel, TakesLightsAnywhere) {
  const RenderSettings settings =
      settings_of(look_at({0.1F, 0.2F, -0.6F}, {0.3F, 0.0F, 1.0F}, 0.5F));
  Scene scene = room(12);
  compile(scene);
  const Aabb cell = cut().cells[5].cell;
  const Vec3 centre = 0.5F * (cell.low + cell.high);
  for (const Vec3& place : {centre, cell.low, Vec3(cell.low.x, centre.y, centre.z),
                            Vec3(50.0F, 3.0F, -20.0F), Vec3(0.0F)}) {
    scene.lights = {lamp_at(place)};
    compile(scene);
    const Prediction prediction = predicted(settings);
    EXPECT_GT(prediction.shadow_total, 0.0);
    expect_sane(prediction);
  }
  scene.lights.assign(2, lamp_at(Vec3(0.0F)));
  scene.lights[0].intensity = Vec3(0.0F);
  scene.lights[1].kind = PunctualLightKind::kDirectional;
  compile(scene);
  expect_sane(predicted(settings));
  scene.lights.resize(1);  // only the one without power
  compile(scene);
  EXPECT_EQ(predicted(settings).shadow_total, 0.0);
}

// The busiest cells of shadow rays are the lamp's and its neighbours'.
TEST_F(PaperModel, RanksTheVoxelOfTheLight) {
  Scene scene = room(16);
  scene.materials.resize(2);
  scene.materials[1].emission = Vec3(5.0F);
  const Vec3 lamp(-0.35F, 0.65F, 0.35F);
  add_quad(scene, lamp, {0.1F, 0, 0}, {0, 0, 0.1F}, 3, 1);
  compile(scene);

  const Prediction prediction =
      predicted(settings_of(look_at({0.1F, 0.2F, -0.6F}, {0.3F, 0.0F, 1.0F}, 0.5F)));

  const OctreeCut cells = cut();
  std::size_t busiest = 0;
  std::vector<double> rays = prediction.nodes.rays_shadow;
  for (std::size_t i = 0; i < rays.size(); ++i) {
    rays[i] /= store_->octree_summary().nodes[cells.cells[i].node].sums.traversal_cost();
    if (rays[i] > rays[busiest]) { busiest = i; }
  }
  const Aabb& cell = cells.cells[busiest].cell;
  const Vec3 centre = 0.5F * (cell.low + cell.high);
  EXPECT_LT(glm::length(centre - lamp), 0.6F);
}

TEST_F(PaperModel, TakesAHundredThousandLights) {
  Scene scene = room(6);
  scene.materials.resize(2);
  scene.materials[1].emission = Vec3(5.0F);
  test::SoupRandom random(3);
  while (scene.triangles.size() < 50'000) {
    const Vec3 at = random.in_cube(-0.85F, 0.85F);
    test::add_triangle(scene, at, at + Vec3(0.002F, 0, 0), at + Vec3(0, 0.002F, 0), 1);
  }
  scene.lights.assign(50'000, lamp_at(Vec3(0.1F)));
  compile(scene, 2000);
  expect_sane(predicted(settings_of(look_at({0.1F, 0.2F, -0.6F}, {0.3F, 0.0F, 1.0F}, 0.5F))));
}

// A planar scene, and triangles that are none (E12).
TEST_F(PaperModel, TakesScenesWithoutThicknessAndTrianglesWithoutArea) {
  Scene scene = test::empty_scene();
  add_quad(scene, {-0.9F, 0.25F, -0.9F}, {1.8F, 0, 0}, {0, 0, 1.8F}, 20);
  for (int i = 0; i < 100; ++i) {
    const Vec3 at(0.01F * static_cast<float>(i) - 0.5F, 0.25F, 0.1F);
    test::add_triangle(scene, at, at, at);
    test::add_triangle(scene, at, at + Vec3(0.1F, 0, 0), at + Vec3(0.2F, 0, 0));
  }
  compile(scene);
  RenderSettings settings = settings_of(look_at({0.1F, 0.9F, -0.6F}, Vec3(0.0F), 0.5F));
  settings.sky = Vec3(1.0F);
  const Prediction prediction = predicted(settings);
  expect_sane(prediction);
  EXPECT_GT(prediction.shadow_total, 0.0);
}

// Section 6: the corrected probability of arriving counts fewer rays behind other cells.
TEST_F(PaperModel, BlocksRaysOnTheirWayWhenAsked) {
  Scene scene = room(16);
  scene.lights = {lamp_at(Vec3(0.2F, 0.1F, 0.0F))};
  compile(scene);
  const RenderSettings settings =
      settings_of(look_at({0.1F, 0.2F, -0.6F}, {0.3F, 0.0F, 1.0F}, 0.5F));
  const Prediction ratio = predicted(settings, {.bounces_exchanged = 1});
  const Prediction arrival =
      predicted(settings, {.bounces_exchanged = 1, .occlusion = PaperOcclusion::kArrival});
  const Prediction printed =
      predicted(settings, {.bounces_exchanged = 1, .occlusion = PaperOcclusion::kAsPrinted});
  EXPECT_EQ(arrival.nodes.rays_camera, ratio.nodes.rays_camera) << "pixels stay pixels";
  const auto per_ray = [](const Prediction& prediction) {
    return sum_of(prediction.nodes.rays_scatter) / prediction.scatter_total;
  };
  EXPECT_LT(per_ray(arrival), per_ray(ratio));
  EXPECT_NE(printed.nodes.rays_scatter, arrival.nodes.rays_scatter);
}

// A triangle counts where it lies, once, however voxels and cells cut it.
TEST_F(PaperModel, GathersTheAreaOfEveryTriangleOnce) {
  Scene scene = test::soup(600, 0.2F, 12);
  double expected = 0.0;
  for (const Triangle& triangle : scene.triangles) {
    const Vec3d a(scene.positions[triangle.vertices[0]]);
    const Vec3d b(scene.positions[triangle.vertices[1]]);
    const Vec3d c(scene.positions[triangle.vertices[2]]);
    expected += 0.5 * glm::length(glm::cross(b - a, c - a));
  }
  for (const std::uint32_t voxel_references_max : {20U, 100'000U}) {
    compile(scene, voxel_references_max);
    for (const std::uint32_t depth : {0U, 1U, 2U, 4U}) {
      const auto groups = gather_surfaces(*store_, cut(depth));
      ASSERT_TRUE(groups) << groups.error().message;
      double area = 0.0;
      for (const std::vector<SurfaceGroup>& cell : *groups) {
        for (const SurfaceGroup& group : cell) {
          EXPECT_NEAR(glm::length(group.normal), 1.0F, 1e-5F);
          area += group.area;
        }
      }
      EXPECT_NEAR(area, expected, 1e-5 * expected)
          << voxel_references_max << " references a voxel, depth " << depth;
    }
  }
}

// Once around: what a cell answers is the same whether its wall is two triangles or many.
TEST_F(PaperModel, DoesNotDependOnHowFinelyASurfaceIsCut) {
  Scene coarse = room(16);
  Scene fine = room(32);
  for (Scene* scene : {&coarse, &fine}) { scene->lights = {lamp_at(Vec3(0.1F))}; }
  const RenderSettings settings =
      settings_of(look_at({0.1F, 0.2F, -0.6F}, {0.3F, 0.0F, 1.0F}, 0.5F));
  compile(coarse);
  const Prediction one = predicted(settings);
  const std::size_t cells = cut().cells.size();
  compile(fine);
  const Prediction other = predicted(settings);
  ASSERT_EQ(cut().cells.size(), cells);
  EXPECT_NEAR(one.scatter_total, other.scatter_total, 1e-3 * one.scatter_total);
  EXPECT_NEAR(one.shadow_total, other.shadow_total, 0.01 * one.shadow_total);
}

TEST_F(PaperModel, SaysThatABlockIsDamaged) {
  compile(room(8));
  const std::filesystem::path file = folder_ / "a.store";
  std::string content = test::read_file(file);
  content[4096 + 4] = '\x7f';  // the first block's vertex count
  test::write_file(folder_ / "b.store", content);
  const Result<Store> store = Store::open(folder_ / "b.store");
  ASSERT_TRUE(store);
  const RenderSettings settings = settings_of(look_at({0, 0, -0.5F}, Vec3(0.0F), 0.5F));
  const auto prediction =
      predict("paper", PredictionInput{store->tables(), store->proxy(), settings, 1, &*store});
  ASSERT_FALSE(prediction);
  EXPECT_EQ(prediction.error().code, ExitCode::kStoreDamaged);
  EXPECT_THAT(prediction.error().message, HasSubstr("voxel 0"));
}

}  // namespace
}  // namespace preheat
