#include "common/octree_summary.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <set>

#include "common/blocking.h"
#include "common/compensated_sum.h"
#include "common/octree_statistics.h"
#include "common/voxel_block.h"
#include "tests/scenes/soups.h"

namespace preheat {
namespace {

struct FineLeaf {
  Aabb cell{};
  std::uint32_t node = 0;
  std::uint32_t depth = 0;
};

// Of the whole octree, in Morton order.
std::vector<FineLeaf> leaves_of(const Octree& octree) {
  std::vector<FineLeaf> leaves;
  std::vector<FineLeaf> waiting{{octree.root, 0, 0}};
  while (!waiting.empty()) {
    const FineLeaf at = waiting.back();
    waiting.pop_back();
    const std::uint32_t first_child = octree.nodes[at.node].first_child;
    if (first_child == 0) { leaves.push_back(at); }
    for (unsigned octant = 8; octant-- > 0 && first_child != 0;) {
      waiting.push_back({child_cell(at.cell, octant), first_child + octant, at.depth + 1});
    }
  }
  return leaves;
}

bool holds(const Aabb& outer, const Aabb& inner) {
  return outer.low.x <= inner.low.x && outer.low.y <= inner.low.y && outer.low.z <= inner.low.z &&
         outer.high.x >= inner.high.x && outer.high.y >= inner.high.y &&
         outer.high.z >= inner.high.z;
}

double blocking_of(const Scene& scene, const Octree& octree, const FineLeaf& leaf) {
  BlockingFactor blocking(leaf.cell);
  const OctreeNode& node = octree.nodes[leaf.node];
  for (std::uint64_t i = 0; i < node.references_count; ++i) {
    Aabb box;
    for (const std::uint32_t v :
         scene.triangles[octree.references[node.references_begin + i]].vertices) {
      box.extend(scene.positions[v]);
    }
    blocking.add(box);
  }
  return blocking.probability();
}

struct Built {
  Scene scene{};
  Octree octree{};
  OctreeSummary summary{};
};

// Deep enough that some nodes of the summary stand for subtrees, with a corner that is deeper.
Built build(std::size_t triangles, std::uint32_t seed) {
  Built built;
  built.scene = test::soup(triangles, 0.02F, seed);
  test::SoupRandom random(seed);
  for (std::size_t i = 0; i < triangles; ++i) {
    const Vec3 at = random.in_cube(0.7F, 0.75F);
    test::add_triangle(built.scene, at, at + random.in_cube(0.0F, 0.01F),
                       at + random.in_cube(0.0F, 0.01F));
  }
  built.octree = build_octree(built.scene, {.leaf_references_max = 8});
  built.summary = build_octree_summary(built.scene, built.octree);
  return built;
}

// [P] section 2, straight from the leaves below each node of the summary.
TEST(OctreeSummary, SaysOfEachNodeWhatItsLeavesSay) {
  const Built built = build(1500, 3);
  const std::vector<FineLeaf> leaves = leaves_of(built.octree);
  std::size_t subtrees = 0;
  std::size_t octree_leaves = 0;
  for (const SummaryNode& node : built.summary.nodes) {
    OctreeSums expected{.leaves_empty = 0, .level_min = 99, .surface = 0.0};
    for (const FineLeaf& leaf : leaves) {
      if (leaf.depth < node.depth || !holds(node.cell, leaf.cell)) { continue; }
      const std::uint32_t h = leaf.depth - node.depth;
      const std::uint32_t references = built.octree.nodes[leaf.node].references_count;
      ++(references > 0 ? expected.leaves_filled : expected.leaves_empty);
      expected.references += references;
      expected.level_min = std::min(expected.level_min, h);
      expected.level_max = std::max(expected.level_max, h);
      expected.surface += std::pow(4.0, -static_cast<double>(h));
      expected.surface_depth += h * std::pow(4.0, -static_cast<double>(h));
      expected.blocking +=
          blocking_of(built.scene, built.octree, leaf) * std::pow(8.0, -static_cast<double>(h));
    }
    const OctreeSums& sums = node.sums;
    EXPECT_EQ(sums.leaves_filled, expected.leaves_filled);
    EXPECT_EQ(sums.leaves_empty, expected.leaves_empty);
    EXPECT_EQ(sums.references, expected.references);
    EXPECT_EQ(sums.level_min, expected.level_min);
    EXPECT_EQ(sums.level_max, expected.level_max);
    EXPECT_NEAR(sums.surface, expected.surface, 1e-12 * expected.surface);
    EXPECT_NEAR(sums.surface_depth, expected.surface_depth, 1e-12 * expected.surface_depth);
    EXPECT_NEAR(sums.blocking, expected.blocking, 1e-12);
    EXPECT_DOUBLE_EQ(sums.traversal_cost(),
                     traversal_cost(sums.depth_mean(), sums.blocking_mean()));
    subtrees += node.depth == kSummaryDepthMax && node.child_mask != 0 ? 1U : 0U;
    octree_leaves += node.child_mask == 0 ? 1U : 0U;
  }
  EXPECT_GT(subtrees, 5U);
  EXPECT_GT(octree_leaves, 50U);
}

TEST(OctreeSummary, OfALeafCostsOneTraversal) {
  OctreeSums leaf;
  for (const double blocking : {0.0, 0.3, 1.0}) {
    leaf.blocking = blocking;
    EXPECT_DOUBLE_EQ(leaf.traversal_cost(), 1.0);
    EXPECT_DOUBLE_EQ(leaf.stop_probability(), blocking);
  }
}

TEST(OctreeSummary, IsTheSameOnAnyNumberOfThreads) {
  const Built built = build(1500, 4);
  const std::vector<std::byte> bytes = encode_octree_summary(built.summary);
  tbb::task_arena(1).execute([&] {
    EXPECT_EQ(encode_octree_summary(build_octree_summary(built.scene, built.octree)), bytes);
  });
}

TEST(OctreeSummary, SurvivesEncodingAndDecoding) {
  for (const Built& built : {build(2000, 1), build(5, 2), build(0, 3)}) {
    const std::vector<std::byte> bytes = encode_octree_summary(built.summary);

    const Result<OctreeSummary> decoded = decode_octree_summary(bytes);

    ASSERT_TRUE(decoded) << decoded.error().message;
    ASSERT_EQ(decoded->nodes.size(), built.summary.nodes.size());
    for (std::size_t i = 0; i < decoded->nodes.size(); ++i) {
      const SummaryNode& node = decoded->nodes[i];
      EXPECT_EQ(node.cell.low, built.summary.nodes[i].cell.low);
      EXPECT_EQ(node.cell.high, built.summary.nodes[i].cell.high);
      EXPECT_EQ(node.depth, built.summary.nodes[i].depth);
      EXPECT_EQ(node.first_child, built.summary.nodes[i].first_child);
      EXPECT_EQ(node.sums, built.summary.nodes[i].sums);
    }
    EXPECT_EQ(encode_octree_summary(*decoded), bytes);
  }
}

TEST(OctreeSummary, IsASmallShareOfTheBlocks) {
  for (const std::size_t triangles : {100U, 3000U, 30000U}) {
    const Scene scene = test::soup(triangles, 0.01F, 1);
    const Octree octree = build_octree(scene, {});
    const std::size_t bytes = encode_octree_summary(build_octree_summary(scene, octree)).size();
    const std::size_t blocks = voxel_block_bytes(scene.positions.size(), triangles, false);
    EXPECT_LE(bytes * 20, blocks + 20 * 64) << triangles;
  }
}

void expect_sound(const OctreeSummary& summary) {
  for (std::size_t i = 0; i < summary.nodes.size(); ++i) {
    const SummaryNode& node = summary.nodes[i];
    if (node.first_child != 0) {
      ASSERT_GT(node.first_child, i);
      ASSERT_LE(node.first_child + static_cast<unsigned>(std::popcount(node.child_mask)),
                summary.nodes.size());
    }
    ASSERT_TRUE(std::isfinite(node.sums.traversal_cost()));
    ASSERT_GE(node.sums.stop_probability(), 0.0);
    ASSERT_LE(node.sums.stop_probability(), 1.0);
    ASSERT_GE(node.sums.surface, 1.0);
  }
  const OctreeCut cut = cut_octree(summary, 3);
  ASSERT_LE(cut.cells.size(), 512U);
}

TEST(OctreeSummary, RefusesOrSurvivesDamagedBytes) {
  const Built built = build(150, 5);
  const std::vector<std::byte> bytes = encode_octree_summary(built.summary);
  for (std::size_t length = 0; length < bytes.size(); ++length) {
    const Result<OctreeSummary> decoded = decode_octree_summary(std::span(bytes).first(length));
    ASSERT_FALSE(decoded);
    ASSERT_EQ(decoded.error().code, ExitCode::kStoreDamaged);
  }
  std::size_t refused = 0;
  for (std::size_t at = 0; at < bytes.size(); ++at) {
    for (const unsigned flip : {0x01U, 0x80U, 0xFFU}) {
      std::vector<std::byte> damaged = bytes;
      damaged[at] ^= static_cast<std::byte>(flip);
      const Result<OctreeSummary> decoded = decode_octree_summary(damaged);
      if (decoded) { expect_sound(*decoded); }
      refused += decoded ? 0U : 1U;
    }
  }
  EXPECT_GT(refused, bytes.size() / 2);
}

TEST(OctreeCut, HasTheFilledCellsInMortonOrder) {
  const Built built = build(800, 6);
  for (std::uint32_t depth = 0; depth <= kSummaryDepthMax; ++depth) {
    const OctreeCut cut = cut_octree(built.summary, depth);
    // The same from the leaves: each lies in one cell, and cells appear in the leaves' order.
    std::vector<Aabb> expected;
    for (const FineLeaf& leaf : leaves_of(built.octree)) {
      if (built.octree.nodes[leaf.node].references_count == 0) { continue; }
      if (!expected.empty() && holds(expected.back(), leaf.cell)) { continue; }
      Aabb cell = built.octree.root;
      for (std::uint32_t level = 0; level < std::min(depth, leaf.depth); ++level) {
        for (unsigned octant = 0; octant < 8; ++octant) {
          if (holds(child_cell(cell, octant), leaf.cell)) {
            cell = child_cell(cell, octant);
            break;
          }
        }
      }
      expected.push_back(cell);
    }
    ASSERT_EQ(cut.cells.size(), expected.size()) << depth;
    for (std::size_t i = 0; i < expected.size(); ++i) {
      EXPECT_EQ(cut.cells[i].cell.low, expected[i].low);
      EXPECT_EQ(cut.cells[i].cell.high, expected[i].high);
      EXPECT_LE(cut.cells[i].depth, depth);
      EXPECT_EQ(built.summary.nodes[cut.cells[i].node].depth, cut.cells[i].depth);
    }
    EXPECT_LE(cut.cells.size(), std::size_t{1} << 3U * depth);
  }
}

TEST(OctreeCut, FindsTheCellAboveAndAllCellsBelow) {
  const Built built = build(800, 7);
  const OctreeCut cut = cut_octree(built.summary, 2);
  const OctreeCut finer = cut_octree(built.summary, 5);
  const auto count = static_cast<std::uint32_t>(cut.cells.size());
  for (std::uint32_t i = 0; i < count; ++i) {
    EXPECT_EQ(cut_cells_of(built.summary, cut, cut.cells[i].cell), (CutRange{i, i + 1}));
  }
  for (const FineLeaf& leaf : leaves_of(built.octree)) {
    if (built.octree.nodes[leaf.node].references_count == 0) { continue; }
    for (const OctreeCut* any : {&cut, &finer}) {
      const CutRange range = cut_cells_of(built.summary, *any, leaf.cell);
      ASSERT_LT(range.begin, range.end);
      for (std::uint32_t i = range.begin; i < range.end; ++i) {
        EXPECT_TRUE(holds(any->cells[i].cell, leaf.cell));
      }
      EXPECT_EQ(range.end - range.begin, 1U);
    }
  }
  EXPECT_EQ(cut_cells_of(built.summary, cut, built.octree.root), (CutRange{0, count}));
  std::uint32_t next = 0;  // a cell of the coarse cut holds the next run of the finer one's
  for (const CutCell& cell : cut.cells) {
    const CutRange range = cut_cells_of(built.summary, finer, cell.cell);
    EXPECT_EQ(range.begin, next);
    for (std::uint32_t i = range.begin; i < range.end; ++i) {
      EXPECT_TRUE(holds(cell.cell, finer.cells[i].cell));
    }
    next = range.end;
  }
  EXPECT_EQ(next, finer.cells.size());
}

TEST(OctreeCut, HasNoCellWhereNothingIs) {
  const Built built = build(0, 1);
  const OctreeCut cut = cut_octree(built.summary, 2);
  EXPECT_TRUE(cut.cells.empty());
  EXPECT_EQ(cut_cells_of(built.summary, cut, built.octree.root), CutRange{});

  Scene corner = test::empty_scene();
  for (int i = 0; i < 100; ++i) {
    const float x = 0.001F * static_cast<float>(i);
    test::add_triangle(corner, {x, 0, 0}, {x + 0.001F, 0, 0}, {x, 0.001F, 0});
  }
  test::add_triangle(corner, Vec3(1.0F), Vec3(0.99F), {1.0F, 0.99F, 1.0F});
  const Octree octree = build_octree(corner, {});
  const OctreeSummary summary = build_octree_summary(corner, octree);
  const OctreeCut two = cut_octree(summary, 1);
  EXPECT_EQ(two.cells.size(), 2U);
  EXPECT_EQ(cut_cells_of(summary, two, child_cell(octree.root, 1)), CutRange{});
}

TEST(CellsCrossed, CountsFullAndEmptyCellsOnTheWay) {
  const Built built = build(800, 8);
  const auto at = [&](double x, double y, double z) {
    const Vec3d low(built.octree.root.low);
    return low + (Vec3d(built.octree.root.high) - low) * Vec3d(x, y, z);
  };
  // Centres of cells of a grid of four.
  const Vec3d from = at(0.125, 0.125, 0.125);
  EXPECT_EQ(cells_crossed(built.summary, 0, from, at(0.9, 0.8, 0.7)), 1U);
  std::set<std::uint32_t> depths;
  for (const CutCell& cell : cut_octree(built.summary, 2).cells) { depths.insert(cell.depth); }
  if (depths == std::set<std::uint32_t>{2}) {
    EXPECT_EQ(cells_crossed(built.summary, 2, from, at(0.875, 0.125, 0.125)), 4U);
    EXPECT_EQ(cells_crossed(built.summary, 2, from, at(0.875, 0.875, 0.875)), 4U);
    EXPECT_EQ(cells_crossed(built.summary, 2, from, at(0.375, 0.125, 0.125)), 2U);
  }
  EXPECT_EQ(cells_crossed(built.summary, 2, from, from + Vec3d(1e-3)), 1U);
  EXPECT_EQ(cells_crossed(built.summary, 2, at(2, 2, 2), at(3, 2, 2)), 0U);
  EXPECT_EQ(cells_crossed(OctreeSummary{.root = built.octree.root}, 2, from, at(1, 0, 0)), 1U);
}

TEST(SpreadOverVoxels, GivesAVoxelItsShareByCrofton) {
  const Built built = build(800, 9);
  const OctreeCut cut = cut_octree(built.summary, 1);
  std::vector<double> rays(cut.cells.size());
  std::iota(rays.begin(), rays.end(), 100.0);
  // A voxel that is a cell, one half as large within the next, and one that is all the octree.
  const Aabb& second = cut.cells[1].cell;
  const Vec3 middle = 0.5F * (second.low + second.high);
  const std::vector<Aabb> cells{cut.cells[0].cell, child_cell(second, 0), built.octree.root};
  std::vector<VoxelEntry> voxels(3);
  voxels[0].bounds = cells[0];
  voxels[1].bounds = {second.low, middle};
  voxels[2].bounds = built.octree.root;

  const std::vector<double> spread = spread_over_voxels(built.summary, cut, rays, cells, voxels);

  EXPECT_DOUBLE_EQ(spread[0], 100.0);
  EXPECT_NEAR(spread[1], 101.0 / 4.0, 1e-4);
  const double sum = std::accumulate(rays.begin(), rays.end(), 0.0);
  const double share = 4.0 / static_cast<double>(rays.size());  // surfaces of the cells
  EXPECT_NEAR(spread[2], std::max(rays.back(), std::min(1.0, share) * sum), 1e-3 * sum);
}

TEST(SpreadOverVoxels, NeverExceedsWhatEntersTheCell) {
  const Built built = build(800, 10);
  const OctreeCut cut = cut_octree(built.summary, 1);
  const std::vector<double> rays(cut.cells.size(), 10.0);
  std::vector<VoxelEntry> voxels(1);
  voxels[0].bounds = {Vec3(-9.0F), Vec3(9.0F)};  // a margin may reach out of the cell
  const std::vector<Aabb> cells{child_cell(cut.cells[0].cell, 3)};
  EXPECT_EQ(spread_over_voxels(built.summary, cut, rays, cells, voxels)[0], 10.0);
}

TEST(CompensatedSum, OfTenMillionTermsDoesNotDependOnTheirOrder) {
  CompensatedSum forwards;
  CompensatedSum backwards;
  constexpr int kTerms = 10'000'000;
  const auto term = [](int i) { return 1.0 / (1.0 + i) * (i % 3 == 0 ? 1e6 : 1.0); };
  for (int i = 0; i < kTerms; ++i) { forwards.add(term(i)); }
  for (int i = kTerms; i-- > 0;) { backwards.add(term(i)); }
  EXPECT_NEAR(forwards.value() / backwards.value(), 1.0, 1e-15);
}

}  // namespace
}  // namespace preheat
