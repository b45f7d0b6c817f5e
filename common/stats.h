// What a render counted, per worker; the report adds workers up.
#pragma once

#include <algorithm>
#include <cstdint>

namespace preheat {

struct CacheStats {
  std::uint64_t limit_bytes = 0;
  std::uint64_t peak_bytes = 0;        // resident: blocks, BVHs, hot set
  std::uint64_t build_peak_bytes = 0;  // transient memory of builds, not resident
  std::uint64_t accesses = 0;          // scaled up where sampled
  std::uint64_t misses = 0;            // (ray, voxel) pairs that parked
  std::uint64_t remote_fetches = 0;    // voxels that rays waited for, from other processes
  std::uint64_t remote_bytes = 0;
  std::uint64_t rebuilds = 0;  // BVHs built while rendering from a block already held
  std::uint64_t evictions = 0;
  double stall_seconds = 0.0;  // threads without a runnable ray, summed

  // Limits and peaks: the largest; the rest: the sum.
  void add(const CacheStats& other) {
    limit_bytes = std::max(limit_bytes, other.limit_bytes);
    peak_bytes = std::max(peak_bytes, other.peak_bytes);
    build_peak_bytes = std::max(build_peak_bytes, other.build_peak_bytes);
    accesses += other.accesses;
    misses += other.misses;
    remote_fetches += other.remote_fetches;
    remote_bytes += other.remote_bytes;
    rebuilds += other.rebuilds;
    evictions += other.evictions;
    stall_seconds += other.stall_seconds;
  }
};

struct RayStats {
  std::uint64_t camera = 0;
  std::uint64_t scatter = 0;
  std::uint64_t shadow = 0;
  std::uint64_t samples_invalid = 0;  // NaN, infinite or negative samples, dropped

  [[nodiscard]] std::uint64_t total() const { return camera + scatter + shadow; }
  void add(const RayStats& other) {
    camera += other.camera;
    scatter += other.scatter;
    shadow += other.shadow;
    samples_invalid += other.samples_invalid;
  }
};

// Rays of each type that entered one voxel, or another cell that is counted in.
struct CellAccesses {
  std::uint64_t camera = 0;
  std::uint64_t scatter = 0;
  std::uint64_t shadow = 0;

  [[nodiscard]] std::uint64_t total() const { return camera + scatter + shadow; }
  void add(const CellAccesses& other) {
    camera += other.camera;
    scatter += other.scatter;
    shadow += other.shadow;
  }
};

struct PreloadStats {
  std::uint64_t voxels = 0;
  std::uint64_t bytes = 0;
  double seconds = 0.0;
};

// Where a worker's voxels came from, and what it sent to others. Remote is what rays waited for,
// preload what was fetched before they did.
struct SourceStats {
  std::uint64_t preload_peer_bytes = 0;
  std::uint64_t preload_origin_bytes = 0;
  std::uint64_t remote_peer_fetches = 0;
  std::uint64_t remote_peer_bytes = 0;  // with what came from the origin: CacheStats::remote_bytes
  std::uint64_t remote_origin_bytes = 0;
  std::uint64_t home_bytes = 0;  // fetched only to be kept for others
  std::uint64_t sent_peer_bytes = 0;
  std::uint64_t home_hits = 0;      // voxels wanted here that this worker kept as their home
  std::uint64_t peer_timeouts = 0;  // peers that were silent or too slow
  std::uint64_t peer_lies = 0;      // peers that sent wrong bytes or no sense

  void add(const SourceStats& other) {
    preload_peer_bytes += other.preload_peer_bytes;
    preload_origin_bytes += other.preload_origin_bytes;
    remote_peer_fetches += other.remote_peer_fetches;
    remote_peer_bytes += other.remote_peer_bytes;
    remote_origin_bytes += other.remote_origin_bytes;
    home_bytes += other.home_bytes;
    sent_peer_bytes += other.sent_peer_bytes;
    home_hits += other.home_hits;
    peer_timeouts += other.peer_timeouts;
    peer_lies += other.peer_lies;
  }
};

struct WorkerStats {
  std::uint64_t tiles = 0;
  RayStats rays{};
  CacheStats cache{};
  PreloadStats preload{};
  SourceStats sources{};
};

}  // namespace preheat
