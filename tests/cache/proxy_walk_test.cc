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

}  // namespace
}  // namespace preheat
