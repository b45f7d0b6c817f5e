#include "common/scene_tables_codec.h"

#include <gtest/gtest.h>

#include <cstring>
#include <functional>
#include <limits>

namespace preheat {
namespace {

VoxelEntry voxel(float low, std::uint64_t offset) {
  return {.bounds = {Vec3(low), Vec3(low + 0.5F)},
          .block_offset = offset,
          .block_bytes = 96,
          .triangle_count = 2,
          .resident_bytes = 500,
          .hash = {.low = offset + 1, .high = 77}};
}

// Three voxels under two inner nodes.
SceneTables example() {
  SceneTables tables;
  tables.frame = {.centre = {1e6, -2.5, 3.0}, .scale_exponent = -7};
  tables.triangle_count = 10;
  tables.materials = {{.name = "grey"}, {.name = "lamp", .emission = Vec3(17, 12, 4)}};
  tables.lights = {{.kind = PunctualLightKind::kSpot, .intensity = Vec3(3.0F)}};
  tables.emissive_triangles = {{.triangle = 4, .material = 1}, {.triangle = 9, .material = 1}};
  tables.voxels = {voxel(-1.0F, 0), voxel(-0.5F, 96), voxel(0.5F, 208)};
  const Aabb all{Vec3(-1.0F), Vec3(1.0F)};
  const Aabb lower{Vec3(-1.0F), Vec3(0.0F)};
  tables.voxel_nodes = {{.bounds = all, .first = 1, .count = 2},
                        {.bounds = lower, .first = 3, .count = 2},
                        {.bounds = tables.voxels[2].bounds, .first = 2, .count = 0},
                        {.bounds = tables.voxels[0].bounds, .first = 0, .count = 0},
                        {.bounds = tables.voxels[1].bounds, .first = 1, .count = 0}};
  return tables;
}

TEST(SceneTablesCodec, GivesBackWhatWasEncoded) {
  const SceneTables tables = example();

  const std::vector<std::byte> bytes = encode_scene_tables(tables);
  const Result<SceneTables> decoded = decode_scene_tables(bytes);

  ASSERT_TRUE(decoded) << decoded.error().message;
  EXPECT_EQ(encode_scene_tables(*decoded), bytes);
  EXPECT_EQ(decoded->frame.centre, tables.frame.centre);
  EXPECT_EQ(decoded->materials[1].name, "lamp");
  EXPECT_EQ(decoded->materials[1].emission, Vec3(17, 12, 4));
  EXPECT_EQ(decoded->lights[0].kind, PunctualLightKind::kSpot);
  EXPECT_EQ(decoded->voxels[2].hash, tables.voxels[2].hash);
  EXPECT_EQ(decoded->voxel_nodes[1].first, 3U);
}

TEST(SceneTablesCodec, OfAnEmptySceneIsValid) {
  SceneTables tables;
  tables.materials.emplace_back();
  EXPECT_TRUE(decode_scene_tables(encode_scene_tables(tables)));
}

TEST(SceneTablesCodec, RefusesEveryTruncation) {
  const std::vector<std::byte> bytes = encode_scene_tables(example());
  for (std::size_t length = 0; length < bytes.size(); ++length) {
    EXPECT_FALSE(decode_scene_tables(std::span(bytes).first(length))) << length;
  }
}

// Whatever single byte is changed, decoding ends and what it returns is valid.
TEST(SceneTablesCodec, SurvivesEveryChangedByte) {
  const std::vector<std::byte> bytes = encode_scene_tables(example());
  std::size_t refused = 0;
  for (std::size_t at = 0; at < bytes.size(); ++at) {
    for (const unsigned change : {0x01U, 0x80U, 0xFFU}) {
      std::vector<std::byte> changed = bytes;
      changed[at] ^= static_cast<std::byte>(change);
      const Result<SceneTables> decoded = decode_scene_tables(changed);
      refused += !decoded;
      if (decoded) { EXPECT_TRUE(validate_scene_tables(*decoded)); }
    }
  }
  EXPECT_GT(refused, bytes.size() / 4);
}

struct LieCase {
  const char* name;
  std::function<void(SceneTables&)> tell;
};

class SceneTablesLie : public testing::TestWithParam<LieCase> {};

TEST_P(SceneTablesLie, IsRefused) {
  SceneTables tables = example();
  ASSERT_TRUE(validate_scene_tables(tables));
  GetParam().tell(tables);
  const Result<SceneTables> decoded = decode_scene_tables(encode_scene_tables(tables));
  ASSERT_FALSE(decoded);
  EXPECT_EQ(decoded.error().code, ExitCode::kStoreDamaged);
  EXPECT_TRUE(decoded.error().message.starts_with("scene tables: ")) << decoded.error().message;
}

INSTANTIATE_TEST_SUITE_P(
    SceneTablesCodec, SceneTablesLie,
    testing::Values(
        LieCase{"too_many_triangles",
                [](SceneTables& scene) { scene.triangle_count = 1ULL << 40U; }},
        LieCase{"scale_exponent", [](SceneTables& scene) { scene.frame.scale_exponent = 1 << 20; }},
        LieCase{"centre_infinite",
                [](SceneTables& scene) {
                  scene.frame.centre.x = std::numeric_limits<double>::infinity();
                }},
        LieCase{"no_material", [](SceneTables& scene) { scene.materials.clear(); }},
        LieCase{"negative_emission",
                [](SceneTables& scene) { scene.materials[1].emission.y = -1.0F; }},
        LieCase{"roughness_above_one",
                [](SceneTables& scene) { scene.materials[0].roughness = 1.5F; }},
        LieCase{"ior_below_one", [](SceneTables& scene) { scene.materials[0].ior = 0.5F; }},
        LieCase{"emissive_unsorted",
                [](SceneTables& scene) { scene.emissive_triangles[1].triangle = 4; }},
        LieCase{"emissive_out_of_range",
                [](SceneTables& scene) { scene.emissive_triangles[1].triangle = 10; }},
        LieCase{"emissive_material",
                [](SceneTables& scene) { scene.emissive_triangles[0].material = 2; }},
        LieCase{"empty_bounds", [](SceneTables& scene) { scene.voxels[1].bounds.low.x = 3.0F; }},
        LieCase{"blocks_overlap", [](SceneTables& scene) { scene.voxels[2].block_offset = 176; }},
        LieCase{"block_unaligned", [](SceneTables& scene) { scene.voxels[2].block_offset = 209; }},
        LieCase{"block_offset_overflows",
                [](SceneTables& scene) { scene.voxels[2].block_offset = ~std::uint64_t{15}; }},
        LieCase{"block_empty", [](SceneTables& scene) { scene.voxels[0].block_bytes = 0; }},
        LieCase{"block_huge", [](SceneTables& scene) { scene.voxels[2].block_bytes = 0xFFFFFFF0; }},
        LieCase{"resident_below_block",
                [](SceneTables& scene) { scene.voxels[0].resident_bytes = 95; }},
        LieCase{"more_triangles_than_scene",
                [](SceneTables& scene) { scene.voxels[0].triangle_count = 11; }},
        LieCase{"nodes_missing", [](SceneTables& scene) { scene.voxel_nodes.clear(); }},
        LieCase{"node_is_its_own_child",
                [](SceneTables& scene) { scene.voxel_nodes[0].first = 0; }},
        LieCase{"cycle", [](SceneTables& scene) { scene.voxel_nodes[1].first = 1; }},
        LieCase{"children_shared", [](SceneTables& scene) { scene.voxel_nodes[1].first = 2; }},
        LieCase{"children_beyond_end", [](SceneTables& scene) { scene.voxel_nodes[1].count = 3; }},
        LieCase{"children_overflow",
                [](SceneTables& scene) { scene.voxel_nodes[1].count = 0xFFFFFFFF; }},
        LieCase{"voxel_twice", [](SceneTables& scene) { scene.voxel_nodes[4].first = 0; }},
        LieCase{"voxel_out_of_range", [](SceneTables& scene) { scene.voxel_nodes[4].first = 3; }},
        LieCase{"voxel_without_node",
                [](SceneTables& scene) { scene.voxels.push_back(voxel(0.5F, 304)); }},
        LieCase{"node_without_parent",
                [](SceneTables& scene) {
                  scene.voxels.push_back(voxel(0.5F, 304));
                  scene.voxel_nodes.push_back({scene.voxels[3].bounds, 3, 0});
                }},
        LieCase{"node_bounds",
                [](SceneTables& scene) { scene.voxel_nodes[1].bounds.high.z = -0.1F; }},
        LieCase{"leaf_bounds",
                [](SceneTables& scene) { scene.voxel_nodes[2].bounds.low.y = 0.6F; }}),
    [](const auto& tested) { return tested.param.name; });

}  // namespace
}  // namespace preheat
