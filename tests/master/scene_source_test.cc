#include "master/scene_source.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <fstream>
#include <iterator>

namespace preheat {
namespace {

namespace fs = std::filesystem;

class SceneSource : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = (fs::temp_directory_path() / "preheat_source_XXXXXX").string();
    folder_ = ::mkdtemp(name.data());
    options_.store_cache = (folder_ / "cache").string();
    options_.scene = write_scene("room.obj", 0.0);
  }
  void TearDown() override { fs::remove_all(folder_); }

  std::string write_scene(const std::string& name, double x) {
    const fs::path file = folder_ / name;
    std::ofstream(file) << "v " << x << " 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n";
    return file.string();
  }
  [[nodiscard]] std::size_t stores_cached() const {
    const fs::path cache = options_.store_cache;
    if (!fs::exists(cache)) { return 0; }
    return static_cast<std::size_t>(
        std::distance(fs::directory_iterator(cache), fs::directory_iterator()));
  }

  fs::path folder_{};
  SceneOptions options_{};
};

TEST_F(SceneSource, TheSecondTimeNothingIsCompiled) {
  const auto first = open_scene(options_);
  ASSERT_TRUE(first.has_value()) << first.error().message;
  const auto second = open_scene(options_);
  ASSERT_TRUE(second.has_value());

  EXPECT_GT(first->compile_seconds, 0.0);
  EXPECT_EQ(second->compile_seconds, 0.0);
  EXPECT_EQ(stores_cached(), 1U);
  EXPECT_EQ(first->store.scene_hash(), second->store.scene_hash());
  EXPECT_EQ(first->store.tables().triangle_count, 2U);
}

TEST_F(SceneSource, AChangedFileAndOtherOptionsAreCompiledAnew) {
  ASSERT_TRUE(open_scene(options_).has_value());
  write_scene("room.obj", 0.5);
  EXPECT_GT(open_scene(options_)->compile_seconds, 0.0);
  options_.voxel_size_bytes = 1U << 20U;
  EXPECT_GT(open_scene(options_)->compile_seconds, 0.0);

  EXPECT_EQ(stores_cached(), 3U);
}

TEST_F(SceneSource, ADamagedStoreInTheCacheIsCompiledAgain) {
  ASSERT_TRUE(open_scene(options_).has_value());
  const fs::path store = fs::directory_iterator(options_.store_cache)->path();
  fs::resize_file(store, fs::file_size(store) / 2);

  const auto opened = open_scene(options_);

  ASSERT_TRUE(opened.has_value());
  EXPECT_GT(opened->compile_seconds, 0.0);
  EXPECT_EQ(opened->store.tables().triangle_count, 2U);
}

TEST_F(SceneSource, AStoreIsOpenedByItsContentWhateverItsName) {
  const fs::path store = folder_ / "anything.gltf";
  ASSERT_TRUE(compile_scene_file(options_, store).has_value());
  options_.scene = store.string();

  const auto opened = open_scene(options_);

  ASSERT_TRUE(opened.has_value()) << opened.error().message;
  EXPECT_EQ(opened->compile_seconds, 0.0);
  EXPECT_EQ(stores_cached(), 0U);
}

TEST_F(SceneSource, WhatIsCalledAStoreAndIsNoneIsDamaged) {
  options_.scene = (folder_ / "scene.store").string();
  EXPECT_EQ(open_scene(options_).error().code, ExitCode::kStoreDamaged);
  std::ofstream(options_.scene) << "not a store";
  EXPECT_EQ(open_scene(options_).error().code, ExitCode::kStoreDamaged);
}

TEST_F(SceneSource, AnUnknownOrMissingSceneIsRejected) {
  for (const char* name : {"missing.gltf", "missing.obj", "scene.fbx", "scene"}) {
    options_.scene = (folder_ / name).string();
    EXPECT_EQ(open_scene(options_).error().code, ExitCode::kSceneRejected) << name;
  }
}

TEST_F(SceneSource, AnUnwritableCacheIsAnOutputError) {
  std::ofstream(folder_ / "file") << "in the way";
  options_.store_cache = (folder_ / "file" / "cache").string();

  const auto opened = open_scene(options_);

  ASSERT_FALSE(opened.has_value());
  EXPECT_EQ(opened.error().code, ExitCode::kOutputUnwritable);
  EXPECT_NE(opened.error().message.find("--store-cache"), std::string::npos);
}

TEST(DemoTriangles, ReadsTheCountBehindTheColon) {
  EXPECT_EQ(demo_triangles("demo").value(), 1'000'000U);
  EXPECT_EQ(demo_triangles("demo:2.5M").value(), 2'500'000U);
  EXPECT_EQ(demo_triangles("demo:300k").value(), 300'000U);
  EXPECT_EQ(demo_triangles("demo:250000").value(), 250'000U);
  EXPECT_EQ(demo_triangles("demonstration.gltf").value(), 0U);
  EXPECT_EQ(demo_triangles("room.gltf").value(), 0U);
  for (const char* scene : {"demo:", "demo:5", "demo:x", "demo:1e30", "demo:-1M", "demo:1Mx"}) {
    const auto triangles = demo_triangles(scene);
    ASSERT_FALSE(triangles.has_value()) << scene;
    EXPECT_EQ(triangles.error().code, ExitCode::kUsage);
  }
}

}  // namespace
}  // namespace preheat
