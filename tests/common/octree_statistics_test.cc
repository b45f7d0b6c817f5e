#include "common/octree_statistics.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/scenes/soups.h"

namespace preheat {
namespace {

// The sum of [P] section 2 term by term.
double traversal_cost_by_terms(double depth_mean, double p) {
  const double cells = std::pow(2.0, depth_mean);
  const double part = cells - std::floor(cells);
  double cost = 0.0;
  for (int i = 1; i <= static_cast<int>(cells); ++i) { cost += i * p * std::pow(1.0 - p, i - 1); }
  return cost + cells * part * p * std::pow(1.0 - p, part) + cells * std::pow(1.0 - p, cells);
}

TEST(TraversalCost, IsThePapersSum) {
  for (const double depth : {0.0, 0.7, 1.0, 2.3, 4.6, 7.9}) {
    for (const double p : {0.0, 1e-6, 0.03, 0.4, 0.97, 1.0}) {
      EXPECT_NEAR(traversal_cost(depth, p), traversal_cost_by_terms(depth, p), 1e-9) << depth << p;
    }
  }
}

TEST(TraversalCost, OfAnEmptyTreeIsAllItsCells) {
  EXPECT_DOUBLE_EQ(traversal_cost(5.0, 0.0), 32.0);
}

TEST(TraversalCost, OfOpaqueCellsIsTheFirst) {
  EXPECT_DOUBLE_EQ(traversal_cost(5.0, 1.0), 1.0);
  EXPECT_DOUBLE_EQ(traversal_cost(5.5, 1.0), 1.0);
}

// A root whose lower front left octant holds a plate across it and is a leaf like its siblings.
TEST(OctreeStatistics, OfOneSplitAreWorkedOutByHand) {
  Scene scene = test::empty_scene();
  test::add_triangle(scene, {0, 0, 0.25F}, {0.5F, 0, 0.25F}, {0, 0.5F, 0.25F});
  test::add_triangle(scene, {0, 0, 0.25F}, {0.5F, 0, 0.25F}, {0, 0.25F, 0.25F});
  Octree octree;
  octree.root = {Vec3(0.0F), Vec3(1.0F)};
  octree.nodes.resize(9);
  octree.nodes[0] = {.first_child = 1, .references_count = 2};
  octree.nodes[1] = {.references_count = 2};
  octree.references = {0, 1};

  const OctreeStatistics statistics = measure_octree(scene, octree);

  EXPECT_EQ(statistics.voxels_internal, 1U);
  EXPECT_EQ(statistics.voxels_leaf, 1U);
  EXPECT_EQ(statistics.voxels_empty, 7U);
  EXPECT_EQ(statistics.level_min, 1U);
  EXPECT_EQ(statistics.level_max, 1U);
  EXPECT_DOUBLE_EQ(statistics.depth_mean, 1.0);
  EXPECT_DOUBLE_EQ(statistics.objects_per_leaf, 2.0 / 8.0);
  // Boxes of 1/4 and 1/8 over 3 faces of 1/4, in one leaf of eight.
  EXPECT_DOUBLE_EQ(statistics.blocking_mean, (0.25 + 0.125) / 0.75 / 8.0);
  EXPECT_DOUBLE_EQ(statistics.traversal_cost, traversal_cost(1.0, 0.0625));
}

TEST(OctreeStatistics, WeightLeavesByTheirSize) {
  Scene scene = test::empty_scene();
  test::add_triangle(scene, {0, 0, 0}, {1, 0, 0}, {0, 1, 0});
  Octree octree;
  octree.root = {Vec3(0.0F), Vec3(1.0F)};
  octree.nodes.resize(17);
  octree.nodes[0] = {.first_child = 1, .references_count = 1};
  octree.nodes[1] = {.first_child = 9, .references_count = 1};
  octree.nodes[9] = {.references_count = 1};
  octree.references = {0};

  const OctreeStatistics statistics = measure_octree(scene, octree);

  EXPECT_DOUBLE_EQ(statistics.depth_mean, (7 * 1 / 4.0 + 8 * 2 / 16.0) / (7 / 4.0 + 8 / 16.0));
  // The part of the box in the leaf covers one of its three faces, seen once.
  EXPECT_DOUBLE_EQ(statistics.blocking_mean, 1.0 / 3.0 / 64.0);
}

TEST(OctreeStatistics, OfAnEmptySceneAreThoseOfOneEmptyLeaf) {
  const Scene scene = test::empty_scene();
  const OctreeStatistics statistics = measure_octree(scene, build_octree(scene, {}));
  EXPECT_EQ(statistics.voxels_empty, 1U);
  EXPECT_EQ(statistics.voxels_leaf, 0U);
  EXPECT_EQ(statistics.depth_mean, 0.0);
  EXPECT_EQ(statistics.blocking_mean, 0.0);
  EXPECT_EQ(statistics.traversal_cost, 1.0);
}

// [P] Table 1: every voxel is internal, leaf or empty, and each internal one has eight children.
TEST(OctreeStatistics, AddUpAsInThePapersTable) {
  const Scene scene = test::soup(5000, 0.03F, 6);
  const Octree octree = build_octree(scene, {.leaf_references_max = 8});

  const OctreeStatistics statistics = measure_octree(scene, octree);

  const std::uint64_t voxels =
      statistics.voxels_internal + statistics.voxels_leaf + statistics.voxels_empty;
  EXPECT_EQ(voxels, octree.nodes.size());
  EXPECT_EQ(voxels, 8 * statistics.voxels_internal + 1);
  EXPECT_EQ(statistics.level_max, octree.depth_max);
  EXPECT_GT(statistics.depth_mean, statistics.level_min);
  EXPECT_LT(statistics.depth_mean, statistics.level_max);
  EXPECT_GT(statistics.blocking_mean, 0.0);
  EXPECT_LE(statistics.blocking_mean, 1.0);
}

}  // namespace
}  // namespace preheat
