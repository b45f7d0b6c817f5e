// Who renders which tile until when, and which result counts: tiles are executed at least once and
// committed exactly once.
//
// A lease is granted to one worker until a deadline that its progress moves on. A lease that ends
// without a result gives its tile back, but is remembered: its result may still come, is the first
// one and commits, or is compared with the committed one and dropped. Once no tile is pending, the
// last ones may be leased to a second worker that has nothing else to do. Two different results for
// one tile make the tile disputed: a third worker renders it again and the majority stays.
//
// Many tiles are with a worker when it dies, whatever it died of. A tile with two deaths is leased
// to a worker that has no other, and one that two workers died on alone is poisoned and given up.
//
// Pure: time is an argument, lease ids come from a seeded generator.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <optional>
#include <random>
#include <unordered_map>
#include <unordered_set>
#include <vector>

#include "common/clock.h"
#include "common/messages.h"
#include "common/render_settings.h"
#include "master/master.h"
#include "master/tile_scheduler.h"

namespace preheat {

enum class ResultOutcome : std::uint8_t {
  kCommitted,  // the first result of its tile
  kReplaced,   // settles a dispute against the committed one: take this one's pixels
  kDuplicate,  // equal to the committed one
  kMismatch,   // differs from the committed one, which stays
  kUnknown     // no lease of this worker's: neither looked at nor counted
};

struct LeaseVerdict {
  ResultOutcome outcome = ResultOutcome::kUnknown;
  // Other leases of the same tile that are pointless now, and whose they are.
  std::vector<std::pair<WorkerId, Lease>> cancelled{};
};

class LeaseTable {
 public:
  LeaseTable(const TileGrid& grid, Duration lease_min, std::uint64_t seed);

  // A worker may hold leases from now on. Not news if it may already; if it was thought dead, no
  // tile killed it, and one that was given up for that is pending again.
  void add_worker(WorkerId worker);
  // It left in good order, or it died: its tiles are pending again. Returns the tiles that are
  // poisoned by this death.
  void remove_worker(WorkerId worker);
  std::vector<TileId> worker_died(WorkerId worker);

  // Leases one more tile to the worker; nothing if none is pending for it. Requires: add_worker.
  [[nodiscard]] std::optional<Lease> grant(WorkerId worker, Time now);

  // Once no tile is pending: those that only one worker has, the one that is expected last first.
  [[nodiscard]] std::vector<TileId> last_tiles(Time now) const;
  // Leases such a tile to one more worker, whoever is first; nothing if it is not expected to be,
  // or may not have it.
  [[nodiscard]] std::optional<Lease> grant_second(WorkerId worker, TileId tile, Time now);

  // The worker's renderer moved on: its deadlines do too.
  void progress(WorkerId worker, Time now);

  // Ends the leases whose deadline has passed.
  std::vector<std::pair<WorkerId, Lease>> expire(Time now);

  // The master itself stood still: no deadline counts that time.
  void extend_all(Duration gap);

  // A whole and sound result has arrived. Whoever sent it, a lease id is good once.
  [[nodiscard]] LeaseVerdict result(WorkerId worker, LeaseId lease, const Hash128& hash, Time now);

  // The tile of a lease that this worker holds or held, if its result is still of interest.
  [[nodiscard]] std::optional<TileId> tile_of(WorkerId worker, LeaseId lease) const;

  // The worker's live leases.
  [[nodiscard]] std::vector<Lease> held_by(WorkerId worker) const;
  [[nodiscard]] std::size_t held_count(WorkerId worker) const;
  // When a live lease was granted.
  [[nodiscard]] std::optional<Time> granted_at(LeaseId lease) const;

  [[nodiscard]] std::uint32_t tiles_committed() const { return tiles_committed_; }
  [[nodiscard]] const std::vector<TileId>& poisoned() const { return poisoned_; }
  // Every tile is committed or poisoned, and no dispute is left that a present worker could settle.
  [[nodiscard]] bool finished() const;
  [[nodiscard]] const LeaseStats& stats() const { return stats_; }
  [[nodiscard]] Duration lease_length() const;

 private:
  // A tile that was with so many workers when they died is suspect: it is leased alone.
  static constexpr std::size_t kDeathsSuspect = 2;
  // After so many deaths, so many of them alone with it, it is poisoned. Workers that die for
  // reasons of their own take many tiles with them, and a suspect one at times; hardly twice.
  static constexpr std::size_t kDeathsMax = 3;
  static constexpr std::size_t kDeathsAloneMax = 2;
  static constexpr std::size_t kDurationsKept = 256;

  struct Record {
    TileId tile{};
    WorkerId worker{};
    Time granted{};
    Time deadline{};
    std::uint64_t number = 0;  // in the order of grants
    bool live = true;          // false: its tile was given back, its result may still come
  };
  struct TileState {
    bool committed = false;
    bool poisoned = false;
    WorkerId worker{};            // of the committed result
    Hash128 hash{};               // of the committed result
    std::vector<LeaseId> live{};  // at most 2
  };
  struct Holder {
    std::optional<Time> begin{};  // of its first lease since it is here
    std::uint32_t results = 0;
    std::unordered_set<LeaseId> live{};
    // From one result to the next.
    [[nodiscard]] Duration tile_length(Time now) const {
      return begin ? (now - *begin) / std::max(1U, results) : Duration{};
    }
    // Until its last tile is done.
    [[nodiscard]] Duration time_left(Time now) const {
      return tile_length(now) * static_cast<int>(live.size());
    }
  };
  struct Death {
    WorkerId worker{};
    bool alone = false;  // it held no other tile
  };
  struct Dispute {
    std::array<WorkerId, 2> workers{};  // who said what is committed, who said otherwise
    Hash128 other{};
  };

  void end_live(LeaseId lease);  // Requires: live. Its tile is pending again unless settled.
  Lease add_lease(WorkerId worker, TileId tile, Time now);
  [[nodiscard]] bool may_lease(WorkerId worker, TileId tile) const;
  [[nodiscard]] bool holds_suspect(const Holder& holder) const;
  [[nodiscard]] bool is_last(TileId tile) const;
  [[nodiscard]] bool is_suspect(TileId tile) const;
  [[nodiscard]] bool is_deadly(TileId tile) const;
  void keep_duration(Duration duration);
  [[nodiscard]] ResultOutcome judge(WorkerId worker, TileId tile, const Hash128& hash);

  Duration lease_min_;
  std::mt19937_64 random_;
  TileScheduler scheduler_;
  std::vector<TileState> tiles_;  // [tile_count]
  std::unordered_map<LeaseId, Record> leases_;
  std::unordered_map<WorkerId, Holder> holders_;
  std::unordered_map<TileId, std::vector<Death>> deaths_;  // of different workers
  std::unordered_map<TileId, Dispute> disputes_;
  std::vector<TileId> poisoned_;
  std::uint32_t tiles_committed_ = 0;
  std::vector<Duration> durations_;  // of the last results, a ring
  std::size_t durations_next_ = 0;
  LeaseStats stats_;
};

}  // namespace preheat
