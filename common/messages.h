// What master and workers say to each other: one struct per message, one variant for all.
//
// Control (small frames): Hello ... JobDone, StatusRequest, Status and PeersChanged. Bulk (chunks):
// RangeRequest ... TileChunkAck, of which RangeReply and TileChunk carry raw bytes in a frame of
// their own behind the message. Between workers: RangeRequest, RangeReply, VoxelAbsent, VoxelLater.
// A message's number on the wire is its place in `Message`: append, and raise kProtocolVersion when
// anything else changes. Every container has its bound in its type.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <variant>
#include <vector>

#include "common/ids.h"
#include "common/limits.h"
#include "common/render_settings.h"
#include "common/result.h"
#include "common/scene_tables.h"
#include "common/scene_tables_codec.h"
#include "common/stats.h"

namespace preheat {

inline constexpr std::uint16_t kProtocolVersion = 5;
inline constexpr std::size_t kControlFrameBytesMax = 64 * 1024;
inline constexpr std::size_t kChunkBytesMax = 256 * 1024;
inline constexpr std::uint64_t kTablesBytesMax = std::uint64_t{2} << 30;
inline constexpr std::size_t kPeersMax = 1000;
inline constexpr std::size_t kEndpointBytesMax = 128;
inline constexpr std::size_t kVoxelAccessesMax = 4096;  // counts in a message
inline constexpr std::size_t kLeasesPerWorkerMax = 2 * kThreadsMax + 1;

// Chosen at random by each worker process; names it on both sockets.
using SessionId = Hash128;

template <class T, std::size_t kCountMax>
struct BoundedVector {
  std::vector<T> items{};
};

template <std::size_t kBytesMax>
struct BoundedString {
  std::string text{};
};

// A worker as the others reach it.
struct PeerAddress {
  WorkerId worker = kNoWorker;
  SessionId session{};
  BoundedString<kEndpointBytesMax> endpoint{};  // empty: it serves nobody
};

enum class CacheRequestKind : std::uint8_t { kMasterDecides = 0, kShare = 1, kBytes = 2 };

// Worker -> master, first and after every Unknown: who I am and what my bits depend on.
struct Hello {
  SessionId session{};
  BoundedString<64> build{};    // program version
  BoundedString<64> isa{};      // tracing_isa()
  std::uint64_t self_test = 0;  // numeric_self_test()
  std::uint32_t threads = 1;
  CacheRequestKind cache_kind = CacheRequestKind::kMasterDecides;
  double cache_share = 0.0;
  std::uint64_t cache_bytes = 0;
  std::uint32_t process_id = 0;                      // for the log
  BoundedString<kEndpointBytesMax> peer_endpoint{};  // where it serves others; empty: it does not
};

// No voxel has this number.
inline constexpr std::uint32_t kPlanDivider = 0xFFFFFFFF;

// Master -> worker: what to render and where to fetch what it needs.
struct Welcome {
  WorkerId worker{};
  std::uint32_t bulk_port = 0;
  RenderSettings settings{};
  std::uint32_t tile_size = 0;
  AccessCounting count_accesses = AccessCounting::kNone;
  std::uint32_t paths_per_thread = kPathsPerThread;
  std::uint64_t cache_limit_bytes = 0;
  std::uint64_t tables_bytes = 0;  // SceneTables, encoded
  Hash128 tables_hash{};
  // Ids of hot voxels in order, kPlanDivider, those of warm ones; u32 little-endian.
  std::uint64_t plan_bytes = 0;
  Hash128 plan_hash{};
  std::uint64_t home_bytes = 0;  // of the cache: raw blocks of the voxels it is the home of
  PeerAddress parent{};          // passes the hot voxels on; kNoWorker: the master sends them
};

// Master -> worker: go away. The worker exits with `exit_code`.
struct Refuse {
  std::uint8_t exit_code = 0;
  BoundedString<1024> text{};
};

// Master -> worker: I do not know you (any more): say Hello. Your leases are not yours now.
struct Unknown {};

// Worker -> master: the hot set is built, tiles can come.
struct Ready {
  PreloadStats preload{};
};

struct Lease {
  LeaseId id{};
  TileId tile{};
  friend bool operator==(const Lease&, const Lease&) = default;
};

// Master -> worker: render these, in this order. A lease that the worker holds already is not news.
struct Grant {
  BoundedVector<Lease, kLeasesPerWorkerMax> leases{};
};

// Master -> worker: these need not be rendered any more, if not begun.
struct Cancel {
  BoundedVector<Lease, kLeasesPerWorkerMax> leases{};
};

// Master -> worker: the result was taken or is not wanted; forget it.
struct ResultAck {
  LeaseId lease{};
};

// Worker -> master: alive, and how far. A lease of the master's that is not in `held` got lost on
// the way and is granted again.
struct WorkerHeartbeat {
  std::uint64_t progress = 0;  // Renderer::progress()
  WorkerStats stats{};
  BoundedVector<Lease, kLeasesPerWorkerMax> held{};  // until acknowledged
  std::uint32_t homes_version = 0;                   // of the plan of homes that it follows
};

struct MasterHeartbeat {
  std::uint32_t tiles_done = 0;
  std::uint32_t tiles_total = 0;
};

enum class FaultKind : std::uint8_t {
  kWorkerFailed = 0,
  kVoxelDamaged = 1  // `voxel` came twice with another hash than the tables say
};

// Worker -> master: something that a worker cannot mend.
struct Fault {
  FaultKind kind = FaultKind::kWorkerFailed;
  VoxelId voxel{};
  BoundedString<1024> text{};
};

// Worker -> master: I leave; my leases are yours again and these are my final counts.
struct Goodbye {
  WorkerStats stats{};
};

// Master -> worker: nothing is left to do. Answered by Goodbye.
struct JobDone {};

enum class BulkObject : std::uint8_t { kTables = 0, kPlan = 1, kVoxel = 2, kHomes = 3 };

// Worker -> master or peer: `bytes` of an object from `offset` on, at most kChunkBytesMax.
struct RangeRequest {
  BulkObject object = BulkObject::kTables;
  VoxelId voxel{};  // of kVoxel; of kHomes the version
  std::uint64_t offset = 0;
  std::uint32_t bytes = 0;
  friend bool operator==(const RangeRequest&, const RangeRequest&) = default;
};

// The answer, with the bytes behind it.
struct RangeReply {
  BulkObject object = BulkObject::kTables;
  VoxelId voxel{};
  std::uint64_t offset = 0;
};

// Worker -> master, with the bytes behind it: a part of a tile's pixels, rgb then variance as float
// little-endian. `hash` is of the whole.
struct TileChunk {
  LeaseId lease{};
  TileId tile{};
  std::uint64_t offset = 0;
  std::uint64_t total_bytes = 0;
  Hash128 hash{};
};

// Master -> worker: one chunk has arrived; its credit returns.
struct TileChunkAck {
  LeaseId lease{};
  std::uint64_t offset = 0;
};

// Who asks for the status -> master, at any time, without a Hello.
struct StatusRequest {};

enum class JobPhase : std::uint8_t { kWaiting = 0, kRendering = 1, kFarewell = 2, kOver = 3 };

// Master -> who asked.
struct Status {
  BoundedString<64> build{};
  JobPhase phase = JobPhase::kWaiting;
  std::uint32_t tiles_done = 0;
  std::uint32_t tiles_total = 0;
  std::uint32_t workers = 0;        // here now
  std::uint32_t workers_ready = 0;  // of these, with their voxels preloaded
  std::uint32_t workers_lost = 0;   // so far, without a Goodbye
  std::uint64_t leases_expired = 0;
  std::uint64_t rays = 0;
  std::uint64_t accesses = 0;
  std::uint64_t misses = 0;
  double waiting_seconds = 0.0;    // since the master listens, until the first lease
  double rendering_seconds = 0.0;  // since the first lease
};

// Worker -> master, answering JobDone before the Goodbye: how many rays entered the voxels from
// `first` on, as counted, voxel by voxel and in order until each has been told.
struct VoxelAccesses {
  std::uint32_t first = 0;
  BoundedVector<std::uint64_t, kVoxelAccessesMax> counts{};
};

// Master -> worker: there is a new plan of homes to fetch (home_plan.h).
struct PeersChanged {
  std::uint32_t version = 0;
  std::uint64_t bytes = 0;
  Hash128 hash{};
};

// Worker -> worker: I do not hold it; `holder`, if any, may.
struct VoxelAbsent {
  VoxelId voxel{};
  WorkerId holder = kNoWorker;
};

// Worker -> worker: what you asked for is on its way to me; so long as I say this I am alive.
struct VoxelLater {};

using Message = std::variant<Hello, Welcome, Refuse, Unknown, Ready, Grant, Cancel, ResultAck,
                             WorkerHeartbeat, MasterHeartbeat, Fault, Goodbye, JobDone,
                             RangeRequest, RangeReply, TileChunk, TileChunkAck, StatusRequest,
                             Status, VoxelAccesses, PeersChanged, VoxelAbsent, VoxelLater>;

}  // namespace preheat
