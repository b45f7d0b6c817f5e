#include "cache/renderer.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <iostream>
#include <memory>
#include <mutex>
#include <random>
#include <utility>

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

// How the voxels that are asked for come.
struct Delivery {
  // At once and in order, or late, in random order, some of them damaged first and some twice.
  std::mt19937* disorder = nullptr;
  // Counts the bytes of delivered blocks that the renderer still holds.
  std::atomic<std::uint64_t>* held_bytes = nullptr;
  std::uint64_t held_bytes_peak = 0;  // at any delivery or event
};

VoxelBytes bytes_of(const GridStore& store, VoxelId voxel, Delivery& delivery) {
  const std::shared_ptr<const test::AlignedBytes> block = store.blocks[index_of(voxel)];
  if (delivery.held_bytes == nullptr) { return {block->bytes(), block}; }
  const std::uint64_t size = block->bytes().size();
  *delivery.held_bytes += size;
  const auto let_go = [block, size, held = delivery.held_bytes](const void*) { *held -= size; };
  return {block->bytes(), std::shared_ptr<const void>(block.get(), let_go)};
}

void note_held_bytes(Delivery& delivery) {
  if (delivery.held_bytes == nullptr) { return; }
  delivery.held_bytes_peak = std::max(delivery.held_bytes_peak, delivery.held_bytes->load());
}

void deliver(const GridStore& store, VoxelId voxel, Delivery& delivery, Renderer& renderer) {
  std::mt19937* const disorder = delivery.disorder;
  if (disorder != nullptr && (*disorder)() % 3 == 0) {
    const auto& block = store.blocks[index_of(voxel)];
    const auto cut = block->bytes().first(block->bytes().size() / 2);
    EXPECT_FALSE(renderer.deliver(voxel, {cut, block}).has_value());
  }
  EXPECT_TRUE(renderer.deliver(voxel, bytes_of(store, voxel, delivery)).has_value());
  if (disorder != nullptr && (*disorder)() % 3 == 0) {
    EXPECT_TRUE(renderer.deliver(voxel, bytes_of(store, voxel, delivery)).has_value());
  }
  note_held_bytes(delivery);
}

// Plays the worker's event loop: every voxel that is asked for is delivered.
Outcome render(const GridStore& store, const RenderSettings& settings,
               const RendererOptions& options, const std::vector<VoxelId>& hot,
               const std::vector<VoxelId>& warm, Delivery& delivery) {
  std::mutex mutex;
  std::condition_variable woken;
  bool pending = false;
  Renderer renderer(store.tables, settings, options, [&] {
    const std::lock_guard lock(mutex);
    pending = true;
    woken.notify_one();
  });
  renderer.set_hot_voxels(hot, warm);
  for (const VoxelId voxel : hot) { deliver(store, voxel, delivery, renderer); }
  const TileGrid grid{settings.width, settings.height, options.tile_size};
  for (std::uint32_t tile = 0; tile < grid.count(); ++tile) { renderer.add_tile(TileId{tile}); }
  Film film(settings.width, settings.height);
  std::vector<VoxelId> late;
  for (std::uint32_t done = 0; done < grid.count();) {
    {
      std::unique_lock lock(mutex);
      if (late.empty()) {
        woken.wait(lock, [&] { return pending; });
      }
      pending = false;
    }
    for (RendererEvent& event : renderer.take_events()) {
      note_held_bytes(delivery);
      if (const auto* needed = std::get_if<VoxelNeeded>(&event)) { late.push_back(needed->voxel); }
      if (const auto* tile = std::get_if<TileDone>(&event)) {
        film.assign(grid.rect(tile->tile), tile->pixels);
        ++done;
      }
      EXPECT_FALSE(std::holds_alternative<RendererFailed>(event));
    }
    if (delivery.disorder == nullptr) {
      for (const VoxelId voxel : std::exchange(late, {})) {
        deliver(store, voxel, delivery, renderer);
      }
    } else if (!late.empty()) {
      std::swap(late[(*delivery.disorder)() % late.size()], late.back());
      deliver(store, late.back(), delivery, renderer);
      late.pop_back();
    }
  }
  return {film.pixels_sha256(), renderer.stats(), renderer.accesses_by_cell()};
}

Outcome render(const GridStore& store, const RenderSettings& settings,
               const RendererOptions& options, const std::vector<VoxelId>& hot,
               const std::vector<VoxelId>& warm = {}) {
  Delivery delivery;
  return render(store, settings, options, hot, warm, delivery);
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
    std::cout << "seed=" << seed_ << '\n';
    store_ = test::cut_into_grid(lit_soup(seed_), 4);
  }
  [[nodiscard]] static RendererOptions options(const GridStore& store, double cache_share) {
    RendererOptions options;
    options.cache_limit_bytes =
        std::max(store.tables.resident_bytes_min(),
                 static_cast<std::uint64_t>(cache_share *
                                            static_cast<double>(store.tables.resident_bytes())));
    options.paths_per_thread = 4096;
    return options;
  }
  [[nodiscard]] RendererOptions options(double cache_share) const {
    return options(store_, cache_share);
  }
  const std::uint32_t seed_ = static_cast<std::uint32_t>(std::random_device{}());
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

TEST_F(RendererTest, PixelsAreTheSameInWhateverOrderVoxelsCome) {
  const RenderSettings settings = small_settings();
  const Outcome reference = render(store_, settings, options(1.0), every_voxel(store_, 1));

  std::mt19937 random(seed_);
  for (const double share : {0.0, 0.1, 0.5}) {
    for (const unsigned threads : {1U, 2U}) {
      RendererOptions with = options(share);
      with.threads = threads;
      Delivery delivery{&random};
      const Outcome outcome = render(store_, settings, with, {}, {}, delivery);
      EXPECT_EQ(outcome.sha256, reference.sha256) << "share " << share << " threads " << threads;
      EXPECT_GT(outcome.stats.cache.misses, 0U);
    }
  }
}

// From one voxel around everything to 8^3, all in memory and one at a time.
TEST_F(RendererTest, PixelsAreTheSameHoweverTheSceneIsCut) {
  const RenderSettings settings = small_settings();
  Scene one_triangle = test::empty_scene();
  one_triangle.materials[0].emission = Vec3(1.0F, 0.5F, 0.25F);
  test::add_triangle(one_triangle, {-0.5F, -0.6F, 0.0F}, {0.7F, -0.5F, -0.2F}, {0.1F, 0.8F, 0.1F});
  for (const Scene& scene : {lit_soup(seed_), one_triangle}) {
    const GridStore whole = test::cut_into_grid(scene, 1);
    ASSERT_EQ(whole.blocks.size(), 1U);
    const Outcome reference = render(whole, settings, options(whole, 1.0), every_voxel(whole, 1));
    EXPECT_NE(reference.sha256, Film(settings.width, settings.height).pixels_sha256());
    for (const int cells : {1, 2, 3, 5, 8}) {
      const GridStore cut = test::cut_into_grid(scene, cells);
      const Outcome hot = render(cut, settings, options(cut, 1.0), every_voxel(cut, 1));
      const Outcome cold = render(cut, settings, options(cut, 0.0), {});
      EXPECT_EQ(hot.sha256, reference.sha256) << cells << "^3 cells";
      EXPECT_EQ(cold.sha256, reference.sha256) << cells << "^3 cells";
    }
  }
}

TEST_F(RendererTest, AnEmptySceneIsItsSky) {
  const GridStore empty = test::cut_into_grid(test::empty_scene(), 4);
  RenderSettings settings = small_settings();
  settings.sky = Vec3(0.25F, 0.5F, 0.75F);
  Film expected(settings.width, settings.height);
  TilePixels sky;
  for (std::uint32_t pixel = 0; pixel < settings.width * settings.height; ++pixel) {
    sky.rgb.insert(sky.rgb.end(), {0.25F, 0.5F, 0.75F});
    sky.variance.push_back(0.0F);
  }
  expected.assign({0, 0, settings.width, settings.height}, sky);

  EXPECT_EQ(render(empty, settings, options(empty, 1.0), {}).sha256, expected.pixels_sha256());
}

// Every pixel is rendered once, whatever the image's shape and the tiles': its bits are those that
// one tile over the whole image gives.
TEST_F(RendererTest, PixelsAreTheSameInTilesOfAnySizeOfImagesOfAnyShape) {
  const std::vector<VoxelId> hot = every_voxel(store_, 1);
  for (const auto& [width, height] :
       {std::pair{1U, 1U}, {1U, 37U}, {41U, 1U}, {17U, 31U}, {64U, 3U}}) {
    RenderSettings settings = small_settings();
    settings.width = width;
    settings.height = height;
    RendererOptions with = options(1.0);
    with.tile_size = 64;
    const std::string expected = render(store_, settings, with, hot).sha256;
    for (const std::uint32_t tile_size : {1U, 2U, 7U, 32U, 1024U}) {
      const TileGrid grid{width, height, tile_size};
      std::vector<int> coverage(std::size_t{width} * height);
      for (std::uint32_t tile = 0; tile < grid.count(); ++tile) {
        const TileRect rect = grid.rect(TileId{tile});
        for (std::uint32_t y = rect.y; y < rect.y + rect.height; ++y) {
          for (std::uint32_t x = rect.x; x < rect.x + rect.width; ++x) {
            ++coverage[std::size_t{y} * width + x];
          }
        }
      }
      with.tile_size = tile_size;
      const Outcome outcome = render(store_, settings, with, hot);
      EXPECT_EQ(std::count(coverage.begin(), coverage.end(), 1), width * height);
      EXPECT_EQ(outcome.stats.rays.camera, std::uint64_t{width} * height * settings.spp);
      EXPECT_EQ(outcome.sha256, expected) << width << 'x' << height << " by " << tile_size;
    }
  }
}

// What the cache counts is what there is: the blocks that are alive never exceed the limit.
TEST_F(RendererTest, HoldsNoMoreOfBlocksAtAnyMomentThanTheCacheAllows) {
  const RenderSettings settings = small_settings();
  for (const double share : {0.0, 0.05, 0.25}) {
    for (const std::uint32_t hot_stride : {0U, 16U}) {
      if (hot_stride != 0 && share < 0.25) { continue; }
      RendererOptions with = options(share);
      with.threads = 2;
      std::atomic<std::uint64_t> held_bytes{0};
      Delivery delivery{nullptr, &held_bytes};
      const std::vector<VoxelId> hot =
          hot_stride == 0 ? std::vector<VoxelId>{} : every_voxel(store_, hot_stride);
      const Outcome outcome = render(store_, settings, with, hot, every_voxel(store_, 1), delivery);

      EXPECT_LE(delivery.held_bytes_peak, outcome.stats.cache.peak_bytes) << "share " << share;
      EXPECT_LE(outcome.stats.cache.peak_bytes, with.cache_limit_bytes) << "share " << share;
      EXPECT_GT(delivery.held_bytes_peak, 0U);
      EXPECT_EQ(held_bytes, 0U) << "share " << share;
    }
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
