// Renders tiles with whatever voxels are resident, and says which ones it waits for.
//
// Owns the tracer threads, the builder thread and the cache of one worker process; knows no socket.
// `preheat-worker` feeds it from the network, `preheat render --local` from the mapped store with
// every voxel hot. Voxels change when a tile is done, never a bit of it.
//
//   offer_hot_set, deliver, add_tile ->  [ builder thread -> resident voxels ]
//                                        [ tracer threads: paths, parked rays ]  -> take_events
//
// Threads: one owner calls every member. `wake` is called from other threads whenever take_events
// has something new; it must be cheap and must not call back.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <variant>
#include <vector>

#include "cache/counting_tree.h"
#include "common/eviction.h"
#include "common/film.h"
#include "common/ids.h"
#include "common/limits.h"
#include "common/render_settings.h"
#include "common/result.h"
#include "common/scene_tables.h"
#include "common/stats.h"

namespace preheat {

struct RendererOptions {
  unsigned threads = 1;
  std::uint64_t cache_limit_bytes = 0;  // >= SceneTables::resident_bytes_min()
  std::uint32_t tile_size = 32;
  AccessCounting count_accesses = AccessCounting::kSampled;
  // Accesses are counted in this tree's cells; nullptr: in the voxels.
  std::shared_ptr<const CountingTree> counting_tree{};
  std::uint32_t paths_per_thread = kPathsPerThread;
  Eviction eviction = kEvictionDefault;
  std::vector<double> rays_expected{};  // [voxel_count] of the frame, or empty; for kPrior
};

// The bytes of one voxel, 16-byte aligned, already checked against its hash. For `--local` they
// point into the mapped store; from the network `owner` keeps them alive.
struct VoxelBytes {
  std::span<const std::byte> bytes{};
  std::shared_ptr<const void> owner{};
};

// The hot BVH is built; tiles run from now on.
struct HotSetReady {
  PreloadStats preload{};
};
// Rays wait for a voxel that is not held, or it is a warm one. Said once; the owner fetches it and
// calls deliver, or says it again later itself. Sent only while the cache has promised room for the
// block.
struct VoxelNeeded {
  VoxelId voxel{};
  bool waited_for = true;  // by rays
};
struct TileDone {
  TileId tile{};
  TilePixels pixels{};
};
// The renderer cannot go on, e.g. the hot set's memory could not be had.
struct RendererFailed {
  Error error{};
};
using RendererEvent = std::variant<HotSetReady, VoxelNeeded, TileDone, RendererFailed>;

class Renderer {
 public:
  Renderer(SceneTables tables, const RenderSettings& settings, const RendererOptions& options,
           std::function<void()> wake);
  ~Renderer();  // stops at the next batch; unfinished tiles are dropped
  Renderer(const Renderer&) = delete;
  Renderer& operator=(const Renderer&) = delete;

  // Call once, before the first tile runs: the voxels of the hot set, then deliver each of them
  // (which here is preload, not a remote fetch). An empty list is allowed. The warm ones are asked
  // for by VoxelNeeded once the hot set is built, in this order and as far as the cache has room,
  // and count as preload as well.
  void set_hot_voxels(std::vector<VoxelId> voxels, std::vector<VoxelId> warm = {});

  // A voxel's bytes have arrived, asked for or not. Bytes nobody wants any more are dropped. An
  // error if the block is malformed: then the voxel counts as never delivered.
  [[nodiscard]] Result<void> deliver(VoxelId voxel, VoxelBytes bytes);

  // Tiles are rendered in the order given. Keep about two per thread queued.
  void add_tile(TileId tile);

  // Forgets tiles whose leases were lost and that have not begun.
  void cancel_tile(TileId tile);

  [[nodiscard]] std::vector<RendererEvent> take_events();

  // Grows while tracer threads do: a hung renderer stands still.
  [[nodiscard]] std::uint64_t progress() const;

  [[nodiscard]] std::size_t tiles_pending() const;  // added and not yet taken as TileDone

  [[nodiscard]] WorkerStats stats() const;

  // Counted so far and not scaled up, [voxel_count], or [cell_count] of the counting tree; needs
  // AccessCounting other than kNone. Complete once every tile has been taken as TileDone.
  [[nodiscard]] std::vector<CellAccesses> accesses_by_cell() const;

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

// The instruction set and flags that the bits of a hit depend on, e.g. "avx2"; part of the
// handshake.
[[nodiscard]] const char* tracing_isa();

}  // namespace preheat
