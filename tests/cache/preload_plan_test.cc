#include "cache/preload_plan.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <random>

#include "cache/tracing.h"
#include "common/voxel_block.h"

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
    tables.voxels.back().block_bytes = static_cast<std::uint32_t>(voxel.bytes);
    tables.voxels.back().resident_bytes = voxel.bytes;
  }
  return tables;
}

// `cache_bytes` beside what the hot set's BVH has whatever is in it.
PreloadPlan plan_beside_fixed(const SceneTables& tables, const Prediction& prediction,
                              std::uint64_t cache_bytes, double share) {
  return plan_preload(tables, prediction, kBvhBytesFixed + cache_bytes, share);
}

PreloadPlan plan(const std::vector<Voxel>& voxels, std::uint64_t cache_bytes, double share) {
  Prediction prediction;
  for (const Voxel& voxel : voxels) { prediction.rays_camera.push_back(voxel.rays); }
  prediction.rays_scatter.resize(voxels.size(), 0.0);
  prediction.rays_shadow.resize(voxels.size(), 0.0);
  return plan_beside_fixed(tables_of(voxels), prediction, cache_bytes, share);
}

TEST(PreloadPlan, TakesTheMostRaysPerByteFirst) {
  const std::vector<Voxel> voxels{{10.0, 10}, {30.0, 10}, {40.0, 20}, {5.0, 1}, {0.0, 10}};

  const PreloadPlan result = plan(voxels, /*cache_bytes=*/31 + 10, /*share=*/1.0);

  EXPECT_THAT(result.hot, ElementsAre(VoxelId{3}, VoxelId{1}, VoxelId{2}));
  EXPECT_EQ(result.hot_bytes, 31U);
}

TEST(PreloadPlan, BreaksTiesByVoxelId) {
  const std::vector<Voxel> voxels{{2.0, 20}, {1.0, 10}, {3.0, 30}, {1.0, 10}};

  const PreloadPlan result = plan(voxels, /*cache_bytes=*/100, /*share=*/1.0);

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
  EXPECT_EQ(
      plan(voxels, std::numeric_limits<std::uint64_t>::max() - kBvhBytesFixed, kAuto).hot_bytes,
      120U);
}

TEST(PreloadPlan, LeavesRoomForEveryVoxelThatRaysAreExpectedToEnter) {
  // 40 bytes a triangle in the block, as real voxels have.
  SceneTables tables;
  Prediction prediction;
  constexpr std::uint32_t kTriangles = 1000;
  for (int voxel = 0; voxel < 100; ++voxel) {
    tables.voxels.emplace_back();
    tables.voxels.back().triangle_count = kTriangles;
    tables.voxels.back().block_bytes = 40 * kTriangles;
    tables.voxels.back().resident_bytes = 138 * kTriangles + kBvhBytesFixed;
    prediction.rays_camera.push_back(voxel < 80 ? 100.0 - voxel : 0.0);
  }
  prediction.rays_scatter.resize(100, 0.0);
  prediction.rays_shadow.resize(100, 0.0);
  const std::uint64_t cold_bytes = 40 * kTriangles + VoxelMesh::bytes_max(kTriangles);
  const auto hot_count = [&](std::uint64_t limit) {
    return plan_beside_fixed(tables, prediction, limit, kAuto).hot.size();
  };

  // All 80 fit cold, with room to make 60 of them hot.
  const std::uint64_t limit = 60 * tables.voxels[0].hot_bytes() + 20 * cold_bytes;
  EXPECT_EQ(hot_count(limit), 60U);
  EXPECT_EQ(hot_count(limit - 1), 59U);
  // Not even half of them fit: half of the room.
  EXPECT_EQ(hot_count(40 * cold_bytes), 40 * cold_bytes / 2 / tables.voxels[0].hot_bytes());
}

TEST(PreloadPlan, WarmsWhatTheRestHasRoomForByRaysPerByte) {
  SceneTables tables;
  Prediction prediction;
  constexpr std::uint32_t kTriangles = 1000;
  for (const double rays : {0.5, 3.0, 9.0, 0.0, 7.0, 5.0}) {
    tables.voxels.emplace_back();
    tables.voxels.back().triangle_count = kTriangles;
    tables.voxels.back().block_bytes = 40 * kTriangles;
    tables.voxels.back().resident_bytes = 138 * kTriangles + kBvhBytesFixed;
    prediction.rays_camera.push_back(rays);
  }
  prediction.rays_scatter.resize(6, 0.0);
  prediction.rays_shadow.resize(6, 0.0);
  const std::uint64_t cold_bytes = 40 * kTriangles + VoxelMesh::bytes_max(kTriangles);
  const std::uint64_t hot_bytes = tables.voxels[0].hot_bytes();
  const auto plan = [&](std::uint64_t limit, double share) {
    return plan_beside_fixed(tables, prediction, limit, share);
  };

  // Everything that rays are expected to enter fits, one voxel of it hot; half a ray is none.
  const PreloadPlan all = plan(hot_bytes + 4 * cold_bytes, kAuto);
  EXPECT_THAT(all.hot, ElementsAre(VoxelId{2}));
  EXPECT_THAT(all.warm, ElementsAre(VoxelId{4}, VoxelId{5}, VoxelId{1}));
  // Half of the room is too little for a hot one.
  EXPECT_THAT(plan(2 * cold_bytes, kAuto).warm, ElementsAre(VoxelId{2}, VoxelId{4}));
  EXPECT_THAT(plan(2 * cold_bytes - 1, kAuto).warm, ElementsAre(VoxelId{2}));
  EXPECT_THAT(plan(hot_bytes + 4 * cold_bytes, 0.5).warm, IsEmpty());
}

// Eight voxels of one size below two octree nodes of four; the second node's have twice the extent.
struct EightVoxels {
  SceneTables tables;
  Prediction prediction;

  explicit EightVoxels(const std::vector<double>& rays) {
    constexpr std::uint32_t kTriangles = 1000;
    for (std::uint32_t voxel = 0; voxel < 8; ++voxel) {
      const float extent = voxel < 4 ? 1.0F : 2.0F;
      VoxelEntry entry;
      entry.bounds = {{0.0F, 0.0F, 0.0F}, {extent, extent, extent}};
      entry.triangle_count = kTriangles;
      entry.block_bytes = 40 * kTriangles;
      entry.resident_bytes = 138 * kTriangles + kBvhBytesFixed;
      tables.voxels.push_back(entry);
    }
    tables.voxel_nodes.push_back({{}, 1, 2});
    tables.voxel_nodes.push_back({{}, 3, 4});
    tables.voxel_nodes.push_back({{}, 7, 4});
    for (std::uint32_t voxel = 0; voxel < 8; ++voxel) {
      tables.voxel_nodes.push_back({{}, voxel, 0});
    }
    prediction.rays_camera = rays;
    prediction.rays_scatter.resize(8, 0.0);
    prediction.rays_shadow.resize(8, 0.0);
    prediction.rays_error.resize(8, 1.0);
  }

  [[nodiscard]] std::uint64_t cold_bytes() const {
    return tables.voxels[0].block_bytes + VoxelMesh::bytes_max(tables.voxels[0].triangle_count);
  }
  [[nodiscard]] std::vector<VoxelId> warm(std::uint64_t limit) const {
    return plan_beside_fixed(tables, prediction, limit, kAuto).warm;
  }
};

TEST(PreloadPlan, WarmsWhatNoSampleMetIfItsNeighboursWereMetOften) {
  // The second node's share for each of its voxels is 40 / 4 = 10 rays: too few.
  const EightVoxels scene({300.0, 0.0, 100.0, 0.0, 40.0, 0.0, 0.0, 0.0});
  // What samples met comes first, as far as it is not hot.
  EXPECT_THAT(scene.warm(2 * scene.cold_bytes()), ElementsAre(VoxelId{0}, VoxelId{2}));
  EXPECT_THAT(scene.warm(4 * scene.cold_bytes()),
              ElementsAre(VoxelId{0}, VoxelId{2}, VoxelId{4}, VoxelId{1}));
  EXPECT_THAT(scene.warm(9 * scene.cold_bytes()), ElementsAre(VoxelId{4}, VoxelId{1}, VoxelId{3}));
}

TEST(PreloadPlan, SharesTheRaysOfTheNodeAboveBySurface) {
  // Of the root's rays each voxel of the second node has 4 of 20 parts, of its own those of the
  // first have a quarter.
  const auto warm = [](double rays) {
    const EightVoxels scene({rays, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0});
    return scene.warm(16 * scene.cold_bytes());
  };
  EXPECT_THAT(warm(47.0), IsEmpty());
  EXPECT_THAT(warm(59.0), ElementsAre(VoxelId{1}, VoxelId{2}, VoxelId{3}));
  EXPECT_THAT(warm(60.0), ElementsAre(VoxelId{1}, VoxelId{2}, VoxelId{3}, VoxelId{4}, VoxelId{5},
                                      VoxelId{6}, VoxelId{7}));
}

TEST(PreloadPlan, TakesAModelThatDoesNotSampleAtItsWord) {
  EightVoxels scene({400.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0});
  scene.prediction.rays_error.clear();
  EXPECT_THAT(scene.warm(2 * scene.cold_bytes()), ElementsAre(VoxelId{0}));
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
