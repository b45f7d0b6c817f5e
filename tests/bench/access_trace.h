// What the rays of a frame enter, in the order in which a worker's waves of paths need it: recorded
// once from the renderer's own shading and tracing, then replayed by simulations.
//
// A step is one depth of one tile's paths: their camera rays, or the scattered and shadow rays of
// their n-th vertices. For each step it holds how many rays entered which voxels before their
// nearest hit. Recording is exact and deterministic.
#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <vector>

#include "common/ids.h"
#include "common/render_settings.h"
#include "common/result.h"
#include "common/store.h"

namespace preheat {

struct TraceAccess {
  VoxelId voxel{};
  std::uint32_t rays = 0;
  friend bool operator==(const TraceAccess&, const TraceAccess&) = default;
};

class AccessTrace {
 public:
  struct Step {
    TileId tile{};
    std::uint32_t depth = 0;
    std::uint64_t rays = 0;   // traced, whichever voxels they enter
    std::uint64_t begin = 0;  // into accesses
  };

  AccessTrace(std::uint32_t width, std::uint32_t height, std::uint32_t spp, std::uint32_t tile_size)
      : grid_{width, height, tile_size}, spp_(spp) {}

  // `accesses` by ascending voxel, each with rays.
  void add_step(TileId tile, std::uint32_t depth, std::uint64_t rays,
                std::span<const TraceAccess> accesses);

  [[nodiscard]] const TileGrid& grid() const { return grid_; }
  [[nodiscard]] std::uint32_t spp() const { return spp_; }
  [[nodiscard]] const std::vector<Step>& steps() const { return steps_; }
  [[nodiscard]] std::span<const TraceAccess> accesses(std::size_t step) const;
  [[nodiscard]] std::uint64_t bytes() const;

  // In this machine's byte order: a trace is made and used on one machine.
  [[nodiscard]] Result<void> save(const std::filesystem::path& file) const;
  [[nodiscard]] static Result<AccessTrace> load(const std::filesystem::path& file);

 private:
  TileGrid grid_{};
  std::uint32_t spp_ = 0;
  std::vector<Step> steps_;
  std::vector<TraceAccess> accesses_;
};

// An error if it would take more than this.
inline constexpr std::uint64_t kTraceBytesMax = std::uint64_t{1} << 30;

[[nodiscard]] Result<AccessTrace> record_accesses(const Store& store,
                                                  const RenderSettings& settings,
                                                  std::uint32_t tile_size);

// The tiles' steps put together as the waves of a worker that keeps `paths_max` paths in flight and
// renders every `worker_count`-th such wave: depth by depth over all tiles of a wave.
[[nodiscard]] std::vector<std::vector<TraceAccess>> wave_steps(const AccessTrace& trace,
                                                               std::uint64_t paths_max,
                                                               unsigned worker_count);

}  // namespace preheat
