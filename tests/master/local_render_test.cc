#include "master/local_render.h"

#include <gtest/gtest.h>

#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>

#include "master/scene_source.h"
#include "master/view.h"

namespace preheat {
namespace {

namespace fs = std::filesystem;

// A floor of 2 x 2 squares under the sky.
class LocalRender : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = (fs::temp_directory_path() / "preheat_local_XXXXXX").string();
    folder_ = ::mkdtemp(name.data());
    std::ofstream file(folder_ / "floor.obj");
    for (int row = 0; row < 3; ++row) {
      for (int column = 0; column < 3; ++column) { file << "v " << column << " 0 " << row << '\n'; }
    }
    for (int corner : {1, 2, 4, 5}) {
      file << "f " << corner << ' ' << corner + 3 << ' ' << corner + 4 << '\n';
      file << "f " << corner << ' ' << corner + 4 << ' ' << corner + 1 << '\n';
    }
    file.close();
    SceneOptions scene;
    scene.scene = (folder_ / "floor.obj").string();
    scene.store_cache = folder_.string();
    opened_ = open_scene(scene);
    ASSERT_TRUE(opened_.has_value()) << opened_.error().message;
    ViewOptions view;
    view.size = {48, 40};
    view.spp = 4;
    settings_ = resolve_view(opened_->store.tables(), {}, view)->settings;
  }
  void TearDown() override { fs::remove_all(folder_); }

  [[nodiscard]] Result<MasterResult> render(unsigned threads, std::uint32_t tile_size) const {
    const std::atomic<int> no_signal{0};
    return render_local(opened_->store, settings_, {threads, tile_size, AccessCounting::kExact},
                        no_signal, [](const MasterProgress&) {});
  }

  fs::path folder_{};
  Result<OpenedScene> opened_ = fail(ExitCode::kFailed, "");
  RenderSettings settings_{};
};

TEST_F(LocalRender, SeesTheFloorUnderTheSkyWithoutAMiss) {
  const auto result = render(2, 32);

  ASSERT_TRUE(result.has_value()) << result.error().message;
  ASSERT_EQ(result->workers.size(), 1U);
  const WorkerStats& stats = result->workers[0];
  EXPECT_EQ(stats.rays.camera, 48U * 40U * 4U);
  EXPECT_GT(stats.cache.accesses, 0U);
  double accesses = 0.0;
  for (const double voxel : result->accesses_by_voxel) { accesses += voxel; }
  EXPECT_EQ(accesses, static_cast<double>(stats.cache.accesses));
  EXPECT_EQ(stats.cache.misses, 0U);
  EXPECT_EQ(stats.cache.remote_fetches, 0U);
  // The corner sees the sky of radiance 1, the middle a floor that reflects less than it receives.
  EXPECT_EQ(result->film.rgb()[0], 1.0F);
  const float middle = result->film.rgb()[3 * (20 * 48 + 24)];
  EXPECT_GT(middle, 0.05F);
  EXPECT_LT(middle, 1.0F);
}

TEST_F(LocalRender, TheImageDependsNeitherOnThreadsNorOnTiles) {
  const std::string expected = render(1, 32)->film.pixels_sha256();

  EXPECT_EQ(render(2, 32)->film.pixels_sha256(), expected);
  EXPECT_EQ(render(2, 7)->film.pixels_sha256(), expected);
  EXPECT_EQ(render(1, 64)->film.pixels_sha256(), expected);
}

TEST_F(LocalRender, ASignalEndsItWithItsExitCode) {
  const std::atomic<int> signal{SIGTERM};

  const auto result = render_local(opened_->store, settings_, {1, 32, AccessCounting::kNone},
                                   signal, [](const MasterProgress&) {});

  ASSERT_FALSE(result.has_value());
  EXPECT_EQ(result.error().code, ExitCode::kTerminated);
}

TEST_F(LocalRender, ADamagedVoxelIsFoundBeforeTheFirstRay) {
  const Store& store = opened_->store;
  fs::path store_file;
  for (const auto& entry : fs::directory_iterator(folder_)) {
    if (entry.path().extension() == ".store") { store_file = entry.path(); }
  }
  const auto block = store.block(VoxelId{0});
  std::fstream bytes(store_file, std::ios::in | std::ios::out | std::ios::binary);
  const std::string needle(reinterpret_cast<const char*>(block.data()), 64);
  std::string content{std::istreambuf_iterator<char>(bytes), {}};
  const std::size_t at = content.find(needle);
  ASSERT_NE(at, std::string::npos);
  bytes.clear();
  bytes.seekp(static_cast<std::streamoff>(at + 40));
  bytes.put(static_cast<char>(content[at + 40] ^ 1));
  bytes.close();

  const auto result = render(1, 32);

  ASSERT_FALSE(result.has_value());
  EXPECT_EQ(result.error().code, ExitCode::kStoreDamaged);
}

}  // namespace
}  // namespace preheat
