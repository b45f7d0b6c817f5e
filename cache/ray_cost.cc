#include "cache/ray_cost.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <limits>
#include <mutex>
#include <utility>
#include <variant>
#include <vector>

#include "cache/renderer.h"
#include "common/compensated_sum.h"
#include "common/math.h"
#include "common/voxel_block.h"

namespace preheat {
namespace {

using Clock = std::chrono::steady_clock;

constexpr std::uint32_t kImageSize = 96;
constexpr std::uint32_t kTileSize = 16;
constexpr int kRepeats = 6;  // the quickest counts: nothing makes a render too quick

// gamma and delta.
constexpr double kNoLevel = 0.276;
constexpr double kLevel = 0.0404;

// Bands of a sphere in the coarse and in the fine room, whose mean is taken: one fits into the
// processor's caches, the other does not.
constexpr std::array<unsigned, 2> kSphereBands{4, 24};
constexpr int kSpheresPerSide = 4;

// ---- the room: it has a lamp and is full of spheres ----

void add_triangle(Scene& scene, const Vec3& a, const Vec3& b, const Vec3& c,
                  std::uint32_t material) {
  const auto first = static_cast<std::uint32_t>(scene.positions.size());
  for (const Vec3& corner : {a, b, c}) {
    scene.positions.push_back(corner);
    scene.normals.emplace_back(0.0F);
  }
  scene.triangles.push_back({{first, first + 1, first + 2}, material});
}

void add_quad(Scene& scene, const Vec3& corner, const Vec3& u, const Vec3& v,
              std::uint32_t material) {
  add_triangle(scene, corner, corner + u, corner + u + v, material);
  add_triangle(scene, corner, corner + u + v, corner + v, material);
}

void add_sphere(Scene& scene, const Vec3& centre, float radius, unsigned bands) {
  const auto point = [&](unsigned band, unsigned sector) {
    const double polar = kPiDouble * band / bands;
    const double azimuth = kPiDouble * sector / bands;
    return centre + radius * Vec3(Vec3d(sin_of(polar) * cos_of(azimuth), cos_of(polar),
                                        sin_of(polar) * sin_of(azimuth)));
  };
  for (unsigned band = 0; band < bands; ++band) {
    for (unsigned sector = 0; sector < 2 * bands; ++sector) {
      const Vec3 a = point(band, sector);
      const Vec3 b = point(band, sector + 1);
      const Vec3 c = point(band + 1, sector);
      const Vec3 d = point(band + 1, sector + 1);
      if (band > 0) { add_triangle(scene, a, b, c, 0); }
      if (band + 1 < bands) { add_triangle(scene, b, d, c, 0); }
    }
  }
}

Scene make_room(unsigned bands) {
  Scene scene;
  scene.materials.resize(2);
  scene.materials[1].emission = Vec3(10.0F);
  const Vec3 x(1.8F, 0.0F, 0.0F);
  const Vec3 y(0.0F, 1.8F, 0.0F);
  const Vec3 z(0.0F, 0.0F, 1.8F);
  const Vec3 low(-0.9F);
  for (const auto& [u, v, far] : {std::array{x, y, z}, std::array{y, z, x}, std::array{z, x, y}}) {
    add_quad(scene, low, u, v, 0);
    add_quad(scene, low + far, u, v, 0);
  }
  add_quad(scene, Vec3(-0.2F, 0.89F, -0.2F), x * 0.2F, z * 0.2F, 1);
  const float step = 1.6F / kSpheresPerSide;
  for (int i = 0; i < kSpheresPerSide * kSpheresPerSide * kSpheresPerSide; ++i) {
    const Vec3 place(static_cast<float>(i % kSpheresPerSide),
                     static_cast<float>(i / kSpheresPerSide % kSpheresPerSide),
                     static_cast<float>(i / (kSpheresPerSide * kSpheresPerSide)));
    add_sphere(scene, Vec3(-0.8F) + step * (place + Vec3(0.5F)), 0.3F * step, bands);
  }
  return scene;
}

RenderSettings room_settings() {
  RenderSettings settings;
  settings.width = kImageSize;
  settings.height = kImageSize;
  settings.spp = 1;
  settings.view.origin = Vec3(-0.05F, 0.03F, 0.85F);
  return settings;
}

// The whole scene in one voxel.
struct OneVoxel {
  SceneTables tables{};
  std::vector<std::byte> block{};
};

OneVoxel one_voxel(const Scene& scene) {
  std::vector<std::uint32_t> ids(scene.triangles.size());
  Aabb bounds;
  OneVoxel voxel;
  voxel.tables.materials = scene.materials;
  voxel.tables.triangle_count = scene.triangles.size();
  for (std::uint32_t id = 0; id < ids.size(); ++id) {
    ids[id] = id;
    const Triangle& triangle = scene.triangles[id];
    EmissiveTriangle emissive{id, triangle.material, {}};
    for (std::size_t i = 0; i < 3; ++i) {
      emissive.vertices[i] = scene.positions[triangle.vertices[i]];
      bounds.extend(emissive.vertices[i]);
    }
    const bool emits = scene.materials[triangle.material].emission != Vec3(0.0F);
    if (emits) { voxel.tables.emissive_triangles.push_back(emissive); }
  }
  voxel.block = encode_voxel_block(scene, ids);
  VoxelEntry entry;
  entry.bounds = grown_cell(bounds);
  entry.block_bytes = static_cast<std::uint32_t>(voxel.block.size());
  entry.triangle_count = static_cast<std::uint32_t>(ids.size());
  entry.resident_bytes = voxel.block.size() + bvh_bytes_bound(ids.size());
  voxel.tables.voxels.push_back(entry);
  voxel.tables.voxel_nodes.push_back({entry.bounds, 0, 0});
  return voxel;
}

// ---- timing ----

// The owner of a renderer, which sleeps until it has something new.
class TimedRender {
 public:
  TimedRender(const OneVoxel& voxel, unsigned threads)
      : voxel_(voxel),
        grid_{kImageSize, kImageSize, kTileSize},
        renderer_(voxel.tables, room_settings(),
                  {.threads = threads,
                   .cache_limit_bytes = voxel.tables.resident_bytes(),
                   .tile_size = kTileSize,
                   .count_accesses = AccessCounting::kNone,
                   .paths_per_thread = kImageSize * kImageSize},
                  [this] { wake(); }) {}

  Result<double> seconds_per_ray() {
    renderer_.set_hot_voxels({VoxelId{0}});
    const Result<void> delivered = renderer_.deliver(VoxelId{0}, {voxel_.block, nullptr});
    if (!delivered) { return tl::unexpected(delivered.error()); }
    if (const Result<void> ready = wait_for(1); !ready) { return tl::unexpected(ready.error()); }
    double best = std::numeric_limits<double>::infinity();
    for (int repeat = 0; repeat < kRepeats; ++repeat) {
      const std::uint64_t rays_before = renderer_.stats().rays.total();
      const Clock::time_point begin = Clock::now();
      for (std::uint32_t tile = 0; tile < grid_.count(); ++tile) {
        renderer_.add_tile(TileId{tile});
      }
      if (const Result<void> done = wait_for(grid_.count()); !done) {
        return tl::unexpected(done.error());
      }
      const double seconds = std::chrono::duration<double>(Clock::now() - begin).count();
      const std::uint64_t rays = renderer_.stats().rays.total() - rays_before;
      best = std::min(best, seconds / static_cast<double>(std::max<std::uint64_t>(1, rays)));
    }
    return best;
  }

 private:
  void wake() {
    {
      const std::lock_guard lock(mutex_);
      is_woken_ = true;
    }
    condition_.notify_one();
  }

  // So many events, none of which is a failure.
  Result<void> wait_for(std::size_t events) {
    while (events > 0) {
      {
        std::unique_lock lock(mutex_);
        condition_.wait(lock, [this] { return is_woken_; });
        is_woken_ = false;
      }
      for (const RendererEvent& event : renderer_.take_events()) {
        if (const auto* const failed = std::get_if<RendererFailed>(&event)) {
          return tl::unexpected(failed->error);
        }
        --events;
      }
    }
    return {};
  }

  const OneVoxel& voxel_;
  TileGrid grid_;
  std::mutex mutex_;
  std::condition_variable condition_;
  bool is_woken_ = false;
  Renderer renderer_;  // last: its threads stop before what they wake
};

}  // namespace

double levels_per_ray(const SceneTables& tables, const Prediction& prediction) {
  CompensatedSum levels;
  for (std::size_t voxel = 0; voxel < tables.voxels.size(); ++voxel) {
    levels.add(prediction.rays(voxel) *
               std::log2(1.0 + static_cast<double>(tables.voxels[voxel].triangle_count)));
  }
  const double rays = prediction.rays_total();
  return rays > 0.0 ? levels.value() / rays : 0.0;
}

double seconds_per_ray(double room_seconds, double levels) {
  return room_seconds * (kNoLevel + kLevel * levels);
}

Result<double> measure_room_ray(unsigned threads) {
  double sum = 0.0;
  for (const unsigned bands : kSphereBands) {
    const OneVoxel voxel = one_voxel(make_room(bands));
    const Result<double> seconds = TimedRender(voxel, threads).seconds_per_ray();
    if (!seconds) { return seconds; }
    sum += *seconds;
  }
  return sum / kSphereBands.size();
}

}  // namespace preheat
