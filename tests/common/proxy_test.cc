#include "common/proxy.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <tuple>

#include "common/voxel_block.h"
#include "tests/scenes/soups.h"

namespace preheat {
namespace {

using test::add_triangle;
using test::empty_scene;
using test::SoupRandom;

struct Built {
  Octree octree{};
  std::vector<std::uint32_t> voxel_roots{};
  Proxy proxy{};
};

// Voxels are the octree's nodes of at most so many references.
Built build(const Scene& scene, std::uint32_t voxel_references_max) {
  Built built;
  built.octree = build_octree(scene, {});
  std::vector<std::uint32_t> pending{0};
  while (!pending.empty()) {
    const std::uint32_t at = pending.back();
    const OctreeNode& node = built.octree.nodes[at];
    pending.pop_back();
    if (node.references_count == 0) { continue; }
    if (node.first_child == 0 || node.references_count <= voxel_references_max) {
      built.voxel_roots.push_back(at);
      continue;
    }
    for (unsigned octant = 8; octant-- > 0;) { pending.push_back(node.first_child + octant); }
  }
  built.proxy = build_proxy(scene, built.octree, built.voxel_roots);
  return built;
}

// One octree node over [-1,1]^3 is the only voxel.
Proxy build_in_one_voxel(const Scene& scene) {
  Octree octree;
  octree.root = {Vec3(-1.0F), Vec3(1.0F)};
  octree.nodes = {{0, static_cast<std::uint32_t>(scene.triangles.size()), 0}};
  for (std::uint32_t id = 0; id < scene.triangles.size(); ++id) { octree.references.push_back(id); }
  const std::vector<std::uint32_t> voxel_roots{0};
  return build_proxy(scene, octree, voxel_roots);
}

// The voxels' blocks without normals, and so less than what the store holds.
std::uint64_t block_bytes(const Scene& scene, const Built& built) {
  std::uint64_t sum = 0;
  for (const std::uint32_t root : built.voxel_roots) {
    const OctreeNode& node = built.octree.nodes[root];
    std::vector<std::uint32_t> ids(
        built.octree.references.begin() + static_cast<std::ptrdiff_t>(node.references_begin),
        built.octree.references.begin() +
            static_cast<std::ptrdiff_t>(node.references_begin + node.references_count));
    std::sort(ids.begin(), ids.end());
    ids.erase(std::unique(ids.begin(), ids.end()), ids.end());
    sum += encode_voxel_block(scene, ids).size();
  }
  return sum;
}

std::vector<const ProxyNode*> leaves(const Proxy& proxy) {
  std::vector<const ProxyNode*> found;
  for (const ProxyNode& node : proxy.nodes) {
    if (node.child_mask == 0) { found.push_back(&node); }
  }
  return found;
}

// A square grid of 2 * cells^2 triangles in a plane z = height over [-1,1]^2.
void add_sheet(Scene& scene, int cells, float height) {
  const float step = 2.0F / static_cast<float>(cells);
  for (int y = 0; y < cells; ++y) {
    for (int x = 0; x < cells; ++x) {
      const Vec3 corner(-1.0F + step * static_cast<float>(x), -1.0F + step * static_cast<float>(y),
                        height);
      const Vec3 across(step, 0.0F, 0.0F);
      const Vec3 along(0.0F, step, 0.0F);
      add_triangle(scene, corner, corner + across, corner + across + along);
      add_triangle(scene, corner, corner + across + along, corner + along);
    }
  }
}

TEST(Proxy, KeepsABareWallInOneLeafPerVoxel) {
  Scene scene = empty_scene();
  add_sheet(scene, /*cells=*/64, /*height=*/0.3F);

  const Built built = build(scene, /*voxel_references_max=*/600);

  EXPECT_GT(built.voxel_roots.size(), 4U);
  EXPECT_EQ(built.proxy.records.size(), built.voxel_roots.size());
  for (const ProxyRecord& record : built.proxy.records) {
    EXPECT_EQ(record.shape, kShapeFlat | kShapeOriented);
    EXPECT_EQ(record.coverage[0], 255);
    EXPECT_EQ(record_mask(record), ~std::uint64_t{0});
    EXPECT_EQ(record.thickness, 0);
    EXPECT_NEAR(record_normal(record).z, 1.0F, 1e-6F);
  }
  for (const ProxyNode* leaf : leaves(built.proxy)) {
    const ProxyRecord& record = built.proxy.records[leaf->first];
    EXPECT_NEAR(record_plane_offset(record, record_normal(record), leaf->bounds), 0.3F,
                2.0F * kVoxelMargin);
  }
}

TEST(Proxy, PutsAWallBetweenTwoVoxelsIntoBoth) {
  Scene scene = empty_scene();
  add_sheet(scene, /*cells=*/32, /*height=*/0.0F);
  add_triangle(scene, {-1.0F, -1.0F, -1.0F}, {-0.9F, -1.0F, -1.0F}, {-1.0F, -0.9F, -1.0F});
  add_triangle(scene, {1.0F, 1.0F, 1.0F}, {0.9F, 1.0F, 1.0F}, {1.0F, 0.9F, 1.0F});

  const Built built = build(scene, /*voxel_references_max=*/600);

  std::size_t below = 0;
  std::size_t above = 0;
  for (std::size_t voxel = 0; voxel < built.voxel_roots.size(); ++voxel) {
    const ProxyNode& root = built.proxy.nodes[built.proxy.roots[voxel]];
    const bool has_wall = root.bounds.low.z <= 0.0F && root.bounds.high.z >= 0.0F;
    if (has_wall && built.proxy.cells[voxel].high.z == 0.0F) { ++below; }
    if (has_wall && built.proxy.cells[voxel].low.z == 0.0F) { ++above; }
  }
  EXPECT_GE(below, 4U);
  EXPECT_GE(above, 4U);
}

// Bars across the unit square around the origin, in z = 0.
void add_bars(Scene& scene, int bars, float share) {
  const float step = 2.0F / static_cast<float>(bars);
  for (int bar = 0; bar < bars; ++bar) {
    const Vec3 corner(-1.0F, -1.0F + step * static_cast<float>(bar), 0.0F);
    const Vec3 across(2.0F, 0.0F, 0.0F);
    const Vec3 along(0.0F, step * share, 0.0F);
    add_triangle(scene, corner, corner + across, corner + across + along);
    add_triangle(scene, corner, corner + across + along, corner + along);
  }
}

// Of all triangles in one voxel, which has few enough of them to stay whole.
ProxyRecord only_record(const Scene& scene) {
  const Proxy proxy = build_in_one_voxel(scene);
  EXPECT_EQ(proxy.records.size(), 1U);
  return proxy.records[0];
}

TEST(Proxy, StopsEveryRayAtAWallBesideItsDoor) {
  Scene scene = empty_scene();
  const auto add = [&](const Vec3& low, const Vec3& high) {
    add_triangle(scene, low, {high.x, low.y, 0.0F}, high);
    add_triangle(scene, low, high, {low.x, high.y, 0.0F});
  };
  // The door: 0.1..0.5 by -1..0.3, on no border of the squares.
  add({-1.0F, -1.0F, 0.0F}, {0.1F, 1.0F, 0.0F});
  add({0.5F, -1.0F, 0.0F}, {1.0F, 1.0F, 0.0F});
  add({0.1F, 0.3F, 0.0F}, {0.5F, 1.0F, 0.0F});

  const ProxyRecord record = only_record(scene);

  EXPECT_EQ(record.coverage[0], 255);
  const double open = 1.0 - std::popcount(record_mask(record)) / 64.0;
  EXPECT_NEAR(open, 0.4 * 1.3 / 4.0, 1.5 / 64.0);
  const FlatAxes axes = flat_axes(record_normal(record));
  for (const auto& [x, y, wall] : {std::tuple{0.3F, -0.5F, false}, std::tuple{-0.5F, -0.5F, true},
                                   std::tuple{0.9F, 0.9F, true}, std::tuple{0.3F, 0.9F, true}}) {
    const Vec3 place = (Vec3(x, y, 0.0F) + 1.0F) * 4.0F;
    const unsigned bit =
        flat_bit(static_cast<unsigned>(place[axes.u]), static_cast<unsigned>(place[axes.v]));
    EXPECT_EQ((record_mask(record) >> bit & 1U) != 0, wall) << x << " " << y;
  }
}

TEST(Proxy, LetsAShareOfTheRaysThroughAGrating) {
  for (const float share : {0.3F, 0.6F}) {
    Scene scene = empty_scene();
    add_bars(scene, /*bars=*/7, share);

    const ProxyRecord record = only_record(scene);

    // The bounds end with the last bar.
    const double covered = 7.0 * static_cast<double>(share) / (6.0 + static_cast<double>(share));
    EXPECT_NEAR(record.coverage[0] / 255.0 * std::popcount(record_mask(record)) / 64.0, covered,
                0.1);
  }
}

// The share of the bounds' face that a scattered record's blocks cover, seen straight along the
// axis.
double shadow(const ProxyRecord& record, int axis) {
  const std::uint64_t mask = record_mask(record);
  const double stopped = record.coverage[static_cast<std::size_t>(axis)] / 255.0;
  const std::array<unsigned, 3> stride{block_bit(1, 0, 0), block_bit(0, 1, 0), block_bit(0, 0, 1)};
  const unsigned along = stride[static_cast<std::size_t>(axis)];
  const unsigned u = stride[axis == 2 ? 0U : static_cast<std::size_t>(axis) + 1];
  const unsigned v = stride[axis == 0 ? 2U : static_cast<std::size_t>(axis) - 1];
  double sum = 0.0;
  for (unsigned column = 0; column < 16; ++column) {
    double passing = 1.0;
    for (unsigned step = 0; step < 4; ++step) {
      const unsigned bit = column % 4 * u + column / 4 * v + step * along;
      if ((mask >> bit & 1U) != 0) { passing *= 1.0 - stopped; }
    }
    sum += (1.0 - passing) / 16.0;
  }
  return sum;
}

TEST(Proxy, CountsLayersOnceAndHolesNot) {
  // A cross of three sheets, one of them in two layers, each over three quarters of its square.
  Scene scene = empty_scene();
  for (int axis = 0; axis < 3; ++axis) {
    for (const float height : {0.0F, 0.01F}) {
      if (axis > 0 && height > 0.0F) { continue; }
      const auto corner = [&](float u, float v) {
        Vec3 point(0.0F);
        point[axis] = height;
        const int next = axis == 2 ? 0 : axis + 1;
        point[next] = u;
        point[3 - axis - next] = v;
        return point;
      };
      for (const Vec3& square : {Vec3(-1, -1, 0), Vec3(0, -1, 0), Vec3(-1, 0, 0)}) {
        const float u = square.x;
        const float v = square.y;
        add_triangle(scene, corner(u, v), corner(u + 1, v), corner(u + 1, v + 1));
        add_triangle(scene, corner(u, v), corner(u + 1, v + 1), corner(u, v + 1));
      }
    }
  }

  const ProxyRecord record = only_record(scene);

  EXPECT_EQ(record.shape & kShapeFlat, 0);
  for (int axis = 0; axis < 3; ++axis) { EXPECT_NEAR(shadow(record, axis), 0.75, 0.04); }
}

TEST(Proxy, NamesWhatEachSideOfAPlaneShowsMostOf) {
  Scene scene = empty_scene();
  scene.materials.resize(5);
  const auto add_square = [&](float side, float height, std::uint32_t material) {
    add_triangle(scene, {-side, -side, height}, {side, -side, height}, {side, side, height},
                 material);
    add_triangle(scene, {-side, -side, height}, {side, side, height}, {-side, side, height},
                 material);
  };
  add_square(0.4F, 0.003F, 3);
  add_square(1.0F, 0.002F, 4);
  add_square(0.9F, 0.001F, 2);
  add_square(0.5F, 0.0F, 1);

  const Proxy proxy = build_in_one_voxel(scene);

  ASSERT_EQ(proxy.records.size(), 1U);
  const ProxyRecord& record = proxy.records[0];
  EXPECT_EQ(record.shape, kShapeFlat | kShapeOriented);
  EXPECT_GT(record_normal(record).z, 0.999F);
  EXPECT_EQ(proxy.materials[record.material_major], 4U);
  EXPECT_EQ(proxy.materials[record.material_minor], 2U);
}

TEST(Proxy, LeavesTheBlocksOfAScatteredLeafFreeThatHoldNothing) {
  Scene scene = empty_scene();
  SoupRandom random(1);
  for (const float corner : {-0.95F, 0.75F}) {
    for (int i = 0; i < 4; ++i) {
      const auto point = [&] { return random.in_cube(corner, corner + 0.2F); };
      const Vec3 a = point();
      const Vec3 b = point();
      add_triangle(scene, a, b, point());
    }
  }

  const Proxy proxy = build_in_one_voxel(scene);

  ASSERT_EQ(proxy.records.size(), 1U);
  EXPECT_EQ(proxy.records[0].shape & kShapeFlat, 0);
  EXPECT_EQ(record_mask(proxy.records[0]),
            std::uint64_t{1} << block_bit(0, 0, 0) | std::uint64_t{1} << block_bit(3, 3, 3));
}

// A square of material 1 at the bottom of the cell and a heap of triangles of material 2 above it.
TEST(Proxy, KnowsWhatASideOfAScatteredLeafShowsAndHowRoundItIs) {
  const std::uint32_t seed = 7;
  SCOPED_TRACE(seed);
  Scene scene = empty_scene();
  scene.materials.resize(3);
  add_triangle(scene, {-1.0F, -1.0F, -1.0F}, {1.0F, -1.0F, -1.0F}, {1.0F, 1.0F, -1.0F}, 1);
  add_triangle(scene, {-1.0F, -1.0F, -1.0F}, {1.0F, 1.0F, -1.0F}, {-1.0F, 1.0F, -1.0F}, 1);
  SoupRandom random(seed);
  for (int i = 0; i < 40; ++i) {
    const auto point = [&] { return random.in_cube(-0.9F, 0.95F); };
    const Vec3 a = point();
    const Vec3 b = point();
    add_triangle(scene, a, b, point(), 2);
  }

  const Proxy proxy = build_in_one_voxel(scene);

  ASSERT_EQ(proxy.records.size(), 1U);
  const ProxyRecord& record = proxy.records[0];
  ASSERT_EQ(record.shape & kShapeFlat, 0);
  const bool square_is_minor = proxy.materials[record.material_minor] == 1;
  ASSERT_EQ(proxy.materials[square_is_minor ? record.material_major : record.material_minor], 2U);
  const auto square_share = [&](bool from_low_side) {
    const float share = record_minor_share(record, 2, from_low_side);
    return square_is_minor ? share : 1.0F - share;
  };
  EXPECT_EQ(square_share(/*from_low_side=*/true), 1.0F);
  EXPECT_LT(square_share(/*from_low_side=*/false), 0.6F);
  EXPECT_EQ(record_roundness(record, square_is_minor), 0.0F);
  EXPECT_GT(record_roundness(record, !square_is_minor), 0.6F);
}

TEST(Proxy, HoldsEveryPointOfTheGeometryInALeaf) {
  const std::uint32_t seed = 3;
  SCOPED_TRACE(seed);
  const Scene scene = test::soup(3000, 0.05F, seed);
  const Built built = build(scene, 300);
  SoupRandom random(seed);

  for (int i = 0; i < 20000; ++i) {
    const Triangle& triangle =
        scene.triangles[random.below(static_cast<std::uint32_t>(scene.triangles.size()))];
    const float u = random.in(0.0F, 1.0F);
    const float v = random.in(0.0F, 1.0F - u);
    const Vec3& corner = scene.positions[triangle.vertices[0]];
    const Vec3 area = glm::cross(scene.positions[triangle.vertices[1]] - corner,
                                 scene.positions[triangle.vertices[2]] - corner);
    if (glm::length(area) < 1e-6F) { continue; }  // rounding may leave nothing of a sliver
    const Vec3 point = scene.positions[triangle.vertices[0]] * (1.0F - u - v) +
                       scene.positions[triangle.vertices[1]] * u +
                       scene.positions[triangle.vertices[2]] * v;
    const auto holds = [&](const ProxyNode& node) {
      for (int axis = 0; axis < 3; ++axis) {
        if (point[axis] < node.bounds.low[axis] - kVoxelMargin ||
            point[axis] > node.bounds.high[axis] + kVoxelMargin) {
          return false;
        }
      }
      return true;
    };
    bool is_held = false;
    std::vector<std::uint32_t> pending(built.proxy.roots);
    while (!pending.empty() && !is_held) {
      const ProxyNode& node = built.proxy.nodes[pending.back()];
      pending.pop_back();
      if (!holds(node)) { continue; }
      is_held = node.child_mask == 0;
      for (unsigned child = 0; child < static_cast<unsigned>(std::popcount(node.child_mask));
           ++child) {
        pending.push_back(node.first + child);
      }
    }
    ASSERT_TRUE(is_held) << point.x << " " << point.y << " " << point.z;
  }
}

TEST(Proxy, StaysWithinATenthOfTheBlocks) {
  for (const std::size_t triangle_count : {1000U, 10000U}) {
    const Scene scene = test::soup(triangle_count, 0.01F, /*seed=*/1);
    const Built built = build(scene, 500);

    const std::uint64_t stored =
        block_bytes(scene, built) + built.voxel_roots.size() * sizeof(VoxelEntry);

    const std::size_t proxy_bytes = encode_proxy(built.proxy).size();
    EXPECT_LE(proxy_bytes * 10, stored + proxy_bytes);
    EXPECT_GT(built.proxy.records.size(), built.voxel_roots.size());
  }
}

// Of so many voxels a few are split further than the others, to learn where the budget ends.
TEST(Proxy, UsesUpItsBudgetWhereItSplitsMostVoxelsNoFurtherThanThat) {
  const Scene scene = test::soup(20000, 0.01F, /*seed=*/4);
  const Built built = build(scene, 60);
  ASSERT_GT(built.voxel_roots.size(), 600U);

  const std::uint64_t stored =
      block_bytes(scene, built) + built.voxel_roots.size() * sizeof(VoxelEntry);

  const auto proxy_bytes = static_cast<double>(encode_proxy(built.proxy).size());
  EXPECT_GT(proxy_bytes, 0.1 * static_cast<double>(stored));
}

TEST(Proxy, HasTheSameBytesOnOneThreadAndOnMany) {
  const Scene scene = test::soup(5000, 0.05F, /*seed=*/5);
  const std::vector<std::byte> on_all = encode_proxy(build(scene, 300).proxy);

  std::vector<std::byte> on_one;
  tbb::task_arena(1).execute([&] { on_one = encode_proxy(build(scene, 300).proxy); });

  EXPECT_EQ(on_one, on_all);
}

TEST(Proxy, SurvivesEncodingAndDecoding) {
  const Built built = build(test::soup(2000, 0.05F, /*seed=*/2), 200);
  const std::vector<std::byte> bytes = encode_proxy(built.proxy);

  const Result<Proxy> decoded = decode_proxy(bytes, built.voxel_roots.size());

  ASSERT_TRUE(decoded.has_value()) << decoded.error().message;
  EXPECT_EQ(encode_proxy(*decoded), bytes);
  ASSERT_EQ(decoded->nodes.size(), built.proxy.nodes.size());
  for (std::size_t node = 0; node < decoded->nodes.size(); ++node) {
    EXPECT_EQ(decoded->nodes[node].bounds.low, built.proxy.nodes[node].bounds.low);
    EXPECT_EQ(decoded->nodes[node].bounds.high, built.proxy.nodes[node].bounds.high);
  }
}

TEST(Proxy, ExistsForAnEmptyScene) {
  const Proxy proxy = build_proxy(empty_scene(), Octree{}, {});

  const Result<Proxy> decoded = decode_proxy(encode_proxy(proxy), 0);

  ASSERT_TRUE(decoded.has_value());
  EXPECT_TRUE(decoded->records.empty());
}

// What walks a proxy relies on.
void expect_sound(const Proxy& proxy) {
  for (const std::uint32_t root : proxy.roots) { ASSERT_LT(root, proxy.nodes.size()); }
  for (std::size_t at = 0; at < proxy.nodes.size(); ++at) {
    const ProxyNode& node = proxy.nodes[at];
    if (node.child_mask == 0) {
      ASSERT_LT(node.first, proxy.records.size());
      ASSERT_LT(proxy.records[node.first].material_major, proxy.materials.size());
      ASSERT_LT(proxy.records[node.first].material_minor, proxy.materials.size());
    } else {
      ASSERT_GT(node.first, at);
      ASSERT_LE(node.first + static_cast<unsigned>(std::popcount(node.child_mask)),
                proxy.nodes.size());
    }
    ASSERT_FALSE(node.bounds.is_empty());
  }
}

TEST(Proxy, RefusesOrSurvivesDamagedBytes) {
  const Built built = build(test::soup(300, 0.1F, /*seed=*/4), 100);
  const std::vector<std::byte> bytes = encode_proxy(built.proxy);
  const std::size_t voxel_count = built.voxel_roots.size();

  for (std::size_t length = 0; length < bytes.size(); ++length) {
    const Result<Proxy> decoded = decode_proxy(std::span(bytes).first(length), voxel_count);
    ASSERT_FALSE(decoded.has_value());
    ASSERT_EQ(decoded.error().code, ExitCode::kStoreDamaged);
  }
  std::size_t refused = 0;
  for (std::size_t at = 0; at < bytes.size(); ++at) {
    for (const unsigned flip : {0x01U, 0x80U, 0xFFU}) {
      std::vector<std::byte> damaged = bytes;
      damaged[at] ^= static_cast<std::byte>(flip);
      const Result<Proxy> decoded = decode_proxy(damaged, voxel_count);
      if (decoded) { expect_sound(*decoded); }
      if (!decoded) { ++refused; }
    }
  }
  EXPECT_GT(refused, 100U);
  EXPECT_FALSE(decode_proxy(bytes, voxel_count + 1).has_value());
}

}  // namespace
}  // namespace preheat
