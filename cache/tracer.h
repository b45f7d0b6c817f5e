// One tracer's paths, advanced in batches: trace, shade, park where a voxel is missing, go on when
// it has come. Owns its tiles from first sample to last; shares nothing but the residency.
//
//   add_tile -> fresh paths -> [runnable rays] -> trace --final--> both done -> shade --.
//                                  ^                |                                   |
//                                  |                '--waiting--> [parked, by voxel]    |
//                                  |                                     |              |
//                                  |<------- voxel_available ------------'              |
//                                  '--------------- new rays ---------------------------|
//                                              samples -> finished tile <---------------'
//
// Rays run last-in first-out, so that a path stays in the processor's cache until it ends or parks,
// and new paths start only when nothing else can run. Both rays of a vertex may be in flight at
// once; the next vertex is shaded when both are done, so radiance is summed in path order whatever
// arrived first.
//
// Threads: one thread at a time calls every member; no clock, no lock, no socket.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <unordered_map>
#include <vector>

#include "cache/counting_tree.h"
#include "cache/tracing.h"
#include "common/film.h"
#include "common/limits.h"
#include "common/path.h"
#include "common/render_settings.h"
#include "common/stats.h"

namespace preheat {

struct TracerContext {
  const SceneTables& tables;
  const RenderSettings& settings;
  const Shading& shading;
  const Residency& residency;
  ResidentTable& resident;
  TileGrid grid{};
  AccessCounting count_accesses = AccessCounting::kSampled;
  const CountingTree* counting_tree = nullptr;  // nullptr: the voxels
  std::size_t paths_max = kPathsPerThread;      // in flight
};

struct FinishedTile {
  TileId tile{};
  TilePixels pixels{};
};

// Rays of one tracer that wait for a voxel, or waited and have been served.
struct VoxelRays {
  VoxelId voxel{};
  std::uint64_t rays = 0;
};

class Tracer {
 public:
  // `index` is this tracer's place in the resident table.
  Tracer(const TracerContext& context, unsigned index);

  // True if a further tile would give it something to run now.
  [[nodiscard]] bool wants_tile() const;
  void add_tile(TileId tile);

  // A voxel has been published; ignored if no ray waits for it.
  void voxel_available(VoxelId voxel);

  // Runs some thousand rays, fewer if it runs out. False if there was nothing to run.
  bool run_batch();

  [[nodiscard]] bool has_parked_rays() const { return parked_count_ > 0; }

  // True if asking for voxels pays now. While fresh paths can run, rays gather at the missing
  // voxels, so that one visit of a voxel serves many; once nothing else runs, or half the paths
  // wait, it does.
  [[nodiscard]] bool wants_voxels() const;

  // What changed since the last call.
  [[nodiscard]] std::vector<VoxelRays> take_demands();
  [[nodiscard]] std::vector<VoxelRays> take_served();
  [[nodiscard]] std::vector<FinishedTile> take_finished();

  [[nodiscard]] const RayStats& rays() const { return rays_; }
  [[nodiscard]] std::uint64_t misses() const { return misses_; }
  [[nodiscard]] std::uint64_t accesses() const { return accesses_; }  // scaled up where sampled
  // Counted and not scaled, [voxel_count], or [cell_count] of the counting tree; empty without
  // counting.
  [[nodiscard]] const std::vector<CellAccesses>& accesses_by_cell() const {
    return accesses_by_cell_;
  }

  // One ray in this many is counted by AccessCounting::kSampled.
  static constexpr std::uint32_t kAccessSampling = 64;
  // What an access that was counted stands for.
  [[nodiscard]] static constexpr std::uint32_t accesses_per_count(AccessCounting counting) {
    return counting == AccessCounting::kSampled ? kAccessSampling : 1;
  }

 private:
  enum class RayKind : std::uint8_t { kScatter = 0, kShadow = 1 };  // the camera ray is kScatter
  struct Task {
    std::uint32_t path = 0;
    RayKind kind = RayKind::kScatter;
  };
  struct Path {
    PathState state{};
    RayQuery scatter{};
    RayQuery shadow{};
    Vec3 direct{0.0F};
    std::uint32_t tile = 0;    // slot in tiles_
    std::uint32_t sample = 0;  // slot in ActiveTile::samples
    bool has_scatter = false;
    bool has_shadow = false;
    std::uint8_t pending = 0;  // rays in flight
  };
  // Samples are taken a window at a time, so that memory is bounded whatever the sample count.
  struct ActiveTile {
    TileId id{};
    TileRect rect{};
    TileAccumulator sums{0};
    std::uint32_t window_begin = 0;  // first sample of the window
    std::uint32_t window_size = 0;
    std::uint32_t started = 0;  // samples of the window, pixel by pixel
    std::uint32_t finished = 0;
    std::vector<Vec3> samples{};  // [pixel_count * window_size]
    [[nodiscard]] std::uint32_t pixel_count() const { return rect.width * rect.height; }
    [[nodiscard]] std::uint32_t window_count() const { return pixel_count() * window_size; }
  };
  struct Queue {
    std::vector<Task> tasks{};
    std::uint64_t reported = 0;  // of `tasks`, told by take_demands
  };

  bool start_path();
  void serve(VoxelId voxel);
  void run(Task task);
  void settle(Task task, Residency::Answer answer);
  void advance(std::uint32_t path_index);
  void launch(std::uint32_t path_index, const ShadedVertex& vertex);
  void finish_path(std::uint32_t path_index);
  void begin_window(ActiveTile& tile) const;
  void end_window(std::uint32_t tile_slot);
  void count(const Path& path, RayKind kind);
  [[nodiscard]] bool is_counted(const Path& path, RayKind kind) const;

  TracerContext context_;
  unsigned index_;
  std::vector<Path> paths_;
  std::vector<std::uint32_t> paths_free_;
  std::vector<Task> runnable_;
  std::vector<std::unique_ptr<ActiveTile>> tiles_;  // nullptr = free slot
  std::vector<std::uint32_t> tiles_startable_;      // slots with samples to start
  std::unordered_map<VoxelId, Queue> parked_;
  std::vector<VoxelId> parked_changed_;  // queues with unreported tasks
  std::vector<VoxelId> available_;
  std::vector<VoxelRays> served_;
  std::vector<FinishedTile> finished_;
  std::size_t parked_count_ = 0;
  RayStats rays_{};
  std::uint64_t misses_ = 0;
  std::uint64_t accesses_ = 0;
  std::span<const VoxelNode> counting_nodes_;
  std::vector<CellAccesses> accesses_by_cell_;
};

}  // namespace preheat
