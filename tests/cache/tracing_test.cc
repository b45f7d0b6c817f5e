#include "cache/tracing.h"

#include <gtest/gtest.h>

#include <cstring>
#include <functional>
#include <iostream>
#include <map>
#include <numeric>
#include <optional>
#include <set>

#include "tests/scenes/grid_store.h"
#include "tests/scenes/soups.h"

namespace preheat {
namespace {

using test::GridStore;
using test::SoupRandom;

// The soup with some triangles repeated exactly, so that the lowest id must win.
Scene soup_with_coincident_triangles(std::size_t triangle_count, std::uint32_t seed) {
  Scene scene = test::soup(triangle_count, 0.06F, seed);
  for (std::size_t id = 0; id < triangle_count / 10; ++id) {
    scene.triangles.push_back(scene.triangles[id * 7 % triangle_count]);
  }
  return scene;
}

Vec3 unit_direction(SoupRandom& random) {
  for (;;) {
    const Vec3 direction = random.in_cube(-1.0F, 1.0F);
    const float squared = glm::dot(direction, direction);
    if (squared > 0.01F && squared < 1.0F) { return direction / std::sqrt(squared); }
  }
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

// Everything that reaches shading, bit by bit.
struct Outcome {
  bool any_hit = false;
  float t = 0.0F;
  std::uint32_t triangle = kNoTriangle;
  SurfaceHit surface{};
};

bool same_bits(const Outcome& a, const Outcome& b) {
  if (a.any_hit != b.any_hit || a.triangle != b.triangle) { return false; }
  return a.triangle == kNoTriangle || (std::memcmp(&a.t, &b.t, sizeof a.t) == 0 &&
                                       std::memcmp(&a.surface, &b.surface, sizeof a.surface) == 0);
}

// A residency over some hot voxels, with at most `resident_max` cold ones published, first in first
// out.
class Layout {
 public:
  Layout(const GridStore& store, const std::vector<VoxelId>& hot, std::size_t resident_max)
      : store_(store),
        resident_max_(resident_max),
        table_(store.blocks.size(), 1),
        uses_(store.blocks.size()),
        hot_mesh_(store.tables, hot) {
    std::set<VoxelId> hot_ids(hot.begin(), hot.end());
    for (const VoxelId voxel : hot) { hot_mesh_.add(store.view(voxel)); }
    for (std::uint32_t id = 0; id < store.blocks.size(); ++id) {
      if (!hot_ids.contains(VoxelId{id})) { cold_.push_back(VoxelId{id}); }
    }
    residency_.emplace(device_, hot_mesh_, store.tables, cold_, table_);
  }

  Outcome trace(const Ray& ray) {
    Outcome outcome;
    RayQuery closest;
    closest.ray = ray;
    answer(closest);
    outcome.t = closest.t_best;
    outcome.triangle = closest.triangle_best;
    if (closest.has_hit()) { outcome.surface = residency_->surface(closest); }
    RayQuery any;
    any.ray = ray;
    any.any_hit = true;
    answer(any);
    outcome.any_hit = any.blocked;
    return outcome;
  }

  [[nodiscard]] std::size_t parked_count() const { return parked_count_; }
  [[nodiscard]] std::size_t parked_longest() const { return parked_longest_; }

 private:
  void answer(RayQuery& query) {
    const ResidentTable::Guard guard(table_, 0);
    Residency::Answer answer = residency_->trace(query, uses_);
    std::size_t parked = 0;
    while (answer == Residency::Answer::kWaiting) {
      ++parked;
      ASSERT_LE(parked, store_.blocks.size()) << "a voxel was asked for twice";
      make_resident(query.missing[0].voxel);
      answer = residency_->resume(query, uses_);
    }
    parked_count_ += parked;
    parked_longest_ = std::max(parked_longest_, parked);
  }

  void make_resident(VoxelId voxel) {
    if (published_.size() == resident_max_) {
      static_cast<void>(table_.withdraw(published_.front()));
      published_.erase(published_.begin());
    }
    std::unique_ptr<VoxelMesh>& mesh = meshes_[voxel];
    if (mesh == nullptr) { mesh = std::make_unique<VoxelMesh>(store_.view(voxel)); }
    table_.publish(voxel, mesh.get());
    published_.push_back(voxel);
  }

  const GridStore& store_;
  std::size_t resident_max_;
  TracingDevice device_{1};
  ResidentTable table_;
  VoxelUses uses_;
  HotMesh hot_mesh_;
  std::vector<VoxelId> cold_;
  std::optional<Residency> residency_;
  std::map<VoxelId, std::unique_ptr<VoxelMesh>> meshes_;
  std::vector<VoxelId> published_;
  std::size_t parked_count_ = 0;
  std::size_t parked_longest_ = 0;
};

std::vector<VoxelId> every_voxel(const GridStore& store, std::uint32_t stride) {
  std::vector<VoxelId> voxels;
  for (std::uint32_t id = 0; id < store.blocks.size(); id += stride) {
    voxels.push_back(VoxelId{id});
  }
  return voxels;
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

constexpr auto kEpsilon = static_cast<double>(std::numeric_limits<float>::epsilon());

// Moeller-Trumbore in double; t and whether the ray is clear of the triangle's edges.
struct ExactHit {
  double t = std::numeric_limits<double>::infinity();
  double margin = 0.0;  // least barycentric coordinate
  double cosine = 0.0;
  double rounding = 0.0;  // how far t in float may be off
};

std::optional<ExactHit> intersect_exactly(const Scene& scene, std::uint32_t id, const Ray& ray) {
  const auto& v = scene.triangles[id].vertices;
  const Vec3d a(scene.positions[v[0]]);
  const Vec3d edge1 = Vec3d(scene.positions[v[1]]) - a;
  const Vec3d edge2 = Vec3d(scene.positions[v[2]]) - a;
  const Vec3d direction(ray.direction);
  const Vec3d p = glm::cross(direction, edge2);
  const double determinant = glm::dot(edge1, p);
  if (determinant == 0.0) { return std::nullopt; }
  const Vec3d s = Vec3d(ray.origin) - a;
  const double u = glm::dot(s, p) / determinant;
  const Vec3d q = glm::cross(s, edge1);
  const double w = glm::dot(direction, q) / determinant;
  ExactHit hit;
  hit.t = glm::dot(edge2, q) / determinant;
  hit.margin = std::min({u, w, 1.0 - u - w});
  const Vec3d normal = glm::cross(edge1, edge2);
  hit.cosine = std::abs(glm::dot(glm::normalize(normal), direction));
  // t is the height over the plane divided by the cosine. A needle's normal loses as many digits as
  // its edges are longer than their cross product.
  const double cancelled = glm::length(edge1) * glm::length(edge2) / glm::length(normal);
  hit.rounding = 16.0 * kEpsilon * glm::length(s) * cancelled / hit.cosine;
  if (hit.t < 0.0 || hit.margin < 0.0) { return std::nullopt; }
  return hit;
}

// Rays whose nearest hit in double is clear of edges and not grazing: there float must agree.
TEST(Residency, FindsWhatASearchOfAllTrianglesInDoubleFinds) {
  const auto seed = static_cast<std::uint32_t>(std::random_device{}());
  std::cout << "seed=" << seed << '\n';
  const Scene scene = soup_with_coincident_triangles(400, seed);
  const GridStore store = test::cut_into_grid(scene, 3);
  Layout layout(store, every_voxel(store, 2), 3);
  SoupRandom random(seed);

  int clear = 0;
  for (int ray_index = 0; ray_index < 200000; ++ray_index) {
    const Ray ray = make_ray(scene, kRayFamilies[ray_index % 3], random);
    ExactHit nearest;
    bool grazed = false;
    for (std::uint32_t id = 0; id < scene.triangles.size(); ++id) {
      const std::optional<ExactHit> hit = intersect_exactly(scene, id, ray);
      if (!hit || hit->t >= nearest.t) { continue; }
      grazed = hit->margin < 1e-4 || hit->cosine < 1e-3 || hit->t < 1e-4;
      nearest = *hit;
    }
    if (grazed) { continue; }
    ++clear;
    const Outcome outcome = layout.trace(ray);
    if (nearest.t == std::numeric_limits<double>::infinity()) { continue; }
    ASSERT_NE(outcome.triangle, kNoTriangle) << "ray " << ray_index;
    ASSERT_TRUE(outcome.any_hit) << "ray " << ray_index;
    const auto t = static_cast<double>(outcome.t);
    ASSERT_LE(t, nearest.t + nearest.rounding) << "ray " << ray_index;
    const std::optional<ExactHit> found = intersect_exactly(scene, outcome.triangle, ray);
    ASSERT_TRUE(!found || std::abs(found->t - t) <= found->rounding)
        << "ray " << ray_index << ": " << t << " instead of " << found->t;
  }
  EXPECT_GT(clear, 150000);
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
