#include "common/voxel_block.h"

#include <gtest/gtest.h>

#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <numbers>
#include <numeric>

#include "common/flat_index.h"
#include "common/triangle_order.h"
#include "tests/scenes/soups.h"

namespace preheat {
namespace {

using test::SoupRandom;

std::vector<std::uint32_t> all_triangles(const Scene& scene) {
  std::vector<std::uint32_t> ids(scene.triangles.size());
  std::iota(ids.begin(), ids.end(), 0U);
  return ids;
}

// Overwrites a number in the block.
template <class T>
std::vector<std::byte> with_number(std::vector<std::byte> bytes, std::size_t offset, T value) {
  std::memcpy(bytes.data() + offset, &value, sizeof(value));
  return bytes;
}

TEST(VoxelBlock, GivesBackTheTrianglesOfTheScene) {
  Scene scene = test::sheet(9);
  scene.materials.resize(3);
  for (std::size_t i = 0; i < scene.triangles.size(); ++i) {
    scene.triangles[i].material = static_cast<std::uint32_t>(i % 3);
  }
  const std::vector<std::uint32_t> ids{3, 4, 17, 18, 90, 161};

  const std::vector<std::byte> bytes = encode_voxel_block(scene, ids);
  const Result<VoxelBlockView> view = view_voxel_block(bytes, 3);

  ASSERT_TRUE(view) << view.error().message;
  ASSERT_EQ(view->triangles.size(), ids.size());
  EXPECT_LT(view->positions.size(), 9 * ids.size());  // vertices are shared
  EXPECT_EQ(view->normals.size() * 3, view->positions.size());
  EXPECT_EQ(bytes.size(), voxel_block_bytes(view->normals.size(), ids.size(), true));
  const std::vector<std::uint32_t> order = order_for_tree(scene, ids);
  for (std::size_t i = 0; i < ids.size(); ++i) {
    EXPECT_EQ(view->triangles[i], order[i]);
    EXPECT_EQ(view->materials[i], scene.triangles[order[i]].material);
    for (std::size_t corner = 0; corner < 3; ++corner) {
      const std::uint32_t vertex = scene.triangles[order[i]].vertices[corner];
      const std::size_t local = view->indices[3 * i + corner];
      for (std::size_t axis = 0; axis < 3; ++axis) {
        EXPECT_EQ(view->positions[3 * local + axis],
                  scene.positions[vertex][static_cast<int>(axis)]);
      }
      EXPECT_EQ(decode_normal(view->normals[local]), scene.normals[vertex]);
    }
  }
}

TEST(VoxelBlock, CountsVerticesWith16BitsAsLongAsTheySuffice) {
  for (const unsigned side : {254U, 255U, 256U, 300U}) {
    const Scene scene = test::sheet(side);

    const std::vector<std::byte> bytes = encode_voxel_block(scene, all_triangles(scene));
    const Result<VoxelBlockView> view = view_voxel_block(bytes, 1);

    ASSERT_TRUE(view) << view.error().message;
    const std::size_t vertices = view->positions.size() / 3;
    ASSERT_EQ(vertices, scene.positions.size());
    EXPECT_EQ(view->indices.is_narrow(), vertices <= 65536) << vertices;
    EXPECT_EQ(bytes.size(), voxel_block_bytes(vertices, view->triangles.size(), true));
    for (std::size_t i = 0; i < view->indices.size(); ++i) {
      const std::uint32_t vertex = scene.triangles[view->triangles[i / 3]].vertices[i % 3];
      const std::size_t local = view->indices[i];
      ASSERT_EQ(view->positions[3 * local], scene.positions[vertex].x);
      ASSERT_EQ(view->positions[3 * local + 1], scene.positions[vertex].y);
    }
  }
}

TEST(VoxelBlock, LeavesNormalsOutWhereThereAreNone) {
  const Scene scene = test::soup(20, 0.1F, 1);

  const std::vector<std::byte> bytes = encode_voxel_block(scene, all_triangles(scene));
  const Result<VoxelBlockView> view = view_voxel_block(bytes, 1);

  ASSERT_TRUE(view) << view.error().message;
  EXPECT_TRUE(view->normals.empty());
  EXPECT_EQ(bytes.size(), voxel_block_bytes(60, 20, false));
}

TEST(VoxelBlock, KeepsSixteenBytesReadableAtEveryVertex) {
  for (std::size_t vertices = 0; vertices < 20; ++vertices) {
    const std::size_t positions_bytes =
        voxel_block_bytes(vertices, 0, false) - voxel_block_bytes(0, 0, false) + 16;
    EXPECT_GE(positions_bytes, 12 * vertices + 4);
    EXPECT_EQ(positions_bytes % 16, 0U);
  }
}

TEST(VoxelBlock, OfNoTrianglesIsEmpty) {
  const std::vector<std::byte> bytes = encode_voxel_block(test::empty_scene(), {});
  const Result<VoxelBlockView> view = view_voxel_block(bytes, 1);

  ASSERT_TRUE(view) << view.error().message;
  EXPECT_TRUE(view->triangles.empty());
  EXPECT_TRUE(view->positions.empty());
}

TEST(VoxelBlock, OfAnyOtherLengthIsRefused) {
  const Scene scene = test::sheet(3);
  const std::vector<std::byte> bytes = encode_voxel_block(scene, all_triangles(scene));
  for (std::size_t length = 0; length < bytes.size(); ++length) {
    EXPECT_FALSE(view_voxel_block(std::span(bytes).first(length), 1)) << length;
  }
  std::vector<std::byte> longer = bytes;
  longer.resize(bytes.size() + 16);
  EXPECT_FALSE(view_voxel_block(longer, 1));
}

TEST(VoxelBlock, WithLyingContentIsRefused) {
  const Scene scene = test::sheet(3);
  const std::vector<std::byte> bytes = encode_voxel_block(scene, all_triangles(scene));
  const Result<VoxelBlockView> view = view_voxel_block(bytes, 1);
  ASSERT_TRUE(view);
  const auto offset_of = [&](const auto* place) {
    return static_cast<std::size_t>(std::bit_cast<const std::byte*>(place) - bytes.data());
  };
  const std::size_t vertex_count = view->normals.size();
  constexpr std::uint32_t kHuge = 0xFFFFFFFF;

  const std::size_t sixth_index = offset_of(view->indices.data()) + 5 * sizeof(std::uint16_t);
  const auto with_index = [&](std::size_t vertex) {
    return with_number(bytes, sixth_index, static_cast<std::uint16_t>(vertex));
  };
  EXPECT_TRUE(view_voxel_block(with_index(vertex_count - 1), 1));
  EXPECT_FALSE(view_voxel_block(with_index(vertex_count), 1));
  const std::uint16_t no_material = 1;
  EXPECT_FALSE(
      view_voxel_block(with_number(bytes, offset_of(&view->materials[2]), no_material), 1));
  for (const float bad :
       {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity()}) {
    EXPECT_FALSE(view_voxel_block(with_number(bytes, offset_of(&view->positions[7]), bad), 1));
  }
  for (const std::size_t header_word : {0U, 4U, 8U, 12U}) {
    EXPECT_FALSE(view_voxel_block(with_number(bytes, header_word, kHuge), 1)) << header_word;
  }
}

TEST(NormalCode, OfNoNormalIsZero) {
  EXPECT_EQ(encode_normal(Vec3(0.0F)), 0U);
  EXPECT_EQ(encode_normal(Vec3(std::numeric_limits<float>::quiet_NaN())), 0U);
  EXPECT_EQ(encode_normal(Vec3(std::numeric_limits<float>::infinity(), 0, 0)), 0U);
}

TEST(NormalCode, KeepsAxesAndSignsExactly) {
  for (int axis = 0; axis < 3; ++axis) {
    for (const float sign : {-1.0F, 1.0F}) {
      Vec3 unit(0.0F);
      unit[axis] = sign;
      EXPECT_EQ(decode_normal(encode_normal(unit)), unit);
    }
  }
}

TEST(NormalCode, ErrsByLessThanFourThousandthsOfADegree) {
  constexpr std::uint32_t kSeed = 31;
  SCOPED_TRACE(kSeed);
  SoupRandom random(kSeed);
  double worst_degrees = 0.0;
  for (int i = 0; i < 300'000; ++i) {
    Vec3d wanted(random.in_cube(-1.0F, 1.0F));
    if (i % 4 == 0) { wanted[i / 4 % 3] *= 1e-4; }  // near the octahedron's edges
    if (glm::dot(wanted, wanted) < 1e-3) { continue; }
    const Vec3 unit(glm::normalize(wanted));
    const std::uint32_t code = encode_normal(unit);
    ASSERT_NE(code, 0U);
    const Vec3d off = Vec3d(decode_normal(code)) - glm::normalize(Vec3d(unit));
    worst_degrees = std::max(worst_degrees, glm::length(off) * 180.0 / std::numbers::pi);
  }
  EXPECT_LT(worst_degrees, 0.004);
  EXPECT_GT(worst_degrees, 0.001);  // the generator reaches the hard places
}

TEST(NormalCode, OfAnyBitsDecodesToAUnitVector) {
  SoupRandom random(8);
  for (int i = 0; i < 100'000; ++i) {
    const std::uint32_t code = random.below(0xFFFF) << 16U | random.below(0xFFFF);
    EXPECT_NEAR(glm::length(decode_normal(code)), 1.0F, 1e-6F);
  }
  EXPECT_NEAR(glm::length(decode_normal(0)), 1.0F, 1e-6F);
}

TEST(FlatIndex, NumbersKeysInOrderOfAppearance) {
  FlatIndex index(1);
  SoupRandom random(4);
  std::vector<std::uint32_t> keys;
  for (std::uint32_t i = 0; i < 5000; ++i) {
    const std::uint32_t key = i % 2 == 0 ? i : 0xFFFFFFFF - i * 64;
    EXPECT_EQ(index.number_of(key), keys.size());
    keys.push_back(key);
    const std::uint32_t known = random.below(static_cast<std::uint32_t>(keys.size()));
    EXPECT_EQ(index.number_of(keys[known]), known);
  }
  EXPECT_EQ(index.size(), keys.size());
}

}  // namespace
}  // namespace preheat
