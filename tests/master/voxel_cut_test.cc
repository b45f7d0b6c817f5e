#include "master/voxel_cut.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <set>

#include "common/voxel_block.h"
#include "tests/scenes/soups.h"

namespace preheat {
namespace {

using test::SoupRandom;

bool contains(const Aabb& box, const Vec3& point) {
  for (int axis = 0; axis < 3; ++axis) {
    if (point[axis] < box.low[axis] || point[axis] > box.high[axis]) { return false; }
  }
  return true;
}

bool contains(const Aabb& outer, const Aabb& inner) {
  return contains(outer, inner.low) && contains(outer, inner.high);
}

TEST(VoxelCut, OfAnEmptySceneHasNoVoxel) {
  const Scene scene = test::empty_scene();
  const VoxelCut cut = cut_into_voxels(scene, build_octree(scene, {}), 4096);
  EXPECT_TRUE(cut.roots.empty());
  EXPECT_TRUE(cut.nodes.empty());
}

TEST(VoxelCut, OfASmallSceneIsOneVoxel) {
  const Scene scene = test::sheet(10);
  const VoxelCut cut = cut_into_voxels(scene, build_octree(scene, {}), 1 << 20);
  EXPECT_EQ(cut.roots, std::vector<std::uint32_t>{0});
  ASSERT_EQ(cut.nodes.size(), 1U);
  EXPECT_EQ(cut.nodes[0].count, 0U);
  EXPECT_EQ(cut.nodes[0].first, 0U);
}

// Each voxel fits, its parent would not, and the voxels together reference everything in order.
TEST(VoxelCut, TakesTheHighestNodesThatFit) {
  constexpr std::uint64_t kSize = 8192;
  const Scene scene = test::sheet(80);
  const Octree octree = build_octree(scene, {.leaf_references_max = 16});
  std::vector<std::uint32_t> parent_of(octree.nodes.size(), 0);
  for (std::uint32_t node = 0; node < octree.nodes.size(); ++node) {
    for (unsigned octant = 0; octant < 8 && octree.nodes[node].first_child != 0; ++octant) {
      parent_of[octree.nodes[node].first_child + octant] = node;
    }
  }
  const auto block_bytes = [&](std::uint32_t node) {
    return encode_voxel_block(scene, triangles_below(octree, node)).size();
  };

  const VoxelCut cut = cut_into_voxels(scene, octree, kSize);

  ASSERT_GT(cut.roots.size(), 50U);
  std::uint64_t references_end = 0;
  for (const std::uint32_t root : cut.roots) {
    EXPECT_LE(block_bytes(root), kSize);
    EXPECT_GT(block_bytes(parent_of[root]), kSize);
    EXPECT_EQ(octree.nodes[root].references_begin, references_end);
    references_end += octree.nodes[root].references_count;
  }
  EXPECT_EQ(references_end, octree.references.size());
}

TEST(VoxelCut, KeepsALeafThatIsTooLarge) {
  Scene scene = test::empty_scene();
  test::add_triangle(scene, {-1, -1, -1}, {1, -1, 1}, {0, 1, 0.5F});
  scene.triangles.resize(5000, scene.triangles[0]);
  const VoxelCut cut = cut_into_voxels(scene, build_octree(scene, {}), 4096);
  EXPECT_GE(cut.roots.size(), 1U);
  EXPECT_LE(cut.roots.size(), 64U);
}

TEST(VoxelCut, NodesAreATreeOverAllVoxelsWithoutOnlyChildren) {
  const Scene scene = test::soup(4000, 0.02F, 12);
  const VoxelCut cut = cut_into_voxels(scene, build_octree(scene, {}), 4096);

  ASSERT_GT(cut.roots.size(), 30U);
  std::set<std::uint32_t> voxels;
  std::size_t children = 1;
  for (const VoxelNode& node : cut.nodes) {
    if (node.count == 0) {
      EXPECT_TRUE(voxels.insert(node.first).second);
    } else {
      EXPECT_GE(node.count, 2U);
      EXPECT_EQ(node.first, children);
      children += node.count;
    }
  }
  EXPECT_EQ(voxels.size(), cut.roots.size());
  EXPECT_EQ(children, cut.nodes.size());
}

// Every point of a triangle, and what rounding makes of it, lies in the bounds of a voxel that
// holds the triangle; the bounds are no larger than the geometry and the cell are.
TEST(VoxelBounds, HoldEveryPointOfTheirTriangles) {
  constexpr std::uint32_t kSeed = 41;
  SCOPED_TRACE(kSeed);
  const Scene scene = test::soup(1500, 0.15F, kSeed);
  const Octree octree = build_octree(scene, {.leaf_references_max = 8});
  const VoxelCut cut = cut_into_voxels(scene, octree, 4096);
  ASSERT_GT(cut.roots.size(), 20U);
  std::vector<std::vector<std::uint32_t>> ids;
  std::vector<Aabb> bounds;
  for (std::size_t voxel = 0; voxel < cut.roots.size(); ++voxel) {
    ids.push_back(triangles_below(octree, cut.roots[voxel]));
    bounds.push_back(voxel_bounds(scene, ids.back(), cut.cells[voxel]));
    EXPECT_FALSE(bounds.back().is_empty());
    EXPECT_TRUE(contains(grown_cell(grown_cell(cut.cells[voxel])), bounds.back()));
  }

  SoupRandom random(kSeed);
  for (std::uint32_t id = 0; id < scene.triangles.size(); ++id) {
    const auto vertex = [&](std::size_t i) {
      return scene.positions[scene.triangles[id].vertices[i]];
    };
    for (int repeat = 0; repeat < 10; ++repeat) {
      const float u = random.in(0.0F, 1.0F);
      const float v = random.in(0.0F, 1.0F - u);
      const Vec3 exact = (1.0F - u - v) * vertex(0) + u * vertex(1) + v * vertex(2);
      const Vec3 point = exact + 0.5F * kVoxelMargin * random.in_cube(-1.0F, 1.0F);
      bool held = false;
      for (std::size_t voxel = 0; voxel < bounds.size() && !held; ++voxel) {
        held = contains(bounds[voxel], point) &&
               std::binary_search(ids[voxel].begin(), ids[voxel].end(), id);
      }
      EXPECT_TRUE(held) << "triangle " << id;
    }
  }
}

// A triangle across a small cell: the bounds follow its part inside, not its own box.
TEST(VoxelBounds, AreThoseOfTheClippedTriangles) {
  Scene scene = test::empty_scene();
  test::add_triangle(scene, {-1, -1, 0.25F}, {1, -1, 0.25F}, {-1, 1, 0.25F});
  const Aabb cell{{-0.5F, -0.5F, 0.0F}, {0.5F, 0.5F, 1.0F}};

  const Aabb bounds = voxel_bounds(scene, {0}, cell);

  const float margin = 2.5F * kVoxelMargin;
  for (const auto& [found, expected] : {std::pair{bounds.low, Vec3(-0.5F, -0.5F, 0.25F)},
                                        std::pair{bounds.high, Vec3(0.5F, 0.5F, 0.25F)}}) {
    for (int axis = 0; axis < 3; ++axis) { EXPECT_NEAR(found[axis], expected[axis], margin); }
  }
  EXPECT_LT(bounds.low.z, 0.25F);
  EXPECT_GT(bounds.high.z, 0.25F);

  const Aabb corner{{0.25F, -0.5F, 0.0F}, {1.25F, 0.5F, 1.0F}};
  EXPECT_NEAR(voxel_bounds(scene, {0}, corner).high.x, 0.5F, margin);  // on x + y = 0 at y = -0.5
}

TEST(DefaultVoxelSize, FollowsTheSceneBetweenItsLimits) {
  EXPECT_EQ(default_voxel_size(test::sheet(10)), kVoxelSizeBytesMin);
  const Scene middle = test::sheet(200);
  EXPECT_EQ(default_voxel_size(middle),
            voxel_block_bytes(middle.positions.size(), middle.triangles.size(), true) / 256);
  Scene large = test::empty_scene();
  large.triangles.resize(6'000'000);
  EXPECT_EQ(default_voxel_size(large), kVoxelSizeBytesDefaultMax);
}

}  // namespace
}  // namespace preheat
