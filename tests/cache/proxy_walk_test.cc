#include "cache/proxy_walk.h"

#include <gtest/gtest.h>

#include <vector>

#include "tests/cache/transport_truth.h"
#include "tests/scenes/soups.h"

namespace preheat {
namespace {

using test::add_triangle;
using test::CompiledScene;

// A floor over [-1,1]^2 with a ramp on its right half, which tilts the mean plane of both so far
// that on the left it lies below the floor.
Scene floor_with_ramp() {
  Scene scene = test::empty_scene();
  add_triangle(scene, {-1.0F, -1.0F, 0.0F}, {1.0F, -1.0F, 0.0F}, {1.0F, 1.0F, 0.0F});
  add_triangle(scene, {-1.0F, -1.0F, 0.0F}, {1.0F, 1.0F, 0.0F}, {-1.0F, 1.0F, 0.0F});
  add_triangle(scene, {0.0F, -1.0F, 0.0F}, {1.0F, -1.0F, 0.25F}, {1.0F, 1.0F, 0.25F});
  add_triangle(scene, {0.0F, -1.0F, 0.0F}, {1.0F, 1.0F, 0.25F}, {0.0F, 1.0F, 0.0F});
  return scene;
}

TEST(ProxyWalk, IsStoppedByAFloorWhosePlaneATiltTookOutOfItsBounds) {
  const std::uint32_t seed = 11;
  SCOPED_TRACE(seed);
  const CompiledScene compiled = test::compile_in_memory(floor_with_ramp(), 100);
  ASSERT_EQ(compiled.proxy.records.size(), 1U);
  ASSERT_NE(compiled.proxy.records[0].shape & kShapeFlat, 0);
  const Result<ProxyWalk> walk = ProxyWalk::create(compiled.tables, compiled.proxy);
  ASSERT_TRUE(walk.has_value()) << walk.error().message;
  std::vector<double> accesses(compiled.tables.voxels.size());
  test::SoupRandom random(seed);

  for (int i = 0; i < 1000; ++i) {
    const Vec3 on_floor = random.in_cube(-0.98F, 0.98F) * Vec3(1.0F, 1.0F, 0.0F);
    for (const float side : {-8.0F, 8.0F}) {
      Ray ray;
      ray.origin = on_floor + Vec3(0.05F * side * on_floor.y, 0.0F, side);
      ray.direction = glm::normalize(on_floor - ray.origin);

      EXPECT_TRUE(walk->walk(ray, ProxyOrigin{}, /*unstopped=*/0.0F, accesses).is_stopped)
          << on_floor.x << ' ' << on_floor.y << " from " << side;
    }
  }
}

// Rays from outside, and what stops them of a ball.
struct BallStops {
  int stopped = 0;
  int by_outline = 0;  // by a leaf whose normal points along the ray, but not much
};

BallStops stops_at_ball(const CompiledScene& compiled, const std::vector<std::uint8_t>& one_sided,
                        std::uint32_t seed) {
  const Result<ProxyWalk> walk = ProxyWalk::create(compiled.tables, compiled.proxy);
  EXPECT_TRUE(walk.has_value());
  test::SoupRandom random(seed);
  std::vector<double> accesses(compiled.tables.voxels.size());
  BallStops stops;
  for (int i = 0; i < 10000; ++i) {
    Ray ray;
    ray.direction = glm::normalize(random.in_cube(-1.0F, 1.0F));
    ray.origin = random.in_cube(-0.9F, 0.9F) - 4.0F * ray.direction;
    const ProxyStop stop = walk->walk(ray, ProxyOrigin{}, 0.5F, accesses, one_sided);
    if (!stop.is_stopped) { continue; }
    ++stops.stopped;
    const ProxyRecord& record = compiled.proxy.records[compiled.proxy.nodes[stop.leaf.node].first];
    const float rate = glm::dot(record_normal(record), ray.direction);
    const bool is_outline = rate > 0.0F && rate < 0.7F && (record.shape & kShapeFlat) != 0;
    stops.by_outline += is_outline ? 1 : 0;
  }
  return stops;
}

TEST(ProxyWalk, MeetsTheOutlineOfABallInFrontOnly) {
  const std::uint32_t seed = 5;
  SCOPED_TRACE(seed);
  const CompiledScene compiled = test::compile_in_memory(test::ball(7), 600);

  const BallStops both_sides = stops_at_ball(compiled, {}, seed);
  const BallStops front_only = stops_at_ball(compiled, {1}, seed);

  EXPECT_GT(both_sides.by_outline, both_sides.stopped / 40);
  EXPECT_EQ(front_only.by_outline, 0);
  EXPECT_GT(front_only.stopped, 9 * both_sides.stopped / 10);
}

TEST(ProxyWalk, IsStoppedInFrontByWhatHasOneSide) {
  const std::uint32_t seed = 6;
  SCOPED_TRACE(seed);
  const std::vector<std::uint8_t> one_sided{1};
  for (const bool is_inside_out : {false, true}) {
    const CompiledScene compiled =
        test::compile_in_memory(test::ball(24, 0.9F, is_inside_out), 600);
    const Result<ProxyWalk> walk = ProxyWalk::create(compiled.tables, compiled.proxy);
    ASSERT_TRUE(walk.has_value()) << walk.error().message;
    std::vector<double> accesses(compiled.tables.voxels.size());
    test::SoupRandom random(seed);
    const ProxyOrigin surface{0, kNoIndex};
    int stopped_outside = 0;
    int stopped_inside = 0;
    int stopped_inside_from_space = 0;

    for (int i = 0; i < 1000; ++i) {
      Ray ray;
      ray.direction = glm::normalize(random.in_cube(-1.0F, 1.0F));
      ray.origin = 0.2F * random.in_cube(-1.0F, 1.0F);
      ray.t_max = 1.5F;
      stopped_inside += walk->walk(ray, surface, 0.5F, accesses, one_sided).is_stopped ? 1 : 0;
      stopped_inside_from_space +=
          walk->walk(ray, ProxyOrigin{}, 0.5F, accesses, one_sided).is_stopped ? 1 : 0;
      ray.origin -= 4.0F * ray.direction;
      ray.t_max = 4.0F;
      stopped_outside += walk->walk(ray, surface, 0.5F, accesses, one_sided).is_stopped ? 1 : 0;
    }

    EXPECT_GT(is_inside_out ? stopped_inside : stopped_outside, 970);
    EXPECT_LT(is_inside_out ? stopped_outside : stopped_inside, 100);
    EXPECT_GT(stopped_inside_from_space, 900);  // a camera may look at backs
  }
}

}  // namespace
}  // namespace preheat
