// A render on more workers than there are machines here: a discrete-event simulation from a
// recorded trace. Deterministic: a function of its arguments, with a seed for the speeds of
// workers.
//
// What is simulated: the hot set passed down a tree of workers in chunks; tiles pulled from the
// master, worker by worker; each worker's own cache (the real VoxelCache and policy) over the cold
// voxels of its waves of paths; missing voxels fetched from their home worker, which has them from
// the origin once, over links that serve one transfer after the other in each direction; one
// builder thread a worker; the next wave's voxels on their way while a wave is traced; pixels back
// to the master; the last tiles rendered twice. What is not: congestion inside the network, losses,
// the processor time of serving.
#pragma once

#include <cstdint>
#include <vector>

#include "cache/eviction_policy.h"
#include "cache/voxel_cache.h"
#include "tests/bench/access_trace.h"

namespace preheat {

struct SimulatedWave {
  double rays = 0.0;
  std::vector<TraceAccess> accesses{};
};
// Waves of one tile, shared by all tiles that were recorded as one.
struct SimulatedTile {
  std::uint32_t recorded = 0;  // into ClusterWork::waves
  double rays_share = 1.0;     // of the rays of those waves
};

struct ClusterWork {
  std::vector<VoxelCache::Size> voxels{};
  std::vector<bool> is_hot{};
  std::uint64_t hot_block_bytes = 0;                // sent to every worker
  std::uint64_t cold_limit_bytes = 0;               // of each worker's cache, beside the hot set
  std::vector<std::vector<SimulatedWave>> waves{};  // [recorded tile]
  std::vector<SimulatedTile> tiles{};               // in the order in which they are handed out
  std::uint64_t tile_bytes = 0;                     // of pixels
};

struct ClusterOptions {
  unsigned workers = 16;
  double link_bytes_per_second = 1.25e9;
  double latency_seconds = 100e-6;
  double seconds_per_ray = 1e-6;
  double build_seconds_per_byte = 10e-9;  // of a block
  double hot_build_seconds = 0.0;
  unsigned broadcast_fan_out = 2;
  std::uint64_t chunk_bytes = 256 * 1024;
  bool double_tiles = true;
  // Workers' speeds are 1 / (1 + x), x exponential with this mean.
  double slowness_mean = 0.0;
  std::uint64_t seed = 1;
  Eviction eviction = Eviction::kLru;
};

// Worker-seconds, which add up to workers * frame_seconds.
struct ClusterSplit {
  double traced = 0.0;      // of tiles that were the first to be done
  double preload = 0.0;     // until a worker's hot set is built
  double stalled = 0.0;     // no ray could run: voxels were on their way or being built
  double duplicated = 0.0;  // tiles that another worker had done first
  double idle = 0.0;        // nothing left to hand out, or pixels on their way
};

struct ClusterResult {
  double frame_seconds = 0.0;    // preload included
  double preload_seconds = 0.0;  // until the last worker is ready
  ClusterSplit split{};
  std::uint64_t origin_bytes = 0;  // sent by the master's machine
  std::uint64_t peer_bytes = 0;
  std::uint64_t fetches = 0;

  // Of the whole frame, and of what follows the preload.
  [[nodiscard]] double efficiency() const;
  [[nodiscard]] double efficiency_rendering() const;
};

// When each worker has the hot set: the master sends every chunk to `fan_out` workers, and each of
// those to as many, on and on. [workers]
[[nodiscard]] std::vector<double> broadcast_seconds(std::uint64_t bytes,
                                                    const ClusterOptions& options);

[[nodiscard]] ClusterResult simulate_cluster(const ClusterWork& work,
                                             const ClusterOptions& options);

// A frame of another size and sample count from a recorded one: each of its tiles does what the
// recorded tile at the same place of the image did, with rays scaled by the number of paths, in
// waves of `paths_max`. A voxel's rays of a wave are drawn from a Poisson distribution.
struct FrameScale {
  std::uint32_t width = 3840;
  std::uint32_t height = 2160;
  std::uint32_t spp = 256;
  std::uint32_t tile_size = 32;
  std::uint64_t paths_max = 131072;
  std::uint64_t seed = 1;
};
void scale_frame(const AccessTrace& trace, const FrameScale& scale, ClusterWork& work);

}  // namespace preheat
