#include "common/box_clip.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstddef>

namespace preheat {
namespace {

const Aabb kUnitBox{Vec3(0.0F), Vec3(1.0F)};

double area(const ClippedTriangle& clipped) {
  const auto polygon = clipped.vertices();
  Vec3d doubled(0.0);
  for (std::size_t i = 1; i + 1 < polygon.size(); ++i) {
    doubled += glm::cross(polygon[i] - polygon[0], polygon[i + 1] - polygon[0]);
  }
  return 0.5 * glm::length(doubled);
}

TEST(BoxClip, LeavesATriangleInsideAsItIs) {
  const std::array<Vec3d, 3> triangle{Vec3d(0.1), Vec3d(0.9, 0.2, 0.3), Vec3d(0.2, 0.8, 1.0)};

  const ClippedTriangle clipped = clip_to_box(triangle, kUnitBox);

  ASSERT_EQ(clipped.count, 3U);
  for (std::size_t i = 0; i < 3; ++i) { EXPECT_EQ(clipped.corners[i], triangle[i]); }
}

TEST(BoxClip, CutsALargeTriangleToTheBoxsSection) {
  // The plane x + y + z = 3/2 meets the unit cube in a regular hexagon of side sqrt(1/2).
  const ClippedTriangle clipped =
      clip_to_box({Vec3d(9.5, -4, -4), Vec3d(-4, 9.5, -4), Vec3d(-4, -4, 9.5)}, kUnitBox);

  EXPECT_EQ(clipped.count, 6U);
  EXPECT_NEAR(area(clipped), 1.5 * std::sqrt(3.0) * 0.5, 1e-12);
  for (const Vec3d& vertex : clipped.vertices()) {
    int in_a_plane = 0;
    for (int axis = 0; axis < 3; ++axis) {
      EXPECT_GE(vertex[axis], 0.0);
      EXPECT_LE(vertex[axis], 1.0);
      in_a_plane += vertex[axis] == 0.0 || vertex[axis] == 1.0 ? 1 : 0;
    }
    EXPECT_GE(in_a_plane, 2);
  }
}

TEST(BoxClip, KeepsWhatTouchesAndDropsWhatDoesNot) {
  const auto kept = [](double x) {
    return clip_to_box({Vec3d(x, 0.2, 0.2), Vec3d(x, 0.8, 0.2), Vec3d(x, 0.2, 0.8)}, kUnitBox)
        .count;
  };
  EXPECT_EQ(kept(1.0), 3U);
  EXPECT_EQ(kept(1.0 + 1e-15), 0U);
  EXPECT_EQ(kept(0.0), 3U);
}

}  // namespace
}  // namespace preheat
