#include "master/compiler.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <set>

#include "common/scene_tables_codec.h"
#include "common/sha256.h"
#include "common/store.h"
#include "common/voxel_block.h"
#include "tests/scenes/scratch_folder.h"
#include "tests/scenes/soups.h"

namespace preheat {
namespace {

using test::ScratchFolder;
using testing::HasSubstr;

constexpr Hash128 kSource{.low = 5, .high = 6};

Result<Store> compile_and_open(const Scene& scene, const std::filesystem::path& file,
                               const CompileOptions& options = {}) {
  if (const Result<void> done = compile_scene(scene, "scene.gltf", kSource, options, file); !done) {
    return tl::unexpected(done.error());
  }
  return Store::open(file);
}

TEST(Compiler, StoresEveryTriangleInItsVoxels) {
  const ScratchFolder folder;
  const Scene scene = test::soup(3000, 0.05F, 9);

  const Result<Store> store = compile_and_open(scene, folder / "a.store");

  ASSERT_TRUE(store) << store.error().message;
  const SceneTables& tables = store->tables();
  EXPECT_EQ(tables.triangle_count, scene.triangles.size());
  ASSERT_GT(tables.voxels.size(), 20U);
  std::set<std::uint32_t> stored;
  for (std::uint32_t voxel = 0; voxel < tables.voxels.size(); ++voxel) {
    ASSERT_TRUE(store->block_is_intact(VoxelId{voxel}));
    const Result<VoxelBlockView> view =
        view_voxel_block(store->block(VoxelId{voxel}), tables.materials.size());
    ASSERT_TRUE(view) << view.error().message;
    EXPECT_EQ(view->triangles.size(), tables.voxels[voxel].triangle_count);
    EXPECT_EQ(tables.voxels[voxel].resident_bytes,
              tables.voxels[voxel].block_bytes + bvh_bytes_bound(view->triangles.size()));
    stored.insert(view->triangles.begin(), view->triangles.end());
  }
  EXPECT_EQ(stored.size(), scene.triangles.size());
  EXPECT_EQ(store->info().source_file, "scene.gltf");
  EXPECT_EQ(store->info().source_hash, kSource);
}

TEST(Compiler, WritesTheSameBytesOnAnyNumberOfThreads) {
  const ScratchFolder folder;
  const Scene scene = test::sheet(200);
  ASSERT_TRUE(compile_and_open(scene, folder / "one.store", {.threads = 1}));
  const std::string one = test::read_file(folder / "one.store");
  for (const unsigned threads : {2U, 5U, 0U}) {
    ASSERT_TRUE(compile_and_open(scene, folder / "many.store", {.threads = threads}));
    EXPECT_TRUE(one == test::read_file(folder / "many.store")) << threads << " threads";
  }
}

// The store of a small scene, as a hash of its bytes: it may change with the store's version only,
// never with the compiler, its options, sanitizers or the machine.
TEST(Compiler, WritesTheSameBytesInEveryBuild) {
  const ScratchFolder folder;
  ASSERT_TRUE(compile_and_open(test::soup(2000, 0.05F, 9), folder / "a.store"));

  const std::string bytes = test::read_file(folder / "a.store");

  EXPECT_EQ(sha256_hex({reinterpret_cast<const std::byte*>(bytes.data()), bytes.size()}),
            "f37e26e6d1643ef2838dceaeca5d417fbf9ac850ba18634c4d6433fa3dd07f0c");
}

TEST(Compiler, OfAnEmptySceneHasNoVoxels) {
  const ScratchFolder folder;
  const Result<Store> store = compile_and_open(test::empty_scene(), folder / "a.store");
  ASSERT_TRUE(store) << store.error().message;
  EXPECT_TRUE(store->tables().voxels.empty());
  EXPECT_TRUE(store->tables().voxel_nodes.empty());
  EXPECT_EQ(store->tables().resident_bytes(), 0U);
}

// Scenes that are a triangle, a plane, a point, a sliver.
TEST(Compiler, TakesScenesWithoutExtent) {
  const ScratchFolder folder;
  Scene one = test::empty_scene();
  test::add_triangle(one, {0, 0, 0}, {1, 0, 0}, {0, 1, 0});
  Scene plane = test::empty_scene();
  for (int i = 0; i < 300; ++i) {
    const float x = static_cast<float>(i) / 300.0F;
    test::add_triangle(plane, {x, 0.25F, 0}, {x + 0.01F, 0.25F, 0}, {x, 0.25F, 1});
  }
  Scene point = test::empty_scene();
  for (int i = 0; i < 300; ++i) { test::add_triangle(point, Vec3(0.3F), Vec3(0.3F), Vec3(0.3F)); }
  Scene sliver = test::empty_scene();
  test::add_triangle(sliver, {-1, 0, 0}, {1, 0, 0}, {1, 1e-7F, 0});
  for (const Scene* scene : {&one, &plane, &point, &sliver}) {
    const Result<Store> store = compile_and_open(*scene, folder / "a.store");
    ASSERT_TRUE(store) << store.error().message;
    EXPECT_GE(store->tables().voxels.size(), 1U);
    for (const VoxelEntry& voxel : store->tables().voxels) {
      EXPECT_FALSE(voxel.bounds.is_empty());
    }
  }
}

// Coincident and spanning triangles may not blow the store up.
TEST(Compiler, BoundsTheStoreOfHostileScenes) {
  const ScratchFolder folder;
  Scene coincident = test::empty_scene();
  test::add_triangle(coincident, {-1, -1, -1}, {1, -0.5F, 1}, {0, 1, 0.5F});
  coincident.triangles.resize(100'000, coincident.triangles[0]);
  Scene spanning = test::empty_scene();
  test::SoupRandom random(3);
  for (int i = 0; i < 10'000; ++i) {
    test::add_triangle(spanning, {-1, random.in(-1, 1), -1}, {1, random.in(-1, 1), -1},
                       {0, random.in(-1, 1), 1});
  }
  for (const Scene* scene : {&coincident, &spanning}) {
    const Result<Store> store = compile_and_open(*scene, folder / "a.store");
    ASSERT_TRUE(store) << store.error().message;
    const std::uint64_t once =
        voxel_block_bytes(3 * scene->triangles.size(), scene->triangles.size(), false);
    EXPECT_LE(store->file_bytes(), 8 * once + (1U << 16U));
  }
}

TEST(Compiler, ListsEmissiveTrianglesById) {
  const ScratchFolder folder;
  Scene scene = test::sheet(4);
  scene.materials.resize(3);
  scene.materials[2].emission = Vec3(0, 3, 0);
  scene.triangles[7].material = 2;
  scene.triangles[3].material = 2;
  scene.triangles[5].material = 1;

  const Result<Store> store = compile_and_open(scene, folder / "a.store");

  ASSERT_TRUE(store);
  const std::vector<EmissiveTriangle>& emissive = store->tables().emissive_triangles;
  ASSERT_EQ(emissive.size(), 2U);
  EXPECT_EQ(emissive[0].triangle, 3U);
  EXPECT_EQ(emissive[1].triangle, 7U);
  EXPECT_EQ(emissive[1].material, 2U);
  EXPECT_EQ(emissive[1].vertices[2], scene.positions[scene.triangles[7].vertices[2]]);
}

TEST(Compiler, KeepsCamerasLightsFrameAndImportReport) {
  const ScratchFolder folder;
  Scene scene = test::sheet(2);
  scene.frame = {.centre = {1e6, 0, 0}, .scale_exponent = 3};
  scene.cameras = {{.name = "main", .position_file = {1, 2, 3}}};
  scene.lights = {{.kind = PunctualLightKind::kDirectional, .intensity = Vec3(2.0F)}};
  scene.import = {.triangles_declared = 9, .triangles_zero_area = 1, .notes = {"no textures"}};

  const Result<Store> store = compile_and_open(scene, folder / "a.store");

  ASSERT_TRUE(store);
  EXPECT_EQ(store->tables().frame.centre.x, 1e6);
  EXPECT_EQ(store->tables().lights[0].intensity, Vec3(2.0F));
  EXPECT_EQ(store->cameras()[0].position_file, Vec3d(1, 2, 3));
  EXPECT_EQ(store->info().import.triangles_zero_area, 1U);
  EXPECT_EQ(store->info().import.notes, std::vector<std::string>{"no textures"});
}

TEST(Compiler, HonoursTheVoxelSize) {
  const ScratchFolder folder;
  const Scene scene = test::sheet(100);
  std::size_t voxels_before = 0;
  for (const std::uint64_t size : {1U << 20U, 1U << 16U, 1U << 13U}) {
    const Result<Store> store =
        compile_and_open(scene, folder / "a.store", {.voxel_size_bytes = size});
    ASSERT_TRUE(store);
    for (const VoxelEntry& voxel : store->tables().voxels) { EXPECT_LE(voxel.block_bytes, size); }
    EXPECT_GT(store->tables().voxels.size(), voxels_before);
    EXPECT_EQ(store->info().voxel_size_bytes, size);
    voxels_before = store->tables().voxels.size();
  }
}

TEST(Compiler, CutsNamesThatNobodyReads) {
  const ScratchFolder folder;
  Scene scene = test::sheet(2);
  scene.materials[0].name = std::string(100'000, 'm');
  scene.cameras = {{.name = std::string(100'000, 'c')}};
  scene.import.notes = {std::string(100'000, 'n')};
  const Result<Store> store = compile_and_open(scene, folder / "a.store");
  ASSERT_TRUE(store) << store.error().message;
  EXPECT_EQ(store->tables().materials[0].name, std::string(kNameBytesMax, 'm'));

  scene.materials[0].name = "m";
  for (int i = 0; i < 3000; ++i) { scene.materials[0].name += "\u00e9"; }  // two bytes each
  const Result<Store> again = compile_and_open(scene, folder / "b.store");
  ASSERT_TRUE(again);
  EXPECT_EQ(again->tables().materials[0].name.size(), kNameBytesMax - 1);
}

TEST(Compiler, RejectsWhatAStoreCannotHoldAndLeavesNoFile) {
  const ScratchFolder folder;
  Scene no_material = test::sheet(2);
  no_material.materials.clear();
  Scene negative = test::sheet(2);
  negative.materials[0].emission.x = -1.0F;
  Scene dense = test::empty_scene();
  test::add_triangle(dense, {-1, -1, -1}, {1, -0.5F, 1}, {0, 1, 0.5F});
  dense.triangles.resize(6'000'000, dense.triangles[0]);
  for (const Scene* scene : {&no_material, &negative, &dense}) {
    const Result<Store> store = compile_and_open(*scene, folder / "a.store");
    ASSERT_FALSE(store);
    EXPECT_EQ(store.error().code, ExitCode::kSceneRejected) << store.error().message;
    EXPECT_EQ(folder.file_count(), 0U);
  }
}

TEST(Compiler, SaysThatTheFileCannotBeWritten) {
  const Result<Store> store = compile_and_open(test::sheet(2), "/no/such/folder/a.store");
  ASSERT_FALSE(store);
  EXPECT_EQ(store.error().code, ExitCode::kOutputUnwritable);
  EXPECT_THAT(store.error().message, HasSubstr("/no/such/folder/a.store"));
}

}  // namespace
}  // namespace preheat
