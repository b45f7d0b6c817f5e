// Renders one image with workers over TCP: hands out leases, serves voxels, commits tiles.
//
// The event loop owns the sockets and the film and decides nothing: the lease table and the
// scheduler are state machines of their own.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "cache/prediction.h"
#include "common/film.h"
#include "common/limits.h"
#include "common/render_settings.h"
#include "common/result.h"
#include "common/secure_transport.h"
#include "common/stats.h"
#include "common/store.h"
#include "master/render_history.h"
#include "master/render_watch.h"

namespace preheat {

// A cache size as the user says it: bytes, or a share of the scene's resident size.
struct CacheSize {
  double share = 0.25;  // used when bytes == 0
  std::uint64_t bytes = 0;
  // Never less than one voxel for a share; an absolute size below that is a usage error that
  // names the size needed.
  [[nodiscard]] Result<std::uint64_t> resolve(const SceneTables& tables) const;
};

struct MasterOptions {
  std::string listen = "tcp://127.0.0.1:*";  // control socket; the bulk socket is beside it
  unsigned workers_to_start = 2;  // child processes on loopback; 0 with an explicit --listen
  unsigned threads_per_worker = 1;
  unsigned wait_workers = 1;  // begin when this many are there
  double wait_seconds = 60.0;
  CacheSize cache{};            // of each worker that does not bring its own
  double preload_share = -1.0;  // negative = auto
  std::uint32_t tile_size = 32;
  AccessCounting count_accesses = AccessCounting::kSampled;
  std::uint32_t paths_per_thread = kPathsPerThread;  // in flight
  std::string worker_program{};                      // path of preheat-worker
  bool peers = true;                                 // workers pass voxels on to each other
  SecurityOptions security{};
  // Set from outside (SIGHUP): the allow-list is read again. nullptr = never.
  std::atomic<bool>* reload_keys = nullptr;
  std::string ledger_file{};     // one JSON line per lease, result, join and leave; empty = none
  std::string endpoint_file{};   // where workers connect to, once they can; empty = none
  RenderWatch* watch = nullptr;  // nullptr = nobody looks on
};

// For the progress line; called at most ten times a second.
struct MasterProgress {
  std::uint32_t tiles_done = 0;
  std::uint32_t tiles_total = 0;
  unsigned workers = 0;
  std::uint64_t rays = 0;
  double hit_rate = -1.0;  // negative = not known
  double seconds = 0.0;    // since the first tile was leased
};

// What the master sent of voxels: to workers that were being prepared, and to those at work.
struct OriginStats {
  std::uint64_t preload_bytes = 0;
  std::uint64_t remote_bytes = 0;
};

struct MasterResult {
  Film film;
  LeaseStats leases{};
  OriginStats origin{};
  std::vector<WorkerStats> workers{};  // by WorkerId; lost workers keep their last word
  double preload_seconds = 0.0;        // first worker accepted to first tile begun
  double render_seconds = 0.0;
  // Rays that entered each voxel, [voxel_count], scaled up where sampled; empty where not known, as
  // after a worker was lost with its counts.
  std::vector<double> accesses_by_voxel{};
  std::uint64_t connections_denied = 0;  // for their key, or for having none
  std::vector<TileId> poisoned_tiles{};  // given up and black: the program ends with kPoisonedTile
  RenderHistory history{};
};

// Blocks until the image is done, a failure, or `stop_signal` is set (by a signal handler: SIGINT
// or SIGTERM; 0 = none), which ends with kInterrupted or kTerminated. Workers are told to end
// either way.
[[nodiscard]] Result<MasterResult> run_master(
    const Store& store, const RenderSettings& settings, const Prediction& prediction,
    const MasterOptions& options, const std::atomic<int>& stop_signal,
    const std::function<void(const MasterProgress&)>& progress);

}  // namespace preheat
