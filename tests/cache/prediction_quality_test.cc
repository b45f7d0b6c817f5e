// How well predictions rank voxels, over scenes that nobody looked at.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>
#include <random>

#include "cache/evaluation.h"
#include "common/math.h"
#include "tests/cache/transport_truth.h"
#include "tests/scenes/soups.h"

namespace preheat {
namespace {

using test::CompiledScene;
using test::SoupRandom;

// A furnished room, a soup of loose triangles or a bumpy sheet, under lamps or a sky.
Scene random_scene(std::uint32_t seed, SoupRandom& random) {
  switch (seed % 3) {
    case 0:
      return test::make_room(1 + random.below(3), seed);
    case 1:
      break;
    default:
      return test::sheet(20 + random.below(60));
  }
  Scene scene = test::soup(500 + random.below(4000), random.in(0.02F, 0.2F), seed);
  Material& lamp = scene.materials.emplace_back();
  lamp.emission = Vec3(5.0F);
  for (std::size_t id = 0; id < scene.triangles.size(); id += 50) {
    scene.triangles[id].material = 1;
  }
  return scene;
}

RenderSettings random_settings(std::uint32_t seed, SoupRandom& random) {
  RenderSettings settings = test::room_settings(/*size=*/64, /*spp=*/1);
  settings.seed = seed;
  settings.bounces = 1 + random.below(5);
  if (seed % 3 != 0) { settings.sky = Vec3(1.0F); }
  const Vec3 target = random.in_cube(-0.3F, 0.3F);
  settings.view.origin = random.in_cube(-0.8F, 0.8F);
  settings.view.forward = glm::normalize(target - settings.view.origin);
  const OrthonormalFrame frame(settings.view.forward);
  const float tangent = random.in(0.3F, 1.0F);
  settings.view.right = frame.tangent * tangent;
  settings.view.up = frame.bitangent * tangent;
  return settings;
}

std::vector<double> all_rays(const Prediction& prediction) {
  std::vector<double> rays;
  for (std::size_t voxel = 0; voxel < prediction.rays_camera.size(); ++voxel) {
    rays.push_back(prediction.rays(voxel));
  }
  return rays;
}

// In some of these scenes few voxels are entered by more than a handful of rays, and the order of
// the others is chance: so one or two scenes may rank otherwise, and the goal is the median's.
TEST(PredictionQuality, TransportRanksTheVoxelsOfTwentyRandomScenes) {
  constexpr std::uint32_t kScenes = 20;
  std::vector<double> correlations;
  std::uint32_t better_than_blind = 0;
  for (std::uint32_t seed = 1; seed <= kScenes; ++seed) {
    SoupRandom random(seed);
    const CompiledScene compiled = test::compile_in_memory(random_scene(seed, random), 150);
    const RenderSettings settings = random_settings(seed, random);
    const PredictionInput input{compiled.tables, compiled.proxy, settings, 1};

    const std::vector<double> counted = all_rays(test::count_accesses(compiled, settings));
    const Evaluation transport = evaluate(all_rays(*predict("transport", input)), counted);
    const Evaluation blind = evaluate(all_rays(*predict("surface-area", input)), counted);

    std::printf(
        "seed=%u triangles %zu voxels %zu spearman %.3f pearson %.3f total %.3f, "
        "surface-area %.3f\n",
        seed, compiled.scene.triangles.size(), counted.size(), *transport.spearman,
        *transport.pearson, *transport.total_ratio, *blind.spearman);
    better_than_blind += *transport.spearman > *blind.spearman ? 1U : 0U;
    correlations.push_back(*transport.spearman);
  }
  std::sort(correlations.begin(), correlations.end());
  std::printf("spearman least %.3f median %.3f\n", correlations.front(), correlations[kScenes / 2]);
  EXPECT_GE(correlations[kScenes / 2], 0.7);
  EXPECT_GE(better_than_blind, kScenes - 2);
}

}  // namespace
}  // namespace preheat
