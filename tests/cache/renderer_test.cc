#include "cache/renderer.h"

#include <gtest/gtest.h>

#include <condition_variable>
#include <deque>
#include <iostream>
#include <mutex>
#include <random>

#include "tests/scenes/grid_store.h"
#include "tests/scenes/soups.h"

namespace preheat {
namespace {

using test::GridStore;

const Vec3 kCamera(0.0F, 0.0F, 0.95F);

// A triangle just before the camera would be all that rays meet.
bool is_before_camera(const Scene& scene, const Triangle& triangle) {
  Aabb box;
  for (const std::uint32_t vertex : triangle.vertices) { box.extend(scene.positions[vertex]); }
  const Vec3 gap = glm::max(glm::max(box.low - kCamera, kCamera - box.high), Vec3(0.0F));
  return glm::length(gap) < 0.4F;
}

// A soup lit by a few emissive triangles, with a rough, a mirror-like and a glass material.
Scene lit_soup(std::uint32_t seed) {
  Scene scene = test::soup(1200, 0.12F, seed);
  std::erase_if(scene.triangles, [&](const Triangle& t) { return is_before_camera(scene, t); });
  scene.materials.resize(5);
  scene.materials[1].emission = Vec3(12.0F, 10.0F, 8.0F);
  scene.materials[2].metallic = 1.0F;
  scene.materials[2].roughness = 0.2F;
  scene.materials[3].transmission = 1.0F;
  scene.materials[3].roughness = 0.0F;
  scene.materials[3].thin_walled = false;
  scene.materials[4].roughness = 0.4F;
  for (std::size_t id = 0; id < scene.triangles.size(); ++id) {
    scene.triangles[id].material = id % 40 == 0 ? 1U : static_cast<std::uint32_t>(id * 7 % 4) % 5U;
    if (scene.triangles[id].material == 1 && id % 40 != 0) { scene.triangles[id].material = 4; }
  }
  return scene;
}

RenderSettings small_settings() {
  RenderSettings settings;
  settings.view.origin = kCamera;
  settings.view.right = Vec3(0.7F, 0.0F, 0.0F);
  settings.view.up = Vec3(0.0F, 0.7F, 0.0F);
  settings.width = 48;
  settings.height = 40;
  settings.spp = 4;
  settings.bounces = 4;
  return settings;
}

struct Outcome {
  std::string sha256{};
  WorkerStats stats{};
  std::vector<CellAccesses> accesses{};
};

// Plays the worker's event loop: every voxel that is asked for is delivered at once.
Outcome render(const GridStore& store, const RenderSettings& settings,
               const RendererOptions& options, const std::vector<VoxelId>& hot,
               const std::vector<VoxelId>& warm = {}) {
  std::mutex mutex;
  std::condition_variable woken;
  bool pending = false;
  Renderer renderer(store.tables, settings, options, [&] {
    const std::lock_guard lock(mutex);
    pending = true;
    woken.notify_one();
  });
  const auto deliver = [&](VoxelId voxel) {
    const auto& block = store.blocks[index_of(voxel)];
    ASSERT_TRUE(renderer.deliver(voxel, {block->bytes(), block}).has_value());
  };
  renderer.set_hot_voxels(hot, warm);
  for (const VoxelId voxel : hot) { deliver(voxel); }
  const TileGrid grid{settings.width, settings.height, options.tile_size};
  for (std::uint32_t tile = 0; tile < grid.count(); ++tile) { renderer.add_tile(TileId{tile}); }
  Film film(settings.width, settings.height);
  for (std::uint32_t done = 0; done < grid.count();) {
    {
      std::unique_lock lock(mutex);
      woken.wait(lock, [&] { return pending; });
      pending = false;
    }
    for (RendererEvent& event : renderer.take_events()) {
      if (const auto* needed = std::get_if<VoxelNeeded>(&event)) { deliver(needed->voxel); }
      if (const auto* tile = std::get_if<TileDone>(&event)) {
        film.assign(grid.rect(tile->tile), tile->pixels);
        ++done;
      }
      EXPECT_FALSE(std::holds_alternative<RendererFailed>(event));
    }
  }
  return {film.pixels_sha256(), renderer.stats(), renderer.accesses_by_cell()};
}

std::vector<VoxelId> every_voxel(const GridStore& store, std::uint32_t stride) {
  std::vector<VoxelId> voxels;
  for (std::uint32_t id = 0; id < store.blocks.size(); id += stride) {
    voxels.push_back(VoxelId{id});
  }
  return voxels;
}

class RendererTest : public testing::Test {
 protected:
  void SetUp() override {
    const auto seed = static_cast<std::uint32_t>(std::random_device{}());
    std::cout << "seed=" << seed << '\n';
    store_ = test::cut_into_grid(lit_soup(seed), 4);
  }
  [[nodiscard]] RendererOptions options(double cache_share) const {
    RendererOptions options;
    options.cache_limit_bytes =
        std::max(store_.tables.resident_bytes_min(),
                 static_cast<std::uint64_t>(cache_share *
                                            static_cast<double>(store_.tables.resident_bytes())));
    options.paths_per_thread = 4096;
    return options;
  }
  GridStore store_;
};

TEST_F(RendererTest, AsksForWarmVoxelsUnaskedAndCountsThemAsPreload) {
  const RenderSettings settings = small_settings();
  const std::vector<VoxelId> all = every_voxel(store_, 1);
  const Outcome cold = render(store_, settings, options(1.0), {});
  const Outcome warm = render(store_, settings, options(1.0), {}, all);

  EXPECT_GT(cold.stats.cache.remote_fetches, 0U);
  EXPECT_LE(warm.stats.preload.voxels + warm.stats.cache.remote_fetches, all.size());
  EXPECT_GT(warm.stats.preload.voxels, 0U);
  EXPECT_GT(warm.stats.preload.bytes, 0U);
  EXPECT_EQ(warm.sha256, cold.sha256);
}

TEST_F(RendererTest, PixelsAreTheSameWhateverIsResident) {
  const RenderSettings settings = small_settings();
  const Outcome reference = render(store_, settings, options(1.0), every_voxel(store_, 1));
  EXPECT_EQ(reference.stats.cache.misses, 0U);
  EXPECT_EQ(reference.stats.cache.remote_fetches, 0U);

  int combinations = 0;
  for (const double share : {0.0, 0.05, 0.25, 1.0}) {
    for (const std::uint32_t hot_stride : {0U, 5U}) {
      for (const unsigned threads : {1U, 3U}) {
        for (const std::uint32_t tile_size : {7U, 32U}) {
          if (hot_stride != 0 && share < 0.25) { continue; }
          RendererOptions with = options(share);
          with.threads = threads;
          with.tile_size = tile_size;
          const Outcome outcome = render(
              store_, settings, with,
              hot_stride == 0 ? std::vector<VoxelId>{} : every_voxel(store_, hot_stride * 2));
          EXPECT_EQ(outcome.sha256, reference.sha256)
              << "share " << share << " stride " << hot_stride << " threads " << threads;
          EXPECT_LE(outcome.stats.cache.peak_bytes, with.cache_limit_bytes);
          ++combinations;
        }
      }
    }
  }
  std::cout << combinations << " combinations\n";
}

TEST_F(RendererTest, PixelsAreTheSameWhateverIsGivenUpFirst) {
  const RenderSettings settings = small_settings();
  const Outcome reference = render(store_, settings, options(1.0), every_voxel(store_, 1));

  for (const Eviction eviction :
       {Eviction::kLru, Eviction::kLfu, Eviction::kPrior, Eviction::kS3Fifo}) {
    RendererOptions with = options(0.0);
    with.eviction = eviction;
    with.threads = 2;
    for (std::uint32_t voxel = 0; voxel < store_.blocks.size(); ++voxel) {
      with.rays_expected.push_back(voxel * 10.0);
    }
    const Outcome outcome = render(store_, settings, with, {});
    EXPECT_EQ(outcome.sha256, reference.sha256) << name_of(eviction);
    EXPECT_GT(outcome.stats.cache.evictions, 0U) << name_of(eviction);
    EXPECT_LE(outcome.stats.cache.peak_bytes, with.cache_limit_bytes) << name_of(eviction);
  }
}

TEST_F(RendererTest, CountingAccessesIsAPureFunctionOfTheScene) {
  const RenderSettings settings = small_settings();
  RendererOptions hot = options(1.0);
  hot.count_accesses = AccessCounting::kExact;
  RendererOptions cold = options(0.1);
  cold.count_accesses = AccessCounting::kExact;
  cold.threads = 2;

  const Outcome reference = render(store_, settings, hot, every_voxel(store_, 1));
  const Outcome outcome = render(store_, settings, cold, {});

  EXPECT_GT(reference.stats.cache.accesses, 0U);
  EXPECT_EQ(outcome.stats.cache.accesses, reference.stats.cache.accesses);
  ASSERT_EQ(outcome.accesses.size(), store_.blocks.size());
  CellAccesses sum;
  for (std::size_t voxel = 0; voxel < outcome.accesses.size(); ++voxel) {
    EXPECT_EQ(outcome.accesses[voxel].camera, reference.accesses[voxel].camera);
    EXPECT_EQ(outcome.accesses[voxel].scatter, reference.accesses[voxel].scatter);
    EXPECT_EQ(outcome.accesses[voxel].shadow, reference.accesses[voxel].shadow);
    sum.add(outcome.accesses[voxel]);
  }
  EXPECT_EQ(sum.total(), outcome.stats.cache.accesses);
  EXPECT_EQ(outcome.sha256, reference.sha256);
  EXPECT_LE(outcome.stats.cache.misses, outcome.stats.cache.accesses);
  EXPECT_EQ(outcome.stats.rays.total(), reference.stats.rays.total());
}

TEST_F(RendererTest, RefusesABlockThatIsNotTheVoxels) {
  Renderer renderer(store_.tables, small_settings(), options(1.0), [] {});
  renderer.set_hot_voxels({VoxelId{0}});
  const auto& other = store_.blocks[1];

  EXPECT_FALSE(renderer.deliver(VoxelId{0}, {other->bytes().first(40), other}).has_value());
  EXPECT_FALSE(renderer.deliver(VoxelId{99999}, {other->bytes(), other}).has_value());
}

TEST_F(RendererTest, RefusesATriangleThatTheSceneDoesNotHave) {
  SceneTables tables = store_.tables;
  tables.triangle_count = 1;
  Renderer renderer(tables, small_settings(), options(1.0), [] {});
  renderer.set_hot_voxels({VoxelId{0}});
  const auto& block = store_.blocks[0];
  ASSERT_GT(tables.voxels[0].triangle_count, 1U);

  EXPECT_FALSE(renderer.deliver(VoxelId{0}, {block->bytes(), block}).has_value());
}

}  // namespace
}  // namespace preheat
