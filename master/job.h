// One image's job from the first Hello to the last Goodbye: who is here, who renders what, what has
// arrived. The protocol's other end is worker/worker_session.h.
//
//   waiting for workers -> rendering -> farewell -> over
//
// Pure: no socket, thread or clock. Messages go in, messages come out; the lease table decides on
// tiles, the voxel server on bytes.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "common/clock.h"
#include "common/codec.h"
#include "common/film.h"
#include "common/outgoing.h"
#include "master/lease_table.h"
#include "master/master.h"
#include "master/render_history.h"
#include "master/render_watch.h"
#include "master/voxel_server.h"

namespace preheat {

// What a worker of some cache size is told to hold.
struct WorkerPlan {
  std::uint64_t cache_limit_bytes = 0;
  std::uint64_t home_bytes = 0;  // of it, for blocks that it is the home of
  std::shared_ptr<const EncodedPlan> hot{};
};

// What the job needs to know of the scene.
struct JobScene {
  std::span<const std::byte> tables{};
  Hash128 tables_hash{};
  VoxelServer server;
  std::function<bool(VoxelId)> block_is_intact{};
  // The error is told to the worker, which then cannot take part.
  std::function<Result<WorkerPlan>(const CacheSize&)> plan{};
  std::vector<VoxelEntry> voxels{};
  std::vector<double> fetches{};  // [voxel_count] expected, for the plan of homes
};

struct JobOptions {
  JobKey key{};
  RenderSettings settings{};
  std::uint32_t tile_size = 32;
  AccessCounting count_accesses = AccessCounting::kSampled;
  std::uint32_t paths_per_thread = kPathsPerThread;
  CacheSize cache{};  // of workers that do not bring their own
  std::uint16_t bulk_port = 0;
  unsigned wait_workers = 1;
  Duration wait = std::chrono::seconds(60);
  std::string address{};  // of the control socket, for messages
  std::string build{};
  std::string isa{};
  std::uint64_t self_test = 0;
  Timers timers{};
  bool peers = true;                                 // workers pass voxels on to each other
  bool reach_settled = false;                        // also on addresses that are not loopback
  std::uint64_t seed = 0;                            // of the lease ids
  std::function<void(const std::string&)> ledger{};  // one JSON line per event; may be empty
  RenderWatch* watch = nullptr;                      // told of tiles; nullptr = nobody looks on
};

class Job {
 public:
  Job(JobOptions options, JobScene scene, Time now);

  void on_control(const SessionId& from, const Envelope& frame, Time now);
  void on_bulk(const SessionId& from, const Envelope& frame, const Payload& data, Time now);
  // A frame of ours in another protocol version.
  void on_other_version(const SessionId& from, std::uint16_t version);
  // The connection to a worker is no more.
  void on_gone(const SessionId& session, Time now);
  // A child of ours has ended; `left` children still run.
  void on_child_ended(std::uint32_t process_id, const std::string& how, std::size_t left, Time now);
  void tick(Time now);
  // By a signal: tells the workers.
  void stop(ExitCode code, Time now);

  [[nodiscard]] std::vector<Outgoing> take_outgoing() { return std::exchange(outgoing_, {}); }
  [[nodiscard]] const JobKey& key() const { return options_.key; }
  [[nodiscard]] bool over() const { return phase_ == Phase::kOver; }
  [[nodiscard]] MasterProgress progress(Time now) const;
  [[nodiscard]] Status status(Time now) const;
  [[nodiscard]] RenderSnapshot snapshot(Time now) const;
  // Requires: over(). Once.
  [[nodiscard]] Result<MasterResult> take_result();

 private:
  static constexpr std::size_t kWorkersMax = 1000;    // at once
  static constexpr std::size_t kSessionsMax = 16384;  // ever
  static constexpr std::size_t kChildrenMax = 2;      // of a worker that passes the hot set on

  using Phase = JobPhase;
  enum class Presence : std::uint8_t { kPreparing, kReady, kAbsent };

  // A tile's bytes as they come in.
  struct Assembly {
    std::vector<std::byte> bytes{};
    std::vector<bool> arrived{};  // [chunk_count]
    std::size_t missing = 0;
  };
  struct Worker {
    WorkerId id{};
    SessionId session{};
    Presence presence = Presence::kPreparing;
    std::uint32_t process_id = 0;
    std::size_t threads = 1;
    WorkerPlan plan{};
    WorkerStats stats{};
    std::uint64_t progress = 0;
    std::vector<std::uint64_t> accesses{};  // of the first voxels, as far as it has told them
    bool stalled = false;                   // a lease expired and the renderer has not moved since
    Time heard_last{};
    std::map<LeaseId, Assembly> assemblies{};
    PeerAddress peer{};               // without an endpoint: it serves nobody
    WorkerId parent = kNoWorker;      // sends it the hot voxels
    std::size_t children = 0;         // that it was named to as their parent
    std::uint32_t homes_version = 0;  // as of its last heartbeat
    Time homes_told{};
  };
  using Clocked = std::pair<Worker&, Time>;

  void handle_hello(const SessionId& from, const Hello& hello, Time now);
  [[nodiscard]] std::optional<Refuse> objection(const Hello& hello) const;
  void handle(Worker& worker, const Ready& ready, Time now);
  void handle(Worker& worker, const WorkerHeartbeat& heartbeat, Time now);
  void handle(Worker& worker, const Fault& fault, Time now);
  void handle(Worker& worker, const Goodbye& goodbye, Time now);
  void handle(Worker& worker, const VoxelAccesses& told, Time now);
  template <class Other>
  void handle(Worker&, const Other&, Time) {}  // what a worker does not say
  void take_chunk(Worker& worker, const TileChunk& chunk, std::span<const std::byte> data,
                  Time now);
  void take_tile(Worker& worker, const TileChunk& chunk, const Assembly& assembly, Time now);

  void welcome(const Worker& worker);
  [[nodiscard]] PeerAddress peer_address(const Worker& worker, const Hello& hello) const;
  // The hot set travels down a tree of the workers that are being prepared at the same time: the
  // first takes it from here, so that each wave of newcomers costs one stream of it.
  [[nodiscard]] Worker* find_parent(const Worker& child);
  void plan_homes(Time now);
  void tell_homes(Worker& worker, Time now);
  // So many tiles that the worker's paths in flight never run short, for rays of all of them share
  // the visits of a voxel; towards the frame's end no more than half of its share of the rest, so
  // that nobody waits for one who took too many.
  [[nodiscard]] std::size_t leases_wanted(const Worker& worker, std::size_t ready) const;
  [[nodiscard]] std::size_t ready_count() const;
  // Empty unless every worker that rendered a tile has told all of its own.
  [[nodiscard]] std::vector<double> accesses_by_voxel() const;
  void expel(Worker& worker, const Refuse& reason, Time now);
  // A worker that is silent may be stopped or cut off; only one that is seen to end may have been
  // killed by its tile.
  enum class Loss : std::uint8_t { kSilent, kDied };
  void lose(Worker& worker, Loss loss, const char* why, Time now);
  void grant_to(Worker& worker, std::size_t ready, Time now);
  void grant_to_all(Time now);
  // Who has nothing to do takes a tile of who will be done last.
  void double_last_tiles(Time now);
  [[nodiscard]] bool may_be_granted(const Worker& worker, Time now) const;
  void send_grant(const Worker& worker, Grant grant, Time now);
  void watch_workers(Time now);
  void watch_leases(Time now);
  void watch_phase(Time now);
  void begin_farewell(Time now);
  void fail_job(Error error, Time now);

  [[nodiscard]] Worker* find(const SessionId& session);
  [[nodiscard]] std::size_t present() const;
  void send(const Worker& worker, ChannelKind channel, Message message, Payload data = {});
  template <class... Values>
  void note(const char* format, const Values&... values);

  JobOptions options_;
  JobScene scene_;
  TileGrid grid_;
  LeaseTable leases_;
  Film film_;
  Phase phase_ = Phase::kWaiting;
  std::optional<Error> error_;
  std::vector<std::unique_ptr<Worker>> workers_;  // by WorkerId
  std::map<std::pair<std::uint64_t, std::uint64_t>, WorkerId> by_session_;
  std::vector<Outgoing> outgoing_;
  std::uint32_t workers_lost_ = 0;
  Time begin_;
  Time tick_last_;
  Time heartbeat_last_;
  Time waiting_since_;
  Time waiting_told_;
  Time farewell_begin_{};
  bool homes_stale_ = false;  // the workers are others than those of the plan
  Time homes_planned_{};
  std::uint32_t homes_version_ = 0;
  std::shared_ptr<const EncodedPlan> homes_{};
  std::vector<WorkerId> home_of_{};  // [voxel_count] as planned last; empty before
  OriginStats origin_{};
  std::optional<std::size_t> children_left_;  // nothing if this job has no children
  std::optional<Time> first_worker_;
  std::optional<Time> first_lease_;
  HistoryRecorder history_;
  Time last_commit_{};
};

}  // namespace preheat
