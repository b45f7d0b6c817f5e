// What a worker says and does, from Hello to Goodbye: the protocol's other end is master/job.h.
//
//   greeting -> fetching tables and plan -> preloading -> rendering -> over
//
// A master that forgot this worker is greeted again, and if the job is still the same nothing is
// fetched twice; another job starts from nothing. Tiles whose leases were lost but that may be
// under way already are finished and sent: the master compares them. Pure: no socket, thread or
// clock. Messages go in, messages and actions come out.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "cache/renderer.h"
#include "common/clock.h"
#include "common/codec.h"
#include "common/home_plan.h"
#include "common/outgoing.h"
#include "worker/fetcher.h"
#include "worker/peer_server.h"
#include "worker/result_sender.h"

namespace preheat {

// What the owner is to do, in order.
struct ConnectBulk {
  std::uint16_t port = 0;
};
// To ask it for voxels, and when it is not asked any more.
struct ConnectPeer {
  PeerAddress peer{};
};
struct DisconnectPeer {
  SessionId session{};
};
struct StartRenderer {
  SceneTables tables{};
  RenderSettings settings{};
  RendererOptions options{};
};
struct SetHotVoxels {
  std::vector<VoxelId> voxels{};
  std::vector<VoxelId> warm{};
};
struct DeliverVoxel {
  VoxelId voxel{};
  VoxelBytes bytes{};
};
struct AddTile {
  TileId tile{};
};
struct CancelTile {
  TileId tile{};
};
// Answered by on_accesses().
struct TellAccesses {};
// Send what is to be sent, then end the process.
struct Finish {
  ExitCode code = ExitCode::kDone;
  std::string text{};
  // It was not sent away: the next master at this address may want it.
  bool next_master = false;
};
using WorkerAction =
    std::variant<ConnectBulk, ConnectPeer, DisconnectPeer, StartRenderer, SetHotVoxels,
                 DeliverVoxel, AddTile, CancelTile, TellAccesses, Finish>;

// What the renderer has done so far; told before anything that may say so to the master.
struct RendererCounts {
  std::uint64_t progress = 0;
  WorkerStats stats{};
};

class WorkerSession {
 public:
  WorkerSession(Hello hello, const Timers& timers, Duration give_up, Time now);

  // Connections to other workers at a time; the one used longest ago is closed for a new one.
  static constexpr std::size_t kPeersConnectedMax = 64;

  void set_counts(const RendererCounts& counts);
  [[nodiscard]] const RendererCounts& counts() const { return counts_; }
  void on_control(const Envelope& frame, Time now);
  void on_bulk(const Envelope& frame, const Payload& data, Time now);
  // From a worker that this one asks, and that sent what is not a frame of ours.
  void on_peer_answer(const SessionId& from, const Envelope& frame, const Payload& data, Time now);
  void on_peer_nonsense(const SessionId& from, Time now);
  // From a worker that asks this one.
  void on_peer_request(const SessionId& from, const Envelope& frame, Time now);
  // A frame of ours in another version: the other program is newer or older.
  void on_other_version(std::uint16_t version);
  // How connecting to the master goes.
  void on_handshakes(const Handshakes& handshakes);
  void on_hot_set_ready(const PreloadStats& preload);
  void on_voxel_needed(const VoxelNeeded& needed);
  void on_voxel_malformed(VoxelId voxel, const std::string& reason);
  void on_tile_done(const TileDone& done, Time now);
  void on_renderer_failed(const Error& error);
  // Renderer::accesses_by_cell(), once all is rendered.
  void on_accesses(std::span<const CellAccesses> accesses);
  // By a signal: hands the leases back.
  void leave(ExitCode code);
  void tick(Time now);

  [[nodiscard]] std::vector<Outgoing> take_outgoing() { return std::exchange(outgoing_, {}); }
  // To workers that have asked this one; what take_outgoing() has for kPeer goes to those it asks.
  [[nodiscard]] std::vector<PeerAnswer> take_answers() { return server_.take_answers(); }
  [[nodiscard]] std::vector<WorkerAction> take_actions() { return std::exchange(actions_, {}); }
  [[nodiscard]] const JobKey& job() const { return job_; }
  [[nodiscard]] bool over() const { return phase_ == Phase::kOver; }

 private:
  enum class Phase : std::uint8_t { kGreeting, kPreparing, kRendering, kOver };

  void say_hello(Time now);
  void handle(const Welcome& welcome, const JobKey& job, Time now);
  void handle(const Unknown& unknown, Time now);
  void handle(const Grant& grant, Time now);
  void handle(const Cancel& cancel, Time now);
  void handle(const ResultAck& ack, Time now);
  void handle(const Refuse& refuse, Time now);
  void handle(const JobDone& done, Time now);
  void handle(const PeersChanged& changed, Time now);
  template <class Other>
  void handle(const Other&, Time) {}  // MasterHeartbeat, and what a master does not say

  static constexpr std::size_t kEarlyRequestsMax = 256;

  // A request of another worker, come before this one knows what it will hold.
  struct EarlyRequest {
    SessionId from{};
    JobKey job{};
    RangeRequest range{};
  };
  using SessionKey = std::pair<std::uint64_t, std::uint64_t>;

  void begin_job(const Welcome& welcome, const JobKey& job);
  void take_fetched(Time now);
  void take_tables(const FetchedObject& object, Time now);
  void take_plan(const FetchedObject& object, Time now);
  void begin_preload(SetHotVoxels hot, Time now);
  void take_homes(const FetchedObject& object, Time now);
  void take_voxel(const FetchedObject& object);
  void take_hot_voxel(VoxelId voxel, const Payload& block);
  // `needed`: by the renderer, and whether rays wait.
  void count_voxel(const FetchedObject& object, std::optional<bool> needed);
  void want_homes();
  void want_voxel(VoxelId voxel, std::vector<WorkerId> peers);
  void answer_peer(const SessionId& from, const RangeRequest& range, Time now);
  [[nodiscard]] PeerServer::Standing standing(VoxelId voxel) const;
  [[nodiscard]] bool is_own_home(VoxelId voxel) const;
  [[nodiscard]] bool serves_peers() const { return !hello_.peer_endpoint.text.empty(); }
  void know_peers(Time now);
  void ask_peer(WorkerId peer, const RangeRequest& range, Time now);
  void disconnect_peer(WorkerId peer);
  void disconnect_liars();
  void serve_peers(Time now);
  void send_heartbeat(Time now);
  void send(ChannelKind channel, Message message, Payload data = {});
  void part();  // the job is done
  void fault(FaultKind kind, VoxelId voxel, const std::string& text);
  void finish(ExitCode code, std::string text, bool next_master = false);

  Hello hello_;
  Timers timers_;
  Duration give_up_;
  Phase phase_ = Phase::kGreeting;
  Time heard_last_;
  Time hello_last_{};
  Time heartbeat_last_{};
  Time tick_last_;
  Time waiting_told_;
  bool tile_done_since_heartbeat_ = false;
  std::uint64_t handshakes_broken_ = 0;
  JobKey job_{};
  Welcome welcome_{};
  bool hot_ready_ = false;
  PreloadStats preload_{};
  RendererCounts counts_{};
  Fetcher fetcher_;
  PeerServer server_;
  ResultSender results_;
  struct VoxelName {
    std::uint32_t block_bytes = 0;
    std::uint64_t hot_bytes = 0;
    Hash128 hash{};
  };
  std::vector<VoxelName> voxels_;  // [voxel_count]
  bool hot_known_ = false;         // which voxels are hot
  std::vector<bool> hot_missing_;  // [voxel_count]
  std::size_t hot_missing_count_ = 0;
  std::uint64_t hot_resident_bytes_ = 0;
  std::uint64_t hot_arrived_bytes_ = 0;
  std::uint64_t preparing_bytes_peak_ = 0;  // of hot blocks, BVH and what is kept for others
  std::map<VoxelId, bool> needed_;          // by the renderer; true: rays wait
  SourceStats sources_{};
  std::uint64_t remote_fetches_ = 0;
  HomePlan homes_{};
  std::uint32_t homes_version_ = 0;
  std::optional<PeersChanged> homes_announced_{};  // and not fetched yet
  std::map<WorkerId, PeerAddress> peers_;          // that can be asked
  std::map<SessionKey, WorkerId> peer_by_session_;
  struct Connected {
    SessionId session{};
    Time asked_last{};
  };
  std::map<WorkerId, Connected> connected_;
  std::vector<EarlyRequest> early_;
  Time early_told_{};
  std::map<TileId, Lease> leases_;   // to be rendered
  std::map<TileId, Lease> orphans_;  // lost, perhaps under way
  std::vector<Outgoing> outgoing_;
  std::vector<WorkerAction> actions_;
};

}  // namespace preheat
