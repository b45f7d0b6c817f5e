// Fetches objects of known length and hash from the master in ranges: tables, plan, voxels.
//
//   want -> waiting -> in flight (memory allocated, ranges requested) -> whole, hash checked ->
//   done
//
// One fetch per object however often it is wanted. Bounds: chunks asked for and not yet come
// (kWindowBytes), bytes of unfinished objects (kInFlightBytesMax, or one object alone), objects in
// flight. A range that stays without reply is asked for again, after pauses that double; one that
// eight later ones have overtaken got lost and is asked for at once.
// An object whose hash is wrong is fetched once more from the start; wrong again, it is damaged.
// Pure: time is an argument, requests are taken and sent by the owner.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <span>
#include <vector>

#include "common/clock.h"
#include "common/messages.h"

namespace preheat {

struct ObjectKey {
  BulkObject object = BulkObject::kTables;
  VoxelId voxel{};  // of kVoxel
  friend auto operator<=>(const ObjectKey&, const ObjectKey&) = default;
};

struct FetchedObject {
  ObjectKey key{};
  std::span<const std::byte> bytes{};  // 16-byte aligned
  std::shared_ptr<const void> owner{};
};

class Fetcher {
 public:
  static constexpr std::uint64_t kWindowBytes = 8 * kChunkBytesMax;
  static constexpr std::uint64_t kInFlightBytesMax = std::uint64_t{64} << 20;
  static constexpr std::size_t kObjectsInFlightMax = 32;

  Fetcher(Duration deadline, Duration deadline_max)
      : deadline_first_(deadline), deadline_max_(deadline_max), deadline_(deadline) {}

  // Not news if it is under way. Requires: bytes > 0.
  void want(ObjectKey key, std::uint64_t bytes, const Hash128& hash);

  // A range has come. What nobody asked for, or not so, is dropped and counted.
  void on_reply(const RangeReply& reply, std::span<const std::byte> data, Time now);

  // Ranges to ask for now.
  [[nodiscard]] std::vector<RangeRequest> take_requests(Time now);

  // Whole and sound, in order of completion.
  [[nodiscard]] std::vector<FetchedObject> take_done();

  // Came twice with a wrong hash; wanted no more.
  [[nodiscard]] std::vector<ObjectKey> take_damaged();

  // Forgets everything.
  void reset();

  [[nodiscard]] bool idle() const { return waiting_.empty() && in_flight_.empty(); }
  [[nodiscard]] std::uint64_t bytes_requested() const { return bytes_requested_; }  // outstanding
  [[nodiscard]] std::uint64_t replies_dropped() const { return replies_dropped_; }
  [[nodiscard]] std::uint64_t hash_mismatches() const { return hash_mismatches_; }
  [[nodiscard]] std::uint64_t retries() const { return retries_; }

 private:
  struct Wanted {
    ObjectKey key{};
    std::uint64_t bytes = 0;
    Hash128 hash{};
    bool failed_once = false;
  };
  struct InFlight {
    Wanted wanted{};
    std::shared_ptr<std::byte[]> bytes{};
    std::uint64_t next = 0;      // offset of the first byte never asked for
    std::uint64_t received = 0;  // bytes
  };
  struct Request {
    RangeRequest range{};
    Time sent{};
  };

  void begin_waiting();
  void ask_again_for_lost(Time now, std::vector<RangeRequest>& requests);
  void ask(const RangeRequest& range, Time now, std::vector<RangeRequest>& requests);
  void complete(std::map<ObjectKey, InFlight>::iterator object);

  Duration deadline_first_;
  Duration deadline_max_;
  Duration deadline_;  // doubles while nothing comes
  Time reply_last_{};
  std::deque<Wanted> waiting_;
  std::map<ObjectKey, InFlight> in_flight_;
  std::deque<ObjectKey> order_;  // of in_flight_: ranges of the oldest go first
  std::uint64_t in_flight_bytes_ = 0;
  std::map<std::uint64_t, Request> requests_;  // by sequence, outstanding
  std::uint64_t sequence_next_ = 0;
  std::uint64_t sequence_answered_ = 0;  // the highest
  std::uint64_t bytes_requested_ = 0;
  std::vector<FetchedObject> done_;
  std::vector<ObjectKey> damaged_;
  std::uint64_t replies_dropped_ = 0;
  std::uint64_t hash_mismatches_ = 0;
  std::uint64_t retries_ = 0;
};

}  // namespace preheat
