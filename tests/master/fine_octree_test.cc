#include "master/fine_octree.h"

#include <gtest/gtest.h>

#include <numeric>

#include "cache/counted_render.h"
#include "tests/master/lit_scene.h"

namespace preheat {
namespace {

using test::LitScene;
using Kind = CountingUnit::Kind;

TEST(CountingUnit, IsReadAndNamed) {
  for (const char* text : {"voxel", "leaf", "node:0", "node:2", "node:20"}) {
    const auto unit = parse_counting_unit(text);
    ASSERT_TRUE(unit.has_value()) << text;
    EXPECT_EQ(name_of(*unit), text);
  }
  for (const char* text : {"", "voxels", "node", "node:", "node:-1", "node:21", "node:2x"}) {
    const auto unit = parse_counting_unit(text);
    ASSERT_FALSE(unit.has_value()) << text;
    EXPECT_EQ(unit.error().code, ExitCode::kUsage);
  }
}

class FineOctreeTest : public testing::Test {
 protected:
  void SetUp() override {
    Result<FineOctree> octree = FineOctree::rebuild(store_, 2);
    ASSERT_TRUE(octree.has_value()) << octree.error().message;
    octree_ = *std::move(octree);
  }
  static double sum_of(const std::vector<double>& values) {
    return std::accumulate(values.begin(), values.end(), 0.0);
  }

  LitScene scene_{};
  Store store_ = scene_.open();
  std::optional<FineOctree> octree_{};
};

TEST_F(FineOctreeTest, HasTheLeavesThatTheStoreWasCutFrom) {
  EXPECT_EQ(octree_->cells_of({Kind::kLeaf, 0}).size(), store_.info().voxels_leaf);
  EXPECT_EQ(octree_->cells_of({Kind::kNode, 0}).size(), 1U);
  EXPECT_EQ(octree_->cells_of({Kind::kNode, 1}).size(), 8U);
  EXPECT_EQ(octree_->cells_of({Kind::kNode, kOctreeDepthMax}), octree_->cells_of({Kind::kLeaf, 0}));
}

// The walk of the tree against a scan of all leaves, for a few rays.
TEST_F(FineOctreeTest, CountsARayInEachLeafThatItTraverses) {
  CountedRenderOptions options{1};
  options.counting_tree = octree_->counting_tree();
  RenderSettings settings = LitScene::settings(24, 1);
  settings.bounces = 0;
  const auto counted = render_counted(store_, settings, options);
  ASSERT_TRUE(counted.has_value());

  const std::vector<std::uint32_t> root = octree_->cells_of({Kind::kNode, 0});
  const std::vector<std::uint32_t> nodes = octree_->cells_of({Kind::kNode, 2});
  const CellRays whole = octree_->counted(counted->accesses, root);
  const CellRays parts = octree_->counted(counted->accesses, nodes);

  std::uint64_t traversals = 0;
  for (std::size_t node = 0; node < counted->accesses.size(); ++node) {
    if (counted->accesses[node].total() == 0) { continue; }
    EXPECT_EQ(options.counting_tree->nodes[node].count, 0U) << "an inner node was counted in";
    traversals += counted->accesses[node].total();
  }
  EXPECT_EQ(whole.all[0], static_cast<double>(traversals));
  EXPECT_EQ(whole.camera[0], whole.all[0]);  // no bounces
  EXPECT_LE(sum_of(parts.all), whole.all[0]);
  EXPECT_GT(sum_of(parts.all), 0.5 * whole.all[0]);
  EXPECT_GT(traversals, 24U * 24U);
}

TEST_F(FineOctreeTest, HandsVoxelsDownToLeavesAndUpToNodes) {
  Prediction prediction;
  const std::size_t voxels = store_.tables().voxels.size();
  prediction.rays_camera.assign(voxels, 100.0);
  prediction.rays_scatter.assign(voxels, 0.0);
  prediction.rays_shadow.assign(voxels, 20.0);
  const CountingUnit leaf{Kind::kLeaf, 0};
  const CountingUnit node{Kind::kNode, 1};
  const auto leaves = octree_->cells_of(leaf);
  const auto nodes = octree_->cells_of(node);

  const CellRays by_leaf = octree_->estimated(prediction, leaf, leaves);
  const CellRays by_node = octree_->estimated(prediction, node, nodes);

  for (std::size_t i = 0; i < leaves.size(); ++i) {
    EXPECT_GT(by_leaf.all[i], 0.0);
    EXPECT_LE(by_leaf.all[i], 120.0);
    EXPECT_NEAR(by_leaf.camera[i], by_leaf.all[i] / 1.2, 1e-9);
  }
  // Empty leaves inside voxels belong to the nodes as well.
  EXPECT_GE(sum_of(by_node.all), sum_of(by_leaf.all) * (1.0 - 1e-12));
  EXPECT_FALSE(FineOctree::is_estimated_by(prediction, node));
  EXPECT_TRUE(FineOctree::is_estimated_by(prediction, {}));
}

TEST_F(FineOctreeTest, TakesNodesOfItsOwnDepthAsTheyAreAndSpreadsOthersWithoutLoss) {
  const auto nodes = octree_->cells_of({Kind::kNode, 2});
  Prediction prediction;
  prediction.nodes.depth = 2;
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    prediction.nodes.rays_camera.push_back(static_cast<double>(i));
    prediction.nodes.rays_scatter.push_back(1.0);
    prediction.nodes.rays_shadow.push_back(2.0);
  }
  const double all = sum_of(prediction.nodes.rays_camera) + 3.0 * static_cast<double>(nodes.size());

  const CellRays same = octree_->estimated(prediction, {Kind::kNode, 2}, nodes);
  const CellRays above =
      octree_->estimated(prediction, {Kind::kNode, 1}, octree_->cells_of({Kind::kNode, 1}));

  EXPECT_EQ(same.camera, prediction.nodes.rays_camera);
  EXPECT_EQ(same.all[5], 8.0);
  EXPECT_NEAR(sum_of(above.all), all, 1e-9 * all);
  EXPECT_TRUE(FineOctree::is_estimated_by(prediction, {Kind::kNode, 2}));
  EXPECT_FALSE(FineOctree::is_estimated_by(prediction, {Kind::kNode, 1}));
}

TEST(FineOctree, RefusesAStoreOfAnotherOctree) {
  const test::ScratchFolder folder;
  CompileOptions options;
  options.octree.leaf_references_max = 100;
  ASSERT_TRUE(compile_scene(test::soup(3000, 0.05F, 9), "a", {1, 2}, options, folder / "a.store"));

  const auto octree = FineOctree::rebuild(*Store::open(folder / "a.store"), 1);

  ASSERT_FALSE(octree.has_value());
  EXPECT_EQ(octree.error().code, ExitCode::kMismatch);
}

}  // namespace
}  // namespace preheat
