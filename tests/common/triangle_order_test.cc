#include "common/triangle_order.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iostream>
#include <numeric>
#include <random>

#include "common/aabb.h"
#include "tests/scenes/soups.h"

namespace preheat {
namespace {

using testing::ElementsAreArray;
using testing::UnorderedElementsAreArray;

std::vector<std::uint32_t> all_triangles(const Scene& scene) {
  std::vector<std::uint32_t> ids(scene.triangles.size());
  std::iota(ids.begin(), ids.end(), 0U);
  return ids;
}

// The surface of the boxes around runs of so many triangles, in all.
double surface_of_runs(const Scene& scene, const std::vector<std::uint32_t>& order,
                       std::size_t run) {
  double sum = 0.0;
  for (std::size_t begin = 0; begin < order.size(); begin += run) {
    Aabb box;
    for (std::size_t at = begin; at < std::min(begin + run, order.size()); ++at) {
      for (const std::uint32_t vertex : scene.triangles[order[at]].vertices) {
        box.extend(scene.positions[vertex]);
      }
    }
    const Vec3 extent = box.extent();
    sum +=
        2.0 * static_cast<double>(extent.x * extent.y + extent.y * extent.z + extent.z * extent.x);
  }
  return sum;
}

TEST(TriangleOrder, HasEveryTriangleOnce) {
  const auto seed = static_cast<std::uint32_t>(std::random_device{}());
  std::cout << "seed=" << seed << '\n';
  const Scene scene = test::soup(700, 0.1F, seed);
  const std::vector<std::uint32_t> all = all_triangles(scene);
  for (std::size_t count = 0; count <= all.size(); count += 1 + count / 7) {
    const std::vector<std::uint32_t> ids(all.end() - static_cast<std::ptrdiff_t>(count), all.end());
    EXPECT_THAT(order_for_tree(scene, ids), UnorderedElementsAreArray(ids)) << count;
  }
}

TEST(TriangleOrder, PutsNeighboursBesideEachOther) {
  Scene scene = test::sheet(40);
  std::shuffle(scene.triangles.begin(), scene.triangles.end(), std::mt19937(5));
  const std::vector<std::uint32_t> given = all_triangles(scene);

  const std::vector<std::uint32_t> order = order_for_tree(scene, given);

  // 3,200 triangles of 40 x 40 squares: four of them fill two squares at best, 32 fill 4 x 4.
  for (const std::size_t run : {kTrianglesPerLeaf, kTrianglesPerLeafNode}) {
    const double whole = surface_of_runs(scene, order, order.size());
    EXPECT_LT(surface_of_runs(scene, order, run), 2.0 * whole) << run;
    EXPECT_GT(surface_of_runs(scene, given, run), 20.0 * whole) << run;
  }
}

TEST(TriangleOrder, KeepsThatOfEqualTriangles) {
  Scene scene = test::empty_scene();
  for (int index = 0; index < 1000; ++index) {
    test::add_triangle(scene, Vec3(0.0F), Vec3(0.5F, 0.0F, 0.0F), Vec3(0.0F, 0.5F, 0.0F));
  }
  EXPECT_THAT(order_for_tree(scene, all_triangles(scene)), ElementsAreArray(all_triangles(scene)));
}

TEST(TriangleOrder, DoesNotDependOnScale) {
  Scene scene = test::soup(500, 0.1F, 11);
  const std::vector<std::uint32_t> order = order_for_tree(scene, all_triangles(scene));
  for (Vec3& position : scene.positions) { position *= 0x1p-12F; }
  EXPECT_THAT(order_for_tree(scene, all_triangles(scene)), ElementsAreArray(order));
}

}  // namespace
}  // namespace preheat
