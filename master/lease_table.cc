#include "master/lease_table.h"

#include <algorithm>
#include <tuple>

#include "common/check.h"

namespace preheat {

LeaseTable::LeaseTable(const TileGrid& grid, Duration lease_min, std::uint64_t seed)
    : lease_min_(lease_min), random_(seed), scheduler_(grid), tiles_(grid.count()) {}

void LeaseTable::add_worker(WorkerId worker) {
  if (!holders_.try_emplace(worker).second) { return; }
  for (auto& [tile, deaths] : deaths_) {
    std::erase_if(deaths, [worker](const Death& death) { return death.worker == worker; });
  }
  std::erase_if(poisoned_, [this](TileId tile) {
    if (is_deadly(tile)) { return false; }
    tiles_[index_of(tile)].poisoned = false;
    scheduler_.give_back(tile);
    return true;
  });
}

void LeaseTable::remove_worker(WorkerId worker) {
  const auto entry = holders_.find(worker);
  if (entry == holders_.end()) { return; }
  const std::unordered_set<LeaseId> leases = std::move(entry->second.live);
  holders_.erase(entry);
  for (const LeaseId lease : leases) { end_live(lease); }
}

std::vector<TileId> LeaseTable::worker_died(WorkerId worker) {
  std::vector<TileId> poisoned_now;
  const std::vector<Lease> held = held_by(worker);
  for (const Lease& lease : held) {
    TileState& tile = tiles_[index_of(lease.tile)];
    deaths_[lease.tile].push_back({worker, held.size() == 1});
    // A committed tile is rendered again only to settle a dispute, which it is not worth dying for.
    if (!is_deadly(lease.tile)) { continue; }
    if (tile.committed) {
      disputes_.erase(lease.tile);
    } else if (!tile.poisoned) {
      tile.poisoned = true;
      poisoned_.push_back(lease.tile);
      poisoned_now.push_back(lease.tile);
    }
  }
  remove_worker(worker);
  return poisoned_now;
}

bool LeaseTable::is_suspect(TileId tile) const {
  const auto deaths = deaths_.find(tile);
  return deaths != deaths_.end() && deaths->second.size() >= kDeathsSuspect;
}

bool LeaseTable::is_deadly(TileId tile) const {
  const auto deaths = deaths_.find(tile);
  if (deaths == deaths_.end() || deaths->second.size() < kDeathsMax) { return false; }
  const auto alone = std::count_if(deaths->second.begin(), deaths->second.end(),
                                   [](const Death& death) { return death.alone; });
  return static_cast<std::size_t>(alone) >= kDeathsAloneMax;
}

bool LeaseTable::may_lease(WorkerId worker, TileId tile) const {
  if (is_suspect(tile) && held_count(worker) > 0) { return false; }
  const auto dispute = disputes_.find(tile);
  if (dispute == disputes_.end()) { return true; }
  const auto& parties = dispute->second.workers;
  return std::find(parties.begin(), parties.end(), worker) == parties.end();
}

// A suspect tile is alone with its worker.
bool LeaseTable::holds_suspect(const Holder& holder) const {
  return std::any_of(holder.live.begin(), holder.live.end(),
                     [this](LeaseId lease) { return is_suspect(leases_.at(lease).tile); });
}

std::optional<Lease> LeaseTable::grant(WorkerId worker, Time now) {
  const auto entry = holders_.find(worker);
  CHECK(entry != holders_.end());
  if (holds_suspect(entry->second)) { return std::nullopt; }
  const std::optional<TileId> tile = scheduler_.next(
      worker, [this, worker](TileId candidate) { return may_lease(worker, candidate); });
  if (!tile) { return std::nullopt; }
  return add_lease(worker, *tile, now);
}

Lease LeaseTable::add_lease(WorkerId worker, TileId tile, Time now) {
  LeaseId id{random_()};
  while (leases_.contains(id)) { id = LeaseId{random_()}; }
  leases_[id] = {tile, worker, now, now + lease_length(), stats_.granted, true};
  Holder& holder = holders_.at(worker);
  if (!holder.begin) { holder.begin = now; }
  holder.live.insert(id);
  tiles_[index_of(tile)].live.push_back(id);
  ++stats_.granted;
  return {id, tile};
}

bool LeaseTable::is_last(TileId tile) const {
  const TileState& state = tiles_[index_of(tile)];
  return state.live.size() == 1 && !state.committed && !state.poisoned && !is_suspect(tile);
}

std::vector<TileId> LeaseTable::last_tiles(Time now) const {
  if (scheduler_.pending() > 0) { return {}; }
  struct Last {
    Duration left{};
    std::uint64_t number = 0;
    TileId tile{};
  };
  std::vector<Last> last;
  for (const auto& [worker, holder] : holders_) {
    const Duration left = holder.time_left(now);
    for (const LeaseId lease : holder.live) {
      const Record& record = leases_.at(lease);
      if (is_last(record.tile)) { last.push_back({left, record.number, record.tile}); }
    }
  }
  // A worker begins with what it was granted first.
  std::sort(last.begin(), last.end(), [](const Last& a, const Last& b) {
    return std::tie(b.left, b.number) < std::tie(a.left, a.number);
  });
  std::vector<TileId> tiles;
  tiles.reserve(last.size());
  for (const Last& each : last) { tiles.push_back(each.tile); }
  return tiles;
}

std::optional<Lease> LeaseTable::grant_second(WorkerId worker, TileId tile, Time now) {
  const auto entry = holders_.find(worker);
  CHECK(entry != holders_.end());
  if (!is_last(tile) || holds_suspect(entry->second)) { return std::nullopt; }
  const Record& first = leases_.at(tiles_[index_of(tile)].live.front());
  const Holder& other = holders_.at(first.worker);
  const Duration left = other.time_left(now);
  if (first.worker == worker || entry->second.tile_length(now) >= left) { return std::nullopt; }
  ++stats_.doubled;
  return add_lease(worker, tile, now);
}

void LeaseTable::progress(WorkerId worker, Time now) {
  const auto entry = holders_.find(worker);
  if (entry == holders_.end()) { return; }
  const Time deadline = now + lease_length();
  for (const LeaseId lease : entry->second.live) {
    Record& record = leases_.at(lease);
    record.deadline = std::max(record.deadline, deadline);
  }
}

void LeaseTable::end_live(LeaseId lease) {
  Record& record = leases_.at(lease);
  CHECK(record.live);
  record.live = false;
  const auto holder = holders_.find(record.worker);
  if (holder != holders_.end()) { holder->second.live.erase(lease); }
  TileState& tile = tiles_[index_of(record.tile)];
  std::erase(tile.live, lease);
  const bool settled = tile.poisoned || (tile.committed && !disputes_.contains(record.tile));
  if (!settled && tile.live.empty()) { scheduler_.give_back(record.tile); }
}

std::vector<std::pair<WorkerId, Lease>> LeaseTable::expire(Time now) {
  std::vector<std::pair<WorkerId, Lease>> expired;
  for (const auto& [worker, holder] : holders_) {
    for (const LeaseId lease : holder.live) {
      const Record& record = leases_.at(lease);
      if (record.deadline <= now) { expired.emplace_back(worker, Lease{lease, record.tile}); }
    }
  }
  // Hash maps have no order that two runs share; ledgers and tests want one.
  std::sort(expired.begin(), expired.end(), [](const auto& a, const auto& b) {
    return std::tie(a.second.tile, a.first) < std::tie(b.second.tile, b.first);
  });
  for (const auto& [worker, lease] : expired) {
    end_live(lease.id);
    ++stats_.expired;
  }
  return expired;
}

void LeaseTable::extend_all(Duration gap) {
  for (auto& [id, record] : leases_) { record.deadline += gap; }
}

LeaseVerdict LeaseTable::result(WorkerId worker, LeaseId lease, const Hash128& hash, Time now) {
  const auto entry = leases_.find(lease);
  if (entry == leases_.end() || entry->second.worker != worker) { return {}; }
  const Record record = entry->second;
  TileState& tile = tiles_[index_of(record.tile)];
  if (record.live) {
    keep_duration(now - record.granted);
    Holder& holder = holders_.at(worker);
    holder.live.erase(lease);
    ++holder.results;
    std::erase(tile.live, lease);
  }
  leases_.erase(entry);

  LeaseVerdict verdict;
  verdict.outcome = judge(worker, record.tile, hash);
  const bool disputed = disputes_.contains(record.tile);
  if (!disputed) {
    scheduler_.remove(record.tile);
    for (const LeaseId other : std::vector(tile.live)) {
      verdict.cancelled.emplace_back(leases_.at(other).worker, Lease{other, record.tile});
      end_live(other);
    }
  } else if (tile.live.empty()) {
    scheduler_.remove(record.tile);
    scheduler_.give_back(record.tile);
  }
  return verdict;
}

// Commits, compares or settles.
ResultOutcome LeaseTable::judge(WorkerId worker, TileId id, const Hash128& hash) {
  TileState& tile = tiles_[index_of(id)];
  if (!tile.committed) {
    tile.committed = true;
    tile.hash = hash;
    tile.worker = worker;
    ++tiles_committed_;
    if (tile.poisoned) {  // somebody lived to tell
      tile.poisoned = false;
      std::erase(poisoned_, id);
    }
    return ResultOutcome::kCommitted;
  }
  const auto dispute = disputes_.find(id);
  if (hash == tile.hash) {
    ++stats_.duplicates;
    const bool a_third = dispute != disputes_.end() && worker != dispute->second.workers[0] &&
                         worker != dispute->second.workers[1];
    if (a_third) { disputes_.erase(dispute); }
    return ResultOutcome::kDuplicate;
  }
  if (dispute == disputes_.end()) {
    ++stats_.mismatches;
    // Who contradicts himself is no witness: the committed result stays.
    if (worker != tile.worker) { disputes_[id] = {{tile.worker, worker}, hash}; }
    return ResultOutcome::kMismatch;
  }
  const Dispute parties = dispute->second;
  if (worker == parties.workers[0] || worker == parties.workers[1]) {
    return ResultOutcome::kMismatch;
  }
  disputes_.erase(dispute);
  if (hash != parties.other) {
    ++stats_.mismatches;
    return ResultOutcome::kMismatch;
  }
  tile.hash = hash;
  tile.worker = worker;
  return ResultOutcome::kReplaced;
}

std::optional<TileId> LeaseTable::tile_of(WorkerId worker, LeaseId lease) const {
  const auto entry = leases_.find(lease);
  if (entry == leases_.end() || entry->second.worker != worker) { return std::nullopt; }
  return entry->second.tile;
}

std::vector<Lease> LeaseTable::held_by(WorkerId worker) const {
  std::vector<Lease> held;
  const auto entry = holders_.find(worker);
  if (entry == holders_.end()) { return held; }
  for (const LeaseId lease : entry->second.live) {
    held.push_back({lease, leases_.at(lease).tile});
  }
  std::sort(held.begin(), held.end(),
            [](const Lease& a, const Lease& b) { return a.tile < b.tile; });
  return held;
}

std::size_t LeaseTable::held_count(WorkerId worker) const {
  const auto entry = holders_.find(worker);
  return entry == holders_.end() ? 0 : entry->second.live.size();
}

std::optional<Time> LeaseTable::granted_at(LeaseId lease) const {
  const auto entry = leases_.find(lease);
  if (entry == leases_.end() || !entry->second.live) { return std::nullopt; }
  return entry->second.granted;
}

bool LeaseTable::finished() const {
  if (tiles_committed_ + poisoned_.size() < tiles_.size()) { return false; }
  for (const auto& [tile, dispute] : disputes_) {
    if (!tiles_[index_of(tile)].live.empty()) { return false; }
    for (const auto& [worker, holder] : holders_) {
      if (worker != dispute.workers[0] && worker != dispute.workers[1]) { return false; }
    }
  }
  return true;
}

void LeaseTable::keep_duration(Duration duration) {
  if (durations_.size() < kDurationsKept) {
    durations_.push_back(duration);
    return;
  }
  durations_[durations_next_] = duration;
  durations_next_ = (durations_next_ + 1) % kDurationsKept;
}

Duration LeaseTable::lease_length() const {
  if (durations_.empty()) { return lease_min_; }
  std::vector<Duration> sorted = durations_;
  const auto p95 = sorted.begin() + static_cast<std::ptrdiff_t>((sorted.size() - 1) * 95 / 100);
  std::nth_element(sorted.begin(), p95, sorted.end());
  return std::max(lease_min_, 4 * *p95);
}

}  // namespace preheat
