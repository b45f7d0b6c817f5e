// Fetches objects of known length and hash in ranges: tables and plans from the master, voxels from
// their home, then from another holder, then from the master, which is the origin of them all.
//
//   want -> waiting -> in flight at one source (memory allocated, ranges requested) -> whole, hash
//   checked -> done
//
// One fetch per object however often it is wanted. Bounds: chunks asked of one source and not yet
// come (kWindowBytes), bytes of unfinished objects (kInFlightBytesMax, or one object alone),
// objects in flight.
//
// A peer fails when it says nothing for its deadline, or when one request stays open for as long as
// the master itself would be given: what it was asked for goes to the next source from the
// beginning, and the peer is left alone for a time that doubles with every failure. A peer that
// sends wrong bytes or no sense is never asked again in this job. So one object has one sender, and
// the sender of wrong bytes is known.
//
// A range that stays without the master's reply is asked for again, after pauses that double; one
// that eight later ones have overtaken got lost and is asked for at once. An object whose hash is
// wrong from the master is fetched once more; wrong again, it is damaged.
// Pure: time is an argument, requests are taken and sent by the owner.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <set>
#include <span>
#include <vector>

#include "common/clock.h"
#include "common/messages.h"

namespace preheat {

// The master, where a source is named by a worker's id.
inline constexpr WorkerId kOrigin = kNoWorker;

struct ObjectKey {
  BulkObject object = BulkObject::kTables;
  VoxelId voxel{};  // of kVoxel; of kHomes the version
  friend auto operator<=>(const ObjectKey&, const ObjectKey&) = default;
};

struct FetchedObject {
  ObjectKey key{};
  std::span<const std::byte> bytes{};  // 16-byte aligned
  std::shared_ptr<const void> owner{};
  WorkerId source = kOrigin;
};

struct SourcedRequest {
  WorkerId source = kOrigin;
  RangeRequest range{};
};

class Fetcher {
 public:
  static constexpr std::uint64_t kWindowBytes = 8 * kChunkBytesMax;
  static constexpr std::uint64_t kInFlightBytesMax = std::uint64_t{64} << 20;
  static constexpr std::size_t kObjectsInFlightMax = 32;
  static constexpr std::size_t kPeersPerObjectMax = 2;  // its home and another holder
  // What nobody asked for, from one peer without a good reply between: late replies are fewer.
  static constexpr std::uint32_t kUnaskedMax = 4 * kObjectsInFlightMax;

  explicit Fetcher(const Timers& timers) : timers_(timers), deadline_(timers.fetch) {}

  // Not news if it is under way. `peers` are tried in their order, then the master.
  // Requires: bytes > 0.
  void want(ObjectKey key, std::uint64_t bytes, const Hash128& hash,
            std::vector<WorkerId> peers = {});
  // It is wanted no more.
  void forget(ObjectKey key);

  // A range has come. What nobody asked for, or not so, is dropped and counted.
  void on_reply(WorkerId source, const RangeReply& reply, std::span<const std::byte> data,
                Time now);
  // The peer does not hold it; `holder` may.
  void on_absent(WorkerId peer, ObjectKey key, WorkerId holder, Time now);
  // The peer is alive and waits for it itself.
  void on_later(WorkerId peer, Time now);
  // The peer sent what is not a message of ours.
  void on_nonsense(WorkerId peer, Time now);
  // Others than these are gone: what they were asked for goes elsewhere.
  void keep_peers(const std::set<WorkerId>& present, Time now);

  // Ranges to ask for now.
  [[nodiscard]] std::vector<SourcedRequest> take_requests(Time now);

  // Whole and sound, in order of completion.
  [[nodiscard]] std::vector<FetchedObject> take_done();

  // Came twice with a wrong hash from the master; wanted no more.
  [[nodiscard]] std::vector<ObjectKey> take_damaged();

  // Forgets everything, also what it thinks of peers.
  void reset() { *this = Fetcher(timers_); }

  // Under way, and from the master: it will come, whatever other peers do.
  [[nodiscard]] bool is_coming_from_origin(ObjectKey key) const;
  [[nodiscard]] bool may_ask(WorkerId peer, Time now) const;
  [[nodiscard]] bool is_banned(WorkerId peer) const;
  [[nodiscard]] bool idle() const { return known_.empty(); }
  [[nodiscard]] std::uint64_t bytes_requested() const;  // outstanding
  [[nodiscard]] std::uint64_t bytes_requested(WorkerId source) const;
  [[nodiscard]] std::uint64_t replies_dropped() const { return replies_dropped_; }
  [[nodiscard]] std::uint64_t hash_mismatches() const { return hash_mismatches_; }
  [[nodiscard]] std::uint64_t retries() const { return retries_; }
  [[nodiscard]] std::uint64_t peer_timeouts() const { return peer_timeouts_; }
  [[nodiscard]] std::uint64_t peer_lies() const { return peer_lies_; }

 private:
  struct Wanted {
    ObjectKey key{};
    std::uint64_t bytes = 0;
    Hash128 hash{};
    std::vector<WorkerId> peers{};
    std::size_t peers_tried = 0;
    bool failed_once = false;  // its hash, from the master
  };
  struct InFlight {
    Wanted wanted{};
    WorkerId source = kOrigin;
    std::shared_ptr<std::byte[]> bytes{};
    std::uint64_t next = 0;      // offset of the first byte never asked for
    std::uint64_t received = 0;  // bytes
  };
  struct Request {
    WorkerId source = kOrigin;
    RangeRequest range{};
    Time sent{};
  };
  struct Peer {
    Time heard{};
    Duration deadline{};
    Duration pause{};
    Time paused_until{};
    bool banned = false;
    std::uint32_t unasked = 0;
  };
  enum class Failure : std::uint8_t { kSlow, kLie, kGone };

  void begin_waiting(Time now);
  void fail_late_peers(Time now);
  void fail(WorkerId peer, Failure failure, Time now);
  // Starts again at the next source.
  void move_on(InFlight& object, Time now);
  void choose_source(InFlight& object, Time now);
  void ask_origin_again(Time now, std::vector<SourcedRequest>& requests);
  void ask(WorkerId source, const RangeRequest& range, Time now,
           std::vector<SourcedRequest>& requests);
  void erase_requests(ObjectKey key);
  std::map<std::uint64_t, Request>::iterator erase_request(
      std::map<std::uint64_t, Request>::iterator request);
  void complete(std::map<ObjectKey, InFlight>::iterator object, Time now);
  void remove(std::map<ObjectKey, InFlight>::iterator object);
  Peer& heard_from(WorkerId peer, Time now);
  void drop_reply(WorkerId source, Time now);

  Timers timers_;
  Duration deadline_;          // the master's; doubles while nothing comes
  Time reply_last_{};          // of the master
  std::set<ObjectKey> known_;  // waiting or in flight
  std::deque<Wanted> waiting_;
  std::map<ObjectKey, InFlight> in_flight_;
  std::deque<ObjectKey> order_;  // of in_flight_: ranges of the oldest go first
  std::uint64_t in_flight_bytes_ = 0;
  std::map<std::uint64_t, Request> requests_;  // by sequence, outstanding
  std::uint64_t sequence_next_ = 0;
  std::uint64_t sequence_answered_ = 0;                // the master's highest
  std::map<WorkerId, std::uint64_t> bytes_requested_;  // by source
  std::map<WorkerId, Peer> peers_;                     // asked at least once
  std::vector<FetchedObject> done_;
  std::vector<ObjectKey> damaged_;
  std::uint64_t replies_dropped_ = 0;
  std::uint64_t hash_mismatches_ = 0;
  std::uint64_t retries_ = 0;
  std::uint64_t peer_timeouts_ = 0;
  std::uint64_t peer_lies_ = 0;
};

}  // namespace preheat
