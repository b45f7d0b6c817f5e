#include "cache/tracing.h"

#include <gtest/gtest.h>

#include <iostream>
#include <optional>
#include <random>
#include <set>

#include "tests/cache/layouts.h"
#include "tests/scenes/grid_store.h"
#include "tests/scenes/soups.h"

namespace preheat {
namespace {

using test::every_voxel;
using test::GridStore;
using test::Layout;
using test::Outcome;
using test::same_bits;
using test::SoupRandom;
using test::unit_direction;

// The soup with some triangles repeated exactly, so that the lowest id must win.
Scene soup_with_coincident_triangles(std::size_t triangle_count, std::uint32_t seed) {
  Scene scene = test::soup(triangle_count, 0.06F, seed);
  for (std::size_t id = 0; id < triangle_count / 10; ++id) {
    scene.triangles.push_back(scene.triangles[id * 7 % triangle_count]);
  }
  return scene;
}

enum class RayFamily { kRandom, kInVoxelFace, kAxisParallel, kAlongEdge, kAtVertex };
constexpr RayFamily kRayFamilies[] = {RayFamily::kRandom, RayFamily::kInVoxelFace,
                                      RayFamily::kAxisParallel, RayFamily::kAlongEdge,
                                      RayFamily::kAtVertex};

Ray make_ray(const Scene& scene, RayFamily family, SoupRandom& random) {
  Ray ray{random.in_cube(-1.0F, 1.0F), unit_direction(random)};
  const auto axis = static_cast<int>(random.below(3));
  const auto vertex = [&](unsigned corner, std::uint32_t id) {
    return scene.positions[scene.triangles[id].vertices[corner]];
  };
  const auto id = random.below(static_cast<std::uint32_t>(scene.triangles.size()));
  switch (family) {
    case RayFamily::kRandom:
      break;
    case RayFamily::kInVoxelFace:
      ray.origin[axis] = 0.5F * static_cast<float>(random.below(5)) - 1.0F;
      ray.direction[axis] = 0.0F;
      break;
    case RayFamily::kAxisParallel:
      ray.direction = Vec3(0.0F);
      ray.direction[axis] = random.below(2) == 0 ? 1.0F : -1.0F;
      break;
    case RayFamily::kAlongEdge:
      ray.origin = vertex(0, id);
      ray.direction = vertex(1, id) - vertex(0, id);
      break;
    case RayFamily::kAtVertex:
      ray.direction = vertex(2, id) - ray.origin;
      break;
  }
  const float length = std::sqrt(glm::dot(ray.direction, ray.direction));
  ray.direction = length > 0.0F ? ray.direction / length : Vec3(0.0F, 0.0F, 1.0F);
  return ray;
}

TEST(Residency, GivesTheSameBitsInEveryLayout) {
  const auto seed = static_cast<std::uint32_t>(std::random_device{}());
  std::cout << "seed=" << seed << '\n';
  const Scene scene = soup_with_coincident_triangles(1500, seed);
  const GridStore store = test::cut_into_grid(scene, 8);
  Layout reference(store, every_voxel(store, 1), 0);
  Layout one_resident(store, {}, 1);
  Layout few_resident(store, every_voxel(store, 3), 5);
  Layout all_resident(store, every_voxel(store, 2), store.blocks.size());
  SoupRandom random(seed);

  std::size_t hits = 0;
  std::size_t different = 0;
  for (int ray_index = 0; ray_index < 200000; ++ray_index) {
    const Ray ray = make_ray(scene, kRayFamilies[ray_index % 5], random);
    const Outcome expected = reference.trace(ray);
    hits += expected.triangle != kNoTriangle ? 1U : 0U;
    different += same_bits(expected, one_resident.trace(ray)) ? 0U : 1U;
    different += same_bits(expected, few_resident.trace(ray)) ? 0U : 1U;
    different += same_bits(expected, all_resident.trace(ray)) ? 0U : 1U;
  }

  EXPECT_EQ(different, 0U);
  EXPECT_GT(hits, 100000U);
  EXPECT_GT(one_resident.parked_longest(), RayQuery::kMissingMax) << "no ray asked again";
  EXPECT_GT(few_resident.parked_count(), 10000U);
}

// Bars with faces in axis planes: where two faces meet, a ray within the rounding of their edge can
// be found to meet one whose own box, which is flat, it passes by.
Scene bars(std::size_t count, SoupRandom& random) {
  Scene scene = test::empty_scene();
  for (std::size_t bar = 0; bar < count; ++bar) {
    const Vec3 low = random.in_cube(-0.9F, 0.8F);
    const Vec3 high = low + 0.01F + random.in_cube(0.0F, 0.09F) * random.in_cube(0.0F, 1.0F);
    const auto corner = [&](unsigned at) {
      return Vec3((at & 1U) != 0 ? high.x : low.x, (at & 2U) != 0 ? high.y : low.y,
                  (at & 4U) != 0 ? high.z : low.z);
    };
    for (unsigned axis = 0; axis < 3; ++axis) {
      const unsigned u = 1U << (axis + 1) % 3;
      const unsigned v = 1U << (axis + 2) % 3;
      for (const unsigned side : {0U, 1U << axis}) {
        test::add_triangle(scene, corner(side), corner(side + u), corner(side + u + v));
        test::add_triangle(scene, corner(side), corner(side + u + v), corner(side + v));
      }
    }
  }
  return scene;
}

TEST(Residency, GivesTheSameBitsInEveryLayoutAtTheEdgesOfBars) {
  const auto seed = static_cast<std::uint32_t>(std::random_device{}());
  std::cout << "seed=" << seed << '\n';
  SoupRandom random(seed);
  const Scene scene = bars(100, random);
  const GridStore store = test::cut_into_grid(scene, 8);
  Layout hot(store, every_voxel(store, 1), 0);
  Layout mixed(store, every_voxel(store, 3), store.blocks.size());
  Layout cold(store, {}, store.blocks.size());

  std::size_t different = 0;
  for (int ray_index = 0; ray_index < 200000; ++ray_index) {
    const auto id = random.below(static_cast<std::uint32_t>(scene.triangles.size()));
    const auto vertex = [&](unsigned corner) {
      return scene.positions[scene.triangles[id].vertices[corner]];
    };
    const unsigned first = random.below(3);
    const Vec3 at = glm::mix(vertex(first), vertex((first + 1) % 3), random.in(0.0F, 1.0F));
    // Near or far, and at times hardly above the plane of a face.
    Vec3 away = unit_direction(random) * std::exp(random.in(-6.0F, 0.0F));
    away[static_cast<int>(random.below(3))] *= random.below(2) == 0 ? 1.0F : 0.01F;
    const Ray ray{at + away, glm::normalize(-away)};
    const Outcome expected = hot.trace(ray);
    different += same_bits(expected, mixed.trace(ray)) ? 0U : 1U;
    different += same_bits(expected, cold.trace(ray)) ? 0U : 1U;
  }

  EXPECT_EQ(different, 0U);
}

// A ray past the upright face of a step at 10^-7 of its size, which its edge's rounding takes for a
// hit; it meets the tread.
TEST(Residency, DoesNotMeetATriangleWhoseOwnBoxTheRayPassesBy) {
  Scene scene = test::empty_scene();
  constexpr float kX = 0x1.ccccccp-4F;
  constexpr float kY0 = -0x1.733334p-2F;
  constexpr float kY1 = 0x1.d1eb86p-3F;
  constexpr float kZ = -0x1.3c28f6p-1F;
  test::add_triangle(scene, {kX, kY0, -0x1.6147aep-1F}, {kX, kY1, kZ}, {kX, kY0, kZ});
  test::add_triangle(scene, {0x1.ae147ap-4F, kY0, kZ}, {kX, kY0, kZ}, {kX, kY1, kZ});
  const GridStore store = test::cut_into_grid(scene, 2);
  const Ray ray{{0x1.01e39cp-3F, -0x1.733e6p-2F, -0x1.3b788cp-1F},
                {-0x1.20392cp-2F, 0x1.eb166ep-1F, -0x1.ce6c2ep-6F}};
  Layout hot(store, every_voxel(store, 1), 0);
  Layout cold(store, {}, 1);

  EXPECT_EQ(hot.trace(ray).triangle, 1U);
  EXPECT_EQ(cold.trace(ray).triangle, 1U);
}

TEST(Residency, TakesTheLowestIdOfCoincidentTriangles) {
  Scene scene = test::empty_scene();
  for (int copy = 0; copy < 9; ++copy) {
    test::add_triangle(scene, {-0.5F, -0.5F, 0.25F}, {0.7F, -0.5F, 0.25F}, {0.0F, 0.8F, 0.25F});
  }
  const GridStore store = test::cut_into_grid(scene, 2);
  Layout hot(store, every_voxel(store, 1), 0);
  Layout cold(store, {}, 1);
  const Ray ray{{0.01F, 0.02F, -0.9F}, {0.0F, 0.0F, 1.0F}};

  EXPECT_EQ(hot.trace(ray).triangle, 0U);
  EXPECT_EQ(cold.trace(ray).triangle, 0U);
}

TEST(Residency, AnyHitThatFoundABlockerWaitsForNothing) {
  Scene scene = test::empty_scene();
  test::add_triangle(scene, {-0.6F, -0.5F, -0.5F}, {-0.1F, -0.5F, -0.5F}, {-0.3F, 0.5F, -0.5F});
  test::add_triangle(scene, {-0.6F, -0.5F, 0.5F}, {-0.1F, -0.5F, 0.5F}, {-0.3F, 0.5F, 0.5F});
  const GridStore store = test::cut_into_grid(scene, 2);
  ResidentTable table(store.blocks.size(), 1);
  TracingDevice device(1);
  std::vector<VoxelId> hot;
  std::vector<VoxelId> cold;
  for (std::uint32_t id = 0; id < store.blocks.size(); ++id) {
    const bool holds_second = store.view(VoxelId{id}).triangles[0] == 1;
    (holds_second ? hot : cold).push_back(VoxelId{id});
  }
  HotMesh mesh(store.tables, hot);
  for (const VoxelId voxel : hot) { mesh.add(store.view(voxel)); }
  const Residency residency(device, mesh, store.tables, cold, table);
  RayQuery query;
  query.ray = {{-0.3F, -0.2F, -0.9F}, {0.0F, 0.0F, 1.0F}};
  query.any_hit = true;
  const ResidentTable::Guard guard(table, 0);

  VoxelUses uses(store.tables.voxels.size());

  EXPECT_EQ(residency.trace(query, uses), Residency::Answer::kFinal);
  EXPECT_TRUE(query.blocked);
}

TEST(HotMesh, StaysWithinTheBytesOfItsVoxelsHoweverManyTheyAre) {
  const GridStore store = test::cut_into_grid(test::soup(9000, 0.05F, 7), 10);
  for (std::size_t count = 1; count <= store.blocks.size(); count += 1 + count / 2) {
    std::vector<VoxelId> hot(count);
    std::uint64_t bytes_max = kBvhBytesFixed;
    for (std::uint32_t id = 0; id < count; ++id) {
      hot[id] = VoxelId{id};
      bytes_max += store.tables.voxels[id].hot_bytes();
    }
    HotMesh mesh(store.tables, hot);
    for (const VoxelId voxel : hot) { mesh.add(store.view(voxel)); }
    mesh.all_added();
    ResidentTable table(store.blocks.size(), 1);
    TracingDevice device(1);

    const Residency residency(device, mesh, store.tables, {}, table);

    EXPECT_LE(mesh.bytes() + device.bytes(), bytes_max) << count << " voxels";
  }
}

// The boxes of the others are beside that.
TEST(HotMesh, IsJoinedByBoxesOfAFewBytesEach) {
  const GridStore store = test::cut_into_grid(test::soup(9000, 0.05F, 7), 10);
  for (const std::uint32_t stride : {1U, 2U, 10U, 1000U}) {
    const std::vector<VoxelId> hot = every_voxel(store, stride);
    std::vector<VoxelId> cold;
    std::uint64_t bytes_max = 2 * kBvhBytesFixed;
    for (std::uint32_t id = 0; id < store.blocks.size(); ++id) {
      const bool is_hot = id % stride == 0;
      if (!is_hot) { cold.push_back(VoxelId{id}); }
      bytes_max += is_hot ? store.tables.voxels[id].hot_bytes() : kColdBoxBytes;
    }
    HotMesh mesh(store.tables, hot);
    for (const VoxelId voxel : hot) { mesh.add(store.view(voxel)); }
    mesh.all_added();
    ResidentTable table(store.blocks.size(), 1);
    TracingDevice device(1);

    const Residency residency(device, mesh, store.tables, cold, table);

    EXPECT_LE(mesh.bytes() + device.bytes(), bytes_max) << cold.size() << " cold";
  }
}

TEST(Residency, TakesAFewBytesForEachOfManyColdVoxels) {
  test::SoupRandom random(3);
  for (const std::uint32_t count : {1U, 8U, 100U, 3000U, 100'000U}) {
    SceneTables tables;
    std::vector<VoxelId> cold;
    for (std::uint32_t id = 0; id < count; ++id) {
      VoxelEntry entry;
      entry.bounds.extend(random.in_cube(-1.0F, 0.99F));
      entry.bounds.extend(entry.bounds.low + Vec3(0.01F));
      tables.voxels.push_back(entry);
      cold.push_back(VoxelId{id});
    }
    ResidentTable table(count, 1);
    TracingDevice device(1);
    const HotMesh none(tables, {});

    const Residency residency(device, none, tables, cold, table);

    EXPECT_GT(device.bytes(), 0U);
    EXPECT_LE(device.bytes(), kBvhBytesFixed + kColdBoxBytes * count) << count << " cold";
    EXPECT_LE(device.bytes_peak(), 2 * (kBvhBytesFixed + kColdBoxBytes * count)) << count;
  }
}

TEST(Accesses, CountEveryVoxelThatTheRayEntersBeforeItsEnd) {
  const auto seed = static_cast<std::uint32_t>(std::random_device{}());
  std::cout << "seed=" << seed << '\n';
  const Scene scene = test::soup(500, 0.2F, seed);
  const GridStore store = test::cut_into_grid(scene, 4);
  SoupRandom random(seed);

  for (int ray_index = 0; ray_index < 20000; ++ray_index) {
    const Ray ray = make_ray(scene, kRayFamilies[ray_index % 5], random);
    const float t_end = random.in(0.0F, 3.0F);
    std::set<VoxelId> expected;
    const Ray bounded{ray.origin, ray.direction, 0.0F, t_end};
    for (std::uint32_t id = 0; id < store.tables.voxels.size(); ++id) {
      if (!clip(bounded, store.tables.voxels[id].bounds).is_empty()) {
        expected.insert(VoxelId{id});
      }
    }
    std::multiset<VoxelId> visited;
    for_each_cell(store.tables.voxel_nodes, ray, t_end,
                  [&](std::uint32_t voxel) { visited.insert(VoxelId{voxel}); });

    ASSERT_TRUE(std::equal(visited.begin(), visited.end(), expected.begin(), expected.end()));
  }
}

TEST(ResidentTable, IsQuiescentOnceEveryBatchThatMayHaveLookedHasEnded) {
  ResidentTable table(1, 2);
  std::optional<ResidentTable::Guard> early(std::in_place, table, 0U);
  const std::uint64_t epoch = table.withdraw(VoxelId{0});
  const ResidentTable::Guard late(table, 1);

  EXPECT_FALSE(table.is_quiescent(epoch));
  early.reset();
  EXPECT_TRUE(table.is_quiescent(epoch));
}

}  // namespace
}  // namespace preheat
