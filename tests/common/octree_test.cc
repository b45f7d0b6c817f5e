#include "common/octree.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <iostream>
#include <numeric>
#include <random>
#include <set>
#include <span>
#include <vector>

#include "common/box_clip.h"
#include "common/scene_tables.h"
#include "tests/scenes/ray_count.h"
#include "tests/scenes/soups.h"

namespace preheat {
namespace {

using test::ray_count;
using test::SoupRandom;

struct Leaf {
  Aabb cell{};
  std::uint32_t depth = 0;
  std::span<const std::uint32_t> references{};
};

// The leaves in the order of a depth-first walk.
std::vector<Leaf> leaves_of(const Octree& octree) {
  struct Waiting {
    std::uint32_t node = 0;
    Aabb cell{};
    std::uint32_t depth = 0;
  };
  std::vector<Leaf> leaves;
  std::vector<Waiting> waiting{{0, octree.root, 0}};
  while (!waiting.empty()) {
    const Waiting at = waiting.back();
    waiting.pop_back();
    const OctreeNode& node = octree.nodes[at.node];
    if (node.first_child == 0) {
      leaves.push_back(
          {at.cell, at.depth,
           std::span(octree.references).subspan(node.references_begin, node.references_count)});
      continue;
    }
    for (unsigned octant = 8; octant-- > 0;) {
      waiting.push_back({node.first_child + octant, child_cell(at.cell, octant), at.depth + 1});
    }
  }
  return leaves;
}

bool contains(const Aabb& box, const Vec3& point) {
  for (int axis = 0; axis < 3; ++axis) {
    if (point[axis] < box.low[axis] || point[axis] > box.high[axis]) { return false; }
  }
  return true;
}

std::array<Vec3, 3> vertices_of(const Scene& scene, std::size_t triangle) {
  std::array<Vec3, 3> vertices{};
  for (std::size_t i = 0; i < 3; ++i) {
    vertices[i] = scene.positions[scene.triangles[triangle].vertices[i]];
  }
  return vertices;
}

Vec3 random_point(const std::array<Vec3, 3>& triangle, SoupRandom& random) {
  float u = random.in(0.0F, 1.0F);
  float v = random.in(0.0F, 1.0F);
  switch (random.below(6)) {
    case 0:
      u = 0.0F;
      break;  // on an edge
    case 1:
      u = 0.0F, v = 0.0F;
      break;  // a vertex
    case 2:
      v = 1.0F - u;
      break;
    default:
      break;
  }
  if (u + v > 1.0F) { u = 1.0F - u, v = 1.0F - v; }
  return (1.0F - u - v) * triangle[0] + u * triangle[1] + v * triangle[2];
}

void expect_same(const Octree& one, const Octree& other) {
  ASSERT_EQ(one.nodes.size(), other.nodes.size());
  EXPECT_EQ(
      std::memcmp(one.nodes.data(), other.nodes.data(), one.nodes.size() * sizeof(OctreeNode)), 0);
  EXPECT_EQ(one.references, other.references);
  EXPECT_EQ(one.depth_max, other.depth_max);
}

TEST(Octree, OfAnEmptySceneIsOneEmptyLeaf) {
  const Octree octree = build_octree(test::empty_scene(), {});

  ASSERT_EQ(octree.nodes.size(), 1U);
  EXPECT_EQ(octree.nodes[0].first_child, 0U);
  EXPECT_EQ(octree.nodes[0].references_count, 0U);
  EXPECT_FALSE(octree.root.is_empty());
}

TEST(Octree, OfOneTriangleIsOneLeaf) {
  Scene scene = test::empty_scene();
  test::add_triangle(scene, {0, 0, 0}, {1, 0, 0}, {0, 1, 0});

  const Octree octree = build_octree(scene, {});

  ASSERT_EQ(octree.nodes.size(), 1U);
  EXPECT_EQ(octree.references, std::vector<std::uint32_t>{0});
}

TEST(Octree, RootIsACubeAroundTheSceneWithRoomToSpare) {
  Scene flat = test::empty_scene();
  test::add_triangle(flat, {-1, 0.25F, -1}, {1, 0.25F, -1}, {0, 0.25F, 1});

  const Octree octree = build_octree(flat, {});

  const Vec3 extent = octree.root.extent();
  EXPECT_NEAR(extent.x, extent.y, 1e-6F);
  EXPECT_NEAR(extent.x, extent.z, 1e-6F);
  for (const Vec3& position : flat.positions) {
    for (int axis = 0; axis < 3; ++axis) {
      EXPECT_GE(position[axis] - octree.root.low[axis], 2.0F * kVoxelMargin);
      EXPECT_GE(octree.root.high[axis] - position[axis], 2.0F * kVoxelMargin);
    }
  }
}

TEST(Octree, ChildCellsTileTheirParent) {
  const Aabb cell{{-0.3F, 0.1F, 0.7F}, {-0.1F, 0.3F, 0.9F}};
  for (unsigned octant = 0; octant < 8; ++octant) {
    const Aabb child = child_cell(cell, octant);
    for (int axis = 0; axis < 3; ++axis) {
      const bool upper = (octant >> axis & 1U) != 0;
      const Aabb twin = child_cell(cell, octant ^ (1U << axis));
      EXPECT_EQ(upper ? child.high[axis] : child.low[axis],
                upper ? cell.high[axis] : cell.low[axis]);
      EXPECT_EQ(upper ? child.low[axis] : child.high[axis],
                upper ? twin.high[axis] : twin.low[axis]);
    }
  }
}

// Every leaf that holds a point of a triangle references the triangle, even where the point is
// computed in float and lies in a face between cells.
TEST(Octree, LeavesAroundAPointOfATriangleReferenceIt) {
  constexpr std::uint32_t kSeed = 7;
  SCOPED_TRACE(kSeed);
  const Scene scene = test::soup(800, 0.1F, kSeed);
  const Octree octree = build_octree(scene, {.leaf_references_max = 8, .depth_max = 6});
  const std::vector<Leaf> leaves = leaves_of(octree);
  ASSERT_GT(leaves.size(), 300U);
  SoupRandom random(kSeed);

  std::size_t points_in_several_leaves = 0;
  for (std::uint32_t triangle = 0; triangle < scene.triangles.size(); ++triangle) {
    for (int repeat = 0; repeat < 12; ++repeat) {
      const Vec3 point = random_point(vertices_of(scene, triangle), random);
      std::size_t holding = 0;
      for (const Leaf& leaf : leaves) {
        if (!contains(leaf.cell, point)) { continue; }
        ++holding;
        EXPECT_TRUE(std::binary_search(leaf.references.begin(), leaf.references.end(), triangle))
            << "triangle " << triangle;
      }
      EXPECT_GE(holding, 1U);
      points_in_several_leaves += holding > 1;
    }
  }
  RecordProperty("points_in_several_leaves", static_cast<int>(points_in_several_leaves));
}

// The references are exactly what testing every triangle against every leaf finds.
TEST(Octree, LeavesHoldWhatBruteForceFinds) {
  constexpr std::uint32_t kSeed = 11;
  SCOPED_TRACE(kSeed);
  const Scene scene = test::soup(500, 0.08F, kSeed);
  const Octree octree = build_octree(scene, {.leaf_references_max = 6, .depth_max = 5});

  std::set<std::uint32_t> seen;
  std::size_t extra = 0;
  std::size_t total = 0;
  for (const Leaf& leaf : leaves_of(octree)) {
    total += leaf.references.size();
    for (std::uint32_t triangle = 0; triangle < scene.triangles.size(); ++triangle) {
      const std::array<Vec3, 3> v = vertices_of(scene, triangle);
      const bool overlaps = triangle_overlaps_box(v[0], v[1], v[2], grown_cell(leaf.cell));
      const bool referenced =
          std::binary_search(leaf.references.begin(), leaf.references.end(), triangle);
      EXPECT_TRUE(referenced || !overlaps) << "triangle " << triangle;
      extra += referenced && !overlaps;
    }
    seen.insert(leaf.references.begin(), leaf.references.end());
  }

  EXPECT_EQ(seen.size(), scene.triangles.size());
  EXPECT_LE(extra * 1000, total);  // the builder may only add what touches a box within rounding
}

TEST(Octree, SubtreesAreContiguousRangesInMortonOrder) {
  const Scene scene = test::soup(3000, 0.05F, 3);
  const Octree octree = build_octree(scene, {.leaf_references_max = 16, .depth_max = 8});

  std::size_t next = 0;
  for (const Leaf& leaf : leaves_of(octree)) {
    EXPECT_EQ(leaf.references.data(), octree.references.data() + next);
    next += leaf.references.size();
    EXPECT_TRUE(std::is_sorted(leaf.references.begin(), leaf.references.end()));
  }
  EXPECT_EQ(next, octree.references.size());
  for (std::size_t i = 0; i < octree.nodes.size(); ++i) {
    const OctreeNode& node = octree.nodes[i];
    if (node.first_child == 0) { continue; }
    EXPECT_GT(node.first_child, i);
    std::uint64_t end = node.references_begin;
    for (std::size_t octant = 0; octant < 8; ++octant) {
      const OctreeNode& child = octree.nodes[node.first_child + octant];
      EXPECT_EQ(child.references_begin, end);
      end += child.references_count;
    }
    EXPECT_EQ(end, node.references_begin + node.references_count);
  }
}

// Large enough that several tasks build it; small pieces would be one task.
TEST(Octree, IsTheSameOnAnyNumberOfThreads) {
  const Scene scene = test::sheet(250);
  const Octree one = build_octree(scene, {.threads = 1});
  for (const unsigned threads : {2U, 3U, 8U}) {
    SCOPED_TRACE(threads);
    expect_same(one, build_octree(scene, {.threads = threads}));
  }
}

TEST(Octree, StopsWhereTrianglesCoincide) {
  Scene scene = test::empty_scene();
  test::add_triangle(scene, {-0.5F, -0.5F, -0.4F}, {0.6F, -0.4F, 0.5F}, {0.1F, 0.8F, 0.2F});
  scene.triangles.resize(1'000'000, scene.triangles[0]);

  const Octree octree = build_octree(scene, {});

  EXPECT_LE(octree.references.size(), 8 * scene.triangles.size());
  EXPECT_LE(octree.nodes.size(), 8U * 16U + 1U);
}

TEST(Octree, StopsWhereTrianglesShareAPoint) {
  Scene scene = test::empty_scene();
  const Vec3 apex(0.123F, -0.456F, 0.789F);
  test::add_triangle(scene, apex, apex + Vec3(1e-7F, 0, 0), apex + Vec3(0, 1e-7F, 0));
  scene.triangles.resize(100'000, scene.triangles[0]);
  test::add_triangle(scene, {-1, -1, -1}, {-0.9F, -1, -1}, {-1, -0.9F, -1});
  test::add_triangle(scene, {1, 1, 1}, {0.9F, 1, 1}, {1, 0.9F, 1});

  const Octree octree = build_octree(scene, {});

  EXPECT_LE(octree.nodes.size(), 8U * 16U + 1U);
  EXPECT_LE(octree.references.size(), 8 * scene.triangles.size());
}

TEST(Octree, OfASceneInOnePointIsALeaf) {
  Scene scene = test::empty_scene();
  test::add_triangle(scene, {0.5F, 0.5F, 0.5F}, {0.5F, 0.5F, 0.5F}, {0.5F, 0.5F, 0.5F});
  scene.triangles.resize(1000, scene.triangles[0]);

  const Octree octree = build_octree(scene, {});

  EXPECT_LE(octree.nodes.size(), 8U * 16U + 1U);
  EXPECT_GE(octree.references.size(), 1000U);
}

// Triangles that span the scene are in every cell they can be in.
TEST(Octree, BoundsTheReferencesOfTrianglesThatSpanTheScene) {
  Scene scene = test::empty_scene();
  SoupRandom random(5);
  for (int i = 0; i < 10'000; ++i) {
    test::add_triangle(scene, {-1, random.in(-1.0F, 1.0F), -1}, {1, random.in(-1.0F, 1.0F), -1},
                       {0, random.in(-1.0F, 1.0F), 1});
  }

  const Octree octree = build_octree(scene, {.leaf_references_max = 4, .depth_max = 10});

  EXPECT_LE(octree.references.size(), 8 * scene.triangles.size());
}

TEST(Octree, HonoursLeafSizeAndDepth) {
  const Scene scene = test::sheet(64);
  const Octree octree = build_octree(scene, {.leaf_references_max = 10, .depth_max = 4});

  for (const Leaf& leaf : leaves_of(octree)) { EXPECT_LE(leaf.depth, 4U); }
  EXPECT_EQ(octree.depth_max, 4U);
  const Octree deep = build_octree(scene, {.leaf_references_max = 30, .depth_max = 16});
  std::size_t large = 0;
  for (const Leaf& leaf : leaves_of(deep)) { large += leaf.references.size() > 30; }
  EXPECT_EQ(large, 0U);
}

TEST(Octree, CellsTooSmallToMatterAreLeaves) {
  Scene scene = test::empty_scene();
  SoupRandom random(2);
  for (int i = 0; i < 4000; ++i) {
    const Vec3 at = 3e-6F * random.in_cube(-1.0F, 1.0F);
    test::add_triangle(scene, at, at + Vec3(1e-8F, 0, 0), at + Vec3(0, 1e-8F, 0));
  }

  const Octree octree =
      build_octree(scene, {.leaf_references_max = 1, .depth_max = kOctreeDepthMax});

  for (const Leaf& leaf : leaves_of(octree)) {
    EXPECT_GE(leaf.cell.extent().x, 1.99F * kVoxelMargin);
  }
}

struct OverlapCase {
  const char* name;
  std::array<Vec3, 3> triangle;
  bool overlaps;
};

class TriangleOverlapsUnitBox : public testing::TestWithParam<OverlapCase> {};

TEST_P(TriangleOverlapsUnitBox, AsGeometrySays) {
  const Aabb box{Vec3(0.0F), Vec3(1.0F)};
  std::array<Vec3, 3> v = GetParam().triangle;
  for (int order = 0; order < 6; ++order) {
    EXPECT_EQ(triangle_overlaps_box(v[0], v[1], v[2], box), GetParam().overlaps);
    std::swap(v[0], v[static_cast<std::size_t>(1 + order % 2)]);
  }
}

INSTANTIATE_TEST_SUITE_P(
    Octree, TriangleOverlapsUnitBox,
    testing::Values(
        OverlapCase{
            "inside", {Vec3(.2F, .2F, .2F), Vec3(.8F, .2F, .2F), Vec3(.2F, .8F, .3F)}, true},
        OverlapCase{"around", {Vec3(-9, -9, .5F), Vec3(9, -9, .5F), Vec3(0, 9, .5F)}, true},
        OverlapCase{"in_a_face", {Vec3(-9, -9, 1), Vec3(9, -9, 1), Vec3(0, 9, 1)}, true},
        OverlapCase{"above_a_face",
                    {Vec3(-9, -9, 1.0001F), Vec3(9, -9, 1.0001F), Vec3(0, 9, 1.0001F)},
                    false},
        OverlapCase{"touches_a_corner", {Vec3(1, 1, 1), Vec3(2, 1, 1), Vec3(1, 2, 2)}, true},
        OverlapCase{"touches_an_edge", {Vec3(1, 1, -5), Vec3(1, 1, 5), Vec3(3, 3, 0)}, true},
        OverlapCase{"cuts_a_corner", {Vec3(2.9F, 0, 0), Vec3(0, 2.9F, 0), Vec3(0, 0, 2.9F)}, true},
        OverlapCase{
            "passes_a_corner", {Vec3(3.1F, 0, 0), Vec3(0, 3.1F, 0), Vec3(0, 0, 3.1F)}, false},
        OverlapCase{"box_in_reach_of_bounds_only",
                    {Vec3(-1, 1.5F, .5F), Vec3(.4F, 3, .5F), Vec3(-1, 3, .5F)},
                    false},
        OverlapCase{
            "edge_passes_an_edge", {Vec3(2.1F, 0, -1), Vec3(0, 2.1F, 2), Vec3(3, 3, .5F)}, false},
        OverlapCase{"sliver_through",
                    {Vec3(-5, .5F, .5F), Vec3(5, .5F, .5F), Vec3(5, .5000001F, .5F)},
                    true},
        OverlapCase{"a_point_inside", {Vec3(.5F), Vec3(.5F), Vec3(.5F)}, true},
        OverlapCase{"a_point_outside", {Vec3(1.5F), Vec3(1.5F), Vec3(1.5F)}, false}),
    [](const auto& tested) { return tested.param.name; });

// A box around any computed point of a triangle overlaps it, however small the box is.
TEST(TriangleOverlapsBox, IsConservative) {
  constexpr std::uint32_t kSeed = 23;
  SCOPED_TRACE(kSeed);
  const Scene scene = test::soup(2000, 0.3F, kSeed);
  SoupRandom random(kSeed);
  for (std::size_t triangle = 0; triangle < scene.triangles.size(); ++triangle) {
    const std::array<Vec3, 3> v = vertices_of(scene, triangle);
    for (int repeat = 0; repeat < 20; ++repeat) {
      const Vec3 point = random_point(v, random);
      const Vec3 half = random.in_cube(0.0F, 1.0F) * (repeat % 2 == 0 ? 1e-4F : 0.2F);
      const Aabb box = grown_cell({point - half, point + half});
      EXPECT_TRUE(triangle_overlaps_box(v[0], v[1], v[2], box)) << "triangle " << triangle;
    }
  }
}

// Triangles that touch a box by a corner, an edge or a face, on either side of rounding: what
// clipping in double keeps overlaps, and what overlaps is kept by a box larger by a hair.
TEST(TriangleOverlapsBox, AgreesWithClippingInDouble) {
  const auto seed = static_cast<std::uint32_t>(std::random_device{}());
  std::cout << "seed=" << seed << '\n';
  const Scene scene = test::soup(2000, 0.3F, seed);
  SoupRandom random(seed);
  std::size_t overlapping = 0;
  std::size_t lost = 0;
  std::size_t invented = 0;
  for (int index = 0; index < ray_count(1'000'000); ++index) {
    const auto triangle = random.below(static_cast<std::uint32_t>(scene.triangles.size()));
    const std::array<Vec3, 3> v = vertices_of(scene, triangle);
    const Vec3 point = random_point(v, random);
    Aabb box;
    for (int axis = 0; axis < 3; ++axis) {
      // From the point to one side of it, around it, or a last bit beside it.
      const float width = random.below(8) == 0 ? 0.0F : random.in(0.0F, 0.5F);
      const float at = random.below(4) == 0 ? std::nextafter(point[axis], 2.0F) : point[axis];
      box.low[axis] = random.below(2) == 0 ? at : at - width;
      box.high[axis] = box.low[axis] + width;
    }
    const std::array<Vec3d, 3> exact{Vec3d(v[0]), Vec3d(v[1]), Vec3d(v[2])};
    const bool overlaps = triangle_overlaps_box(v[0], v[1], v[2], box);
    overlapping += overlaps ? 1U : 0U;
    lost += !overlaps && clip_to_box(exact, box).count > 0 ? 1U : 0U;
    if (overlaps) {
      const Aabb larger{box.low - Vec3(1e-6F), box.high + Vec3(1e-6F)};
      invented += clip_to_box(exact, larger).count == 0 ? 1U : 0U;
    }
  }

  EXPECT_EQ(lost, 0U);
  // The normal of a needle says little of its plane.
  EXPECT_LE(invented * 1000, overlapping);
  EXPECT_GT(overlapping, static_cast<std::size_t>(ray_count(300'000)));
  EXPECT_LT(overlapping, static_cast<std::size_t>(ray_count(900'000)));
}

// Down to the deepest level a point's cell holds it, and has its share of the root.
TEST(Octree, CellsOfEveryLevelHoldTheirPoints) {
  const auto seed = static_cast<std::uint32_t>(std::random_device{}());
  std::cout << "seed=" << seed << '\n';
  const Scene scene = test::soup(100, 0.3F, seed);
  const Octree octree = build_octree(scene, {});
  SoupRandom random(seed);
  for (int index = 0; index < 20'000; ++index) {
    Vec3 point = random.in_cube(-1.0F, 1.0F);
    if (index % 2 == 0) { point = scene.positions[random.below(300)]; }
    Aabb cell = octree.root;
    for (std::uint32_t depth = 1; depth <= kOctreeDepthMax; ++depth) {
      unsigned octant = 0;
      while (octant < 8 && !contains(child_cell(cell, octant), point)) { ++octant; }
      ASSERT_LT(octant, 8U) << "depth " << depth;
      cell = child_cell(cell, octant);
      const double width =
          std::ldexp(static_cast<double>(octree.root.extent().x), -static_cast<int>(depth));
      for (int axis = 0; axis < 3; ++axis) {
        ASSERT_NEAR(static_cast<double>(cell.extent()[axis]), width, 0x1p-22) << "depth " << depth;
      }
    }
  }
}

TEST(Octree, TrianglesBelowANodeAscendAndAreUnique) {
  const Scene scene = test::soup(1000, 0.1F, 5);
  const Octree octree = build_octree(scene, {.leaf_references_max = 4});
  std::vector<std::uint32_t> all(scene.triangles.size());
  std::iota(all.begin(), all.end(), 0U);
  ASSERT_GT(octree.references.size(), all.size());
  EXPECT_EQ(triangles_below(octree, 0), all);
}

}  // namespace
}  // namespace preheat
