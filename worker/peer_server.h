// Answers the voxel requests of other workers from what this one holds, and knows who else may hold
// the voxels that it is the home of.
//
//   held        -> the bytes
//   coming here -> "later", said again and again so that the asker knows us alive; then the bytes
//   home's      -> the last worker that was given it or sent away for it; if there is none, this
//                  worker fetches it from the master for both
//   else        -> "absent"
//
// Bounds: requests of one worker that wait, requests that wait in all, the time they wait.
// Pure: time is an argument; what is to be fetched and sent is taken by the owner.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <unordered_map>
#include <utility>
#include <vector>

#include "common/clock.h"
#include "common/messages.h"
#include "common/transport.h"
#include "worker/block_shelf.h"

namespace preheat {

// A message to a worker that has asked, on the connection that it made.
struct PeerAnswer {
  SessionId to{};
  Message message{};
  Payload data{};
};

class PeerServer {
 public:
  static constexpr std::size_t kWaitingPerPeerMax = 64;
  static constexpr std::size_t kWaitingMax = 4096;

  // What this worker has to do with the voxel that is asked for.
  enum class Standing : std::uint8_t {
    kNone,
    kComing,      // it will be here without asking another worker for it
    kHome,        // this worker is its home and keeps it
    kHomeNoRoom,  // this worker is its home and only knows who holds it
  };

  explicit PeerServer(const Timers& timers) : timers_(timers) {}

  // `asker` is kNoWorker where the plan of homes does not name the session. `block_bytes` is the
  // voxel's size. True if the owner is to fetch the voxel from the master: then it is coming.
  [[nodiscard]] bool on_request(const SessionId& from, WorkerId asker, const RangeRequest& request,
                                std::uint64_t block_bytes, Standing standing, Time now);

  // It has arrived, or will not: those who wait are answered.
  void on_block(VoxelId voxel, const Payload& block);
  void on_not_coming(VoxelId voxel);
  // Who may hold a voxel that this worker is the home of.
  [[nodiscard]] WorkerId holder(VoxelId voxel) const;
  // Every voxel that is waited for.
  [[nodiscard]] std::vector<VoxelId> waited_for() const;

  // This worker is alive, but cannot tell yet what it will have.
  void say_later(const SessionId& to) { answers_.push_back({to, VoxelLater{}, {}}); }

  void tick(Time now);
  // Of the voxels that this worker is the home of from now on.
  void keep_holders(const std::function<bool(VoxelId)>& is_home);
  void reset();

  [[nodiscard]] std::vector<PeerAnswer> take_answers() { return std::exchange(answers_, {}); }
  BlockShelf& shelf() { return shelf_; }
  [[nodiscard]] const BlockShelf& shelf() const { return shelf_; }
  [[nodiscard]] std::uint64_t bytes_sent() const { return bytes_sent_; }
  [[nodiscard]] std::uint64_t refused() const { return refused_; }
  [[nodiscard]] std::size_t waiting() const { return waiting_count_; }

 private:
  using SessionKey = std::pair<std::uint64_t, std::uint64_t>;
  struct Waiting {
    SessionId from{};
    RangeRequest range{};
    Time since{};
  };

  void send_range(const SessionId& to, const RangeRequest& range, const Payload& block);
  // False if there are too many.
  bool keep_waiting(const SessionId& from, const RangeRequest& request, Time now);
  void no_longer_waiting(const Waiting& waiting);

  Timers timers_;
  BlockShelf shelf_;
  std::unordered_map<VoxelId, std::vector<Waiting>> waiting_;
  std::map<SessionKey, std::size_t> waiting_by_session_;
  std::size_t waiting_count_ = 0;
  std::unordered_map<VoxelId, WorkerId> holders_;  // of voxels that this worker is the home of
  Time later_last_{};
  std::vector<PeerAnswer> answers_;
  std::uint64_t bytes_sent_ = 0;
  std::uint64_t refused_ = 0;  // requests that no sound worker makes
};

}  // namespace preheat
