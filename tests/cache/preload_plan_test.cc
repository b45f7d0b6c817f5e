#include "cache/preload_plan.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <random>

#include "cache/tracing.h"

namespace preheat {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

struct Voxel {
  double rays = 0.0;
  std::uint64_t bytes = 0;
};

constexpr double kAuto = -1.0;

SceneTables tables_of(const std::vector<Voxel>& voxels) {
  SceneTables tables;
  for (const Voxel& voxel : voxels) {
    tables.voxels.emplace_back();
    tables.voxels.back().resident_bytes = voxel.bytes;
  }
  return tables;
}

PreloadPlan plan(const std::vector<Voxel>& voxels, std::uint64_t cache_limit_bytes, double share) {
  Prediction prediction;
  for (const Voxel& voxel : voxels) { prediction.rays_camera.push_back(voxel.rays); }
  prediction.rays_scatter.resize(voxels.size(), 0.0);
  prediction.rays_shadow.resize(voxels.size(), 0.0);
  return plan_preload(tables_of(voxels), prediction, cache_limit_bytes, share);
}

TEST(PreloadPlan, TakesTheMostRaysPerByteFirst) {
  const std::vector<Voxel> voxels{{10.0, 10}, {30.0, 10}, {40.0, 20}, {5.0, 1}, {0.0, 10}};

  const PreloadPlan result = plan(voxels, /*cache_limit_bytes=*/31 + 10, /*share=*/1.0);

  EXPECT_THAT(result.hot, ElementsAre(VoxelId{3}, VoxelId{1}, VoxelId{2}));
  EXPECT_EQ(result.hot_bytes, 31U);
}

TEST(PreloadPlan, BreaksTiesByVoxelId) {
  const std::vector<Voxel> voxels{{2.0, 20}, {1.0, 10}, {3.0, 30}, {1.0, 10}};

  const PreloadPlan result = plan(voxels, /*cache_limit_bytes=*/100, /*share=*/1.0);

  EXPECT_THAT(result.hot, ElementsAre(VoxelId{0}, VoxelId{1}, VoxelId{2}, VoxelId{3}));
}

TEST(PreloadPlan, HoldsNothingWithoutABudget) {
  const std::vector<Voxel> voxels{{1.0, 10}, {2.0, 10}};

  EXPECT_THAT(plan(voxels, 0, 1.0).hot, IsEmpty());
  EXPECT_THAT(plan(voxels, 9, 1.0).hot, IsEmpty());
  EXPECT_THAT(plan(voxels, 20, 0.0).hot, IsEmpty());
  EXPECT_THAT(plan({}, 20, 1.0).hot, IsEmpty());
}

TEST(PreloadPlan, HoldsEverythingWhereTheCacheDoes) {
  const std::vector<Voxel> voxels{{1.0, 10}, {2.0, 90}, {1.0, 20}};

  EXPECT_EQ(plan(voxels, 120, kAuto).hot_bytes, 120U);
  EXPECT_EQ(plan(voxels, std::numeric_limits<std::uint64_t>::max(), kAuto).hot_bytes, 120U);
}

TEST(PreloadPlan, LeavesRoomForEveryVoxelThatRaysAreExpectedToEnter) {
  // 40 bytes a triangle in the block, 100 more in the hot BVH, as real voxels have.
  SceneTables tables;
  Prediction prediction;
  constexpr std::uint32_t kTriangles = 1000;
  for (int voxel = 0; voxel < 100; ++voxel) {
    tables.voxels.emplace_back();
    tables.voxels.back().triangle_count = kTriangles;
    tables.voxels.back().block_bytes = 40 * kTriangles;
    tables.voxels.back().resident_bytes = 140 * kTriangles;
    prediction.rays_camera.push_back(voxel < 80 ? 100.0 - voxel : 0.0);
  }
  prediction.rays_scatter.resize(100, 0.0);
  prediction.rays_shadow.resize(100, 0.0);
  const std::uint64_t cold_bytes = 40 * kTriangles + VoxelMesh::bytes_max(kTriangles);
  const auto hot_count = [&](std::uint64_t limit) {
    return plan_preload(tables, prediction, limit, kAuto).hot.size();
  };

  // All 80 fit cold, with room to make 60 of them hot.
  const std::uint64_t limit = 60 * tables.voxels[0].resident_bytes + 20 * cold_bytes;
  EXPECT_EQ(hot_count(limit), 60U);
  EXPECT_EQ(hot_count(limit - 1), 59U);
  // Not even half of them fit: three tenths of the room.
  EXPECT_EQ(hot_count(40 * cold_bytes), 40 * cold_bytes * 3 / 10 / tables.voxels[0].resident_bytes);
}

TEST(PreloadPlan, LeavesRoomForTheLargestVoxelThatIsNotHot) {
  const std::vector<Voxel> voxels{{50.0, 50}, {9.0, 10}, {8.0, 10}, {1.0, 20}};

  EXPECT_EQ(plan(voxels, 90, 1.0).hot_bytes, 90U);
  EXPECT_THAT(plan(voxels, 89, 1.0).hot, ElementsAre(VoxelId{0}, VoxelId{1}));
  EXPECT_THAT(plan(voxels, 69, 1.0).hot, ElementsAre(VoxelId{1}));
}

TEST(PreloadPlan, SkipsWhatDoesNotFitAndGoesOn) {
  const std::vector<Voxel> voxels{{1000.0, 60}, {9.0, 10}};

  EXPECT_THAT(plan(voxels, 100, 0.5).hot, ElementsAre(VoxelId{1}));
}

TEST(PreloadPlan, LeavesVoxelsColdThatNoRayIsExpectedToEnter) {
  const std::vector<Voxel> voxels{{0.0, 10}, {1.0, 10}};

  EXPECT_THAT(plan(voxels, 100, 1.0).hot, ElementsAre(VoxelId{1}));
}

TEST(PreloadPlan, NeverExceedsItsBudget) {
  const std::uint32_t seed = 7;
  SCOPED_TRACE(seed);
  std::mt19937 random(seed);
  for (int round = 0; round < 2000; ++round) {
    std::vector<Voxel> voxels(1 + random() % 12);
    for (Voxel& voxel : voxels) { voxel = {static_cast<double>(random() % 5), 1 + random() % 40}; }
    const std::uint64_t limit = random() % 300;
    const double share = static_cast<double>(random() % 11) / 10.0;

    const PreloadPlan result = plan(voxels, limit, share);

    std::vector<bool> is_hot(voxels.size(), false);
    std::uint64_t hot_bytes = 0;
    for (const VoxelId id : result.hot) {
      EXPECT_FALSE(is_hot[index_of(id)]);
      is_hot[index_of(id)] = true;
      hot_bytes += voxels[index_of(id)].bytes;
    }
    std::uint64_t largest_cold = 0;
    for (std::size_t voxel = 0; voxel < voxels.size(); ++voxel) {
      if (!is_hot[voxel]) { largest_cold = std::max(largest_cold, voxels[voxel].bytes); }
    }
    EXPECT_EQ(result.hot_bytes, hot_bytes);
    EXPECT_LE(static_cast<double>(hot_bytes), share * static_cast<double>(limit));
    if (!result.hot.empty()) { EXPECT_LE(hot_bytes + largest_cold, limit); }
  }
}

}  // namespace
}  // namespace preheat
