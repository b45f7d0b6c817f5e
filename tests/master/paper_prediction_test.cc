// The paper's model on imported scenes: what the file's units and origin may not change.

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numeric>

#include "cache/prediction.h"
#include "common/store.h"
#include "master/compiler.h"
#include "master/import.h"
#include "master/view.h"
#include "tests/master/scene_files.h"

namespace preheat {
namespace {

// A bumpy floor and a bumpy wall on a lattice of sixteenths, scaled and then moved.
std::string obj_text(double scale, double offset) {
  constexpr int kCells = 24;
  std::string text;
  const auto vertex = [&](double x, double y, double z) {
    text += fmt::format("v {:.17g} {:.17g} {:.17g}\n", x * scale + offset, y * scale + offset,
                        z * scale + offset);
  };
  for (int wall = 0; wall < 2; ++wall) {
    for (int i = 0; i <= kCells; ++i) {
      for (int j = 0; j <= kCells; ++j) {
        const double bump = (i * 7 % 5 + j * 3 % 4) / 16.0;
        wall == 0 ? vertex(i, bump, j) : vertex(i, j, bump);
      }
    }
    for (int i = 0; i < kCells; ++i) {
      for (int j = 0; j < kCells; ++j) {
        const int a = 1 + wall * (kCells + 1) * (kCells + 1) + i * (kCells + 1) + j;
        text += fmt::format("f {} {} {} {}\n", a, a + 1, a + kCells + 2, a + kCells + 1);
      }
    }
  }
  return text;
}

struct Outcome {
  Prediction prediction{};
  std::size_t voxels = 0;
};

Outcome predicted(double scale, double offset) {
  const TemporaryFolder folder;
  const auto scene = import_scene(folder.write("scene.obj", obj_text(scale, offset)));
  EXPECT_TRUE(scene.has_value());
  const auto file = folder.path() / "scene.store";
  EXPECT_TRUE(compile_scene(*scene, "scene.obj", {}, {.voxel_size_bytes = 8192}, file));
  const auto store = Store::open(file);
  EXPECT_TRUE(store.has_value());
  ViewOptions options;
  options.size = {64, 48};
  options.eye = Vec3d(20.0, 15.0, 30.0) * scale + offset;
  options.look_at = Vec3d(12.0, 6.0, 6.0) * scale + offset;
  const auto view = resolve_view(store->tables(), {}, options);
  EXPECT_TRUE(view.has_value());
  const auto prediction = predict(
      "paper", PredictionInput{store->tables(), store->proxy(), view->settings, 2, &*store});
  EXPECT_TRUE(prediction.has_value());
  return {*prediction, store->tables().voxels.size()};
}

void expect_alike(const std::vector<double>& values, const std::vector<double>& expected,
                  double error) {
  ASSERT_EQ(values.size(), expected.size());
  const double sum = std::accumulate(expected.begin(), expected.end(), 0.0);
  for (std::size_t i = 0; i < values.size(); ++i) {
    EXPECT_NEAR(values[i], expected[i], error * sum);
  }
}

TEST(PaperPrediction, DoesNotDependOnTheFilesUnit) {
  const Outcome one = predicted(1.0, 0.0);
  ASSERT_GT(one.voxels, 4U);
  for (const double scale : {std::ldexp(1.0, -20), std::ldexp(1.0, 20)}) {
    const Outcome scaled = predicted(scale, 0.0);
    EXPECT_EQ(scaled.voxels, one.voxels);
    expect_alike(scaled.prediction.nodes.rays_camera, one.prediction.nodes.rays_camera, 1e-6);
    expect_alike(scaled.prediction.nodes.rays_scatter, one.prediction.nodes.rays_scatter, 1e-4);
    expect_alike(scaled.prediction.rays_shadow, one.prediction.rays_shadow, 1e-4);
  }
}

TEST(PaperPrediction, DoesNotDependOnTheFilesOrigin) {
  const Outcome one = predicted(1.0, 0.0);
  const Outcome moved = predicted(1.0, 1e6);
  EXPECT_EQ(moved.voxels, one.voxels);
  expect_alike(moved.prediction.nodes.rays_camera, one.prediction.nodes.rays_camera, 1e-5);
  expect_alike(moved.prediction.nodes.rays_scatter, one.prediction.nodes.rays_scatter, 1e-3);
  EXPECT_GT(moved.prediction.shadow_total, 0.0);
}

}  // namespace
}  // namespace preheat
