#include "master/voxel_view.h"

#include <gtest/gtest.h>

#include <cmath>
#include <optional>
#include <set>
#include <utility>

#include "common/check.h"
#include "common/store.h"
#include "master/compiler.h"
#include "tests/scenes/scratch_folder.h"

namespace preheat {
namespace {

// Two squares of 128 triangles each, left and right of a gap, in the plane z = 0.
Scene two_squares() {
  constexpr std::uint32_t kCells = 8;
  constexpr float kStep = 0.6F / kCells;
  Scene scene;
  scene.materials.resize(1);
  for (const float left : {-0.9F, 0.3F}) {
    for (std::uint32_t cell = 0; cell < kCells * kCells; ++cell) {
      const auto first = static_cast<std::uint32_t>(scene.positions.size());
      const float x = left + kStep * static_cast<float>(cell % kCells);
      const float y = -0.3F + kStep * static_cast<float>(cell / kCells);
      for (const auto& [right, up] : {std::pair{0, 0}, {1, 0}, {1, 1}, {0, 1}}) {
        scene.positions.emplace_back(x + kStep * static_cast<float>(right),
                                     y + kStep * static_cast<float>(up), 0.0F);
      }
      scene.triangles.push_back({{first, first + 1, first + 2}, 0});
      scene.triangles.push_back({{first, first + 2, first + 3}, 0});
    }
  }
  scene.normals.resize(scene.positions.size(), Vec3(0.0F));
  return scene;
}

class VoxelViewOfSquares : public ::testing::Test {
 protected:
  void SetUp() override {
    CompileOptions options;
    options.voxel_size_bytes = 4096;  // not both squares in one
    CHECK(compile_scene(two_squares(), "squares", {1, 2}, options, file()).has_value());
    store_.emplace(*Store::open(file()));
    settings_.width = 60;
    settings_.height = 20;
    settings_.view.origin = {0.0F, 0.0F, 3.0F};
    settings_.view.right = {0.45F, 0.0F, 0.0F};
    settings_.view.up = {0.0F, 0.15F, 0.0F};
  }
  [[nodiscard]] std::filesystem::path file() const { return folder_ / "squares.store"; }
  [[nodiscard]] VoxelView see(std::uint32_t side_max) const {
    return see_voxels(store_->tables(), store_->proxy(), settings_, side_max).value();
  }

  test::ScratchFolder folder_{};
  std::optional<Store> store_{};
  RenderSettings settings_{};
};

TEST_F(VoxelViewOfSquares, ShowsEachSquareInAVoxelThatHoldsItAndTheGapInNone) {
  const VoxelView view = see(1000);

  ASSERT_EQ(view.width, 60U);
  ASSERT_EQ(view.height, 20U);
  std::size_t seen = 0;
  for (std::uint32_t row = 0; row < view.height; ++row) {
    for (std::uint32_t column = 0; column < view.width; ++column) {
      const std::uint32_t voxel = view.voxels[std::size_t{row} * view.width + column];
      // Where the pixel's ray meets the plane of the squares.
      const float x = 3.0F * 0.45F * (2.0F * (static_cast<float>(column) + 0.5F) / 60.0F - 1.0F);
      const float y = -3.0F * 0.15F * (2.0F * (static_cast<float>(row) + 0.5F) / 20.0F - 1.0F);
      const float to_edge = std::min(0.3F - std::abs(y), 0.3F - std::abs(std::abs(x) - 0.6F));
      if (to_edge < -0.06F) { EXPECT_EQ(voxel, VoxelView::kNone) << x << ' ' << y; }
      if (to_edge > 0.06F) {
        ASSERT_LT(voxel, store_->tables().voxels.size()) << x << ' ' << y;
        const Aabb& bounds = store_->tables().voxels[voxel].bounds;
        EXPECT_TRUE(x >= bounds.low.x && x <= bounds.high.x && y >= bounds.low.y &&
                    y <= bounds.high.y)
            << x << ' ' << y;
        ++seen;
      }
    }
  }
  EXPECT_GT(seen, 100U);
}

TEST_F(VoxelViewOfSquares, IsShrunkToTheSideAskedForAndPaintedByVoxel) {
  const VoxelView view = see(30);

  EXPECT_EQ(view.width, 30U);
  EXPECT_EQ(view.height, 10U);
  std::set<std::uint32_t> asked;
  const std::string png = paint_voxels(view, [&](std::uint32_t voxel) {
    asked.insert(voxel);
    return Rgb8{1, 2, 3};
  });
  EXPECT_TRUE(png.starts_with("\x89PNG"));
  EXPECT_GE(asked.size(), 2U);
  EXPECT_LT(*asked.rbegin(), store_->tables().voxels.size());
}

TEST_F(VoxelViewOfSquares, HoldsAPixelAtLeast) {
  settings_.width = 5000;
  settings_.height = 1;

  const VoxelView view = see(10);

  EXPECT_EQ(view.width, 10U);
  EXPECT_EQ(view.height, 1U);
}

}  // namespace
}  // namespace preheat
