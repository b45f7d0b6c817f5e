#include "cache/voxel_cache.h"

#include <algorithm>
#include <utility>

#include "common/check.h"

namespace preheat {

VoxelCache::VoxelCache(std::vector<Size> voxels, std::uint64_t limit_bytes,
                       std::unique_ptr<EvictionPolicy> policy)
    : voxels_(std::move(voxels)),
      limit_bytes_(limit_bytes),
      policy_(std::move(policy)),
      slots_(voxels_.size()) {}

void VoxelCache::hold(std::uint64_t bytes) {
  held_bytes_ += bytes;
  held_bytes_peak_ = std::max(held_bytes_peak_, held_bytes_);
}

void VoxelCache::add_waiting(VoxelId voxel, std::uint64_t rays) {
  Slot& slot = slots_[index_of(voxel)];
  const bool newly_wanted = slot.waiting == 0 && rays > 0;
  slot.waiting += rays;
  if (newly_wanted && (slot.state == State::kAbsent || slot.state == State::kRaw ||
                       slot.state == State::kWithdrawing)) {
    wanted_.push_back(voxel);
  }
}

void VoxelCache::prefetch(std::span<const VoxelId> voxels) {
  unasked_.insert(unasked_.end(), voxels.begin(), voxels.end());
}

void VoxelCache::served(VoxelId voxel, std::uint64_t rays) {
  Slot& slot = slots_[index_of(voxel)];
  CHECK(slot.state == State::kBuilt && slot.waiting >= rays);
  slot.waiting -= rays;
}

void VoxelCache::used(VoxelId voxel, std::uint64_t rays) {
  // A batch may end after its voxel was given up.
  if (slots_[index_of(voxel)].state != State::kAbsent) { policy_->used(voxel, rays); }
}

bool VoxelCache::block_arrived(VoxelId voxel) {
  Slot& slot = slots_[index_of(voxel)];
  if (slot.state != State::kFetching) { return false; }
  slot.state = State::kRaw;
  --fetching_;
  slot.held_before = false;
  hold(block_bytes(voxel));
  arrived_.push_back(voxel);
  (slot.prefetched ? counts_.prefetches : counts_.fetches) += 1;
  (slot.prefetched ? counts_.prefetched_bytes : counts_.fetched_bytes) += block_bytes(voxel);
  return true;
}

void VoxelCache::built(VoxelId voxel, std::uint64_t bvh_bytes) {
  Slot& slot = slots_[index_of(voxel)];
  CHECK(slot.state == State::kBuilding && bvh_bytes <= slot.bvh_bytes);
  promised_bytes_ = promised_bytes_ - slot.bvh_bytes + bvh_bytes;
  slot.bvh_bytes = bvh_bytes;
  slot.state = State::kBuilt;
  hold(bvh_bytes);
  counts_.rebuilds += slot.held_before ? 1 : 0;
  --under_way_;
}

void VoxelCache::withdrawn(VoxelId voxel) {
  Slot& slot = slots_[index_of(voxel)];
  CHECK(slot.state == State::kWithdrawing);
  slot.state = State::kRaw;
  slot.held_before = true;
  held_bytes_ -= slot.bvh_bytes;
  promised_bytes_ -= slot.bvh_bytes;
  withdrawing_bytes_ -= slot.bvh_bytes;
  slot.bvh_bytes = 0;
}

// Of kCommandsUnderWayMax. A link of 100 Mbit/s keeps it far above; on one machine, where a fetch
// is hardly slower than the build that follows, it is around it.
constexpr double kFetchesShort = 2.0;

std::optional<VoxelId> VoxelCache::find_victim(VoxelId kept) {
  const auto is_idle_block = [&](VoxelId voxel) {
    const Slot& slot = slots_[index_of(voxel)];
    return slot.state == State::kRaw && slot.bvh_bytes == 0 && voxel != kept;
  };
  const auto is_idle = [&](VoxelId voxel) {
    const Slot& slot = slots_[index_of(voxel)];
    return slot.waiting == 0 && (slot.state == State::kBuilt || is_idle_block(voxel));
  };
  if (fetches_ahead_ > kFetchesShort) {
    const auto is_idle_bvh = [&](VoxelId voxel) {
      return slots_[index_of(voxel)].state == State::kBuilt && is_idle(voxel);
    };
    if (const auto victim = policy_->first_to_go(is_idle_bvh)) { return victim; }
  }
  if (const auto victim = policy_->first_to_go(is_idle)) { return victim; }
  // A block that rays wait for but that is not admitted yet may go too, after all others: it must
  // not keep the room that an admission before it needs.
  return policy_->first_to_go(is_idle_block);
}

bool VoxelCache::make_room(VoxelId kept, std::uint64_t bytes, std::vector<Command>& commands) {
  while (promised_bytes_ + bytes > limit_bytes_ + withdrawing_bytes_) {
    const std::optional<VoxelId> victim = find_victim(kept);
    if (!victim) { return false; }
    ++counts_.evictions;
    Slot& slot = slots_[index_of(*victim)];
    if (slot.state == State::kBuilt) {
      slot.state = State::kWithdrawing;
      withdrawing_bytes_ += slot.bvh_bytes;
      commands.push_back({Action::kWithdraw, *victim});
    } else {
      slot.state = State::kAbsent;
      held_bytes_ -= block_bytes(*victim);
      promised_bytes_ -= block_bytes(*victim);
      commands.push_back({Action::kDropBlock, *victim});
      policy_->dropped(*victim);
    }
  }
  return promised_bytes_ + bytes <= limit_bytes_;
}

void VoxelCache::admit(VoxelId voxel, std::vector<Command>& commands) {
  Slot& slot = slots_[index_of(voxel)];
  const bool raw = slot.state == State::kRaw;
  slot.bvh_bytes = voxels_[index_of(voxel)].bvh_bytes_max;
  promised_bytes_ += slot.bvh_bytes + (raw ? 0 : block_bytes(voxel));
  ++under_way_;
  if (raw) {
    slot.state = State::kBuilding;
    commands.push_back({Action::kBuild, voxel});
  } else {
    slot.state = State::kFetching;
    ++fetching_;
    slot.prefetched = slot.waiting == 0;
    policy_->admitted(voxel);
    commands.push_back({Action::kFetch, voxel});
  }
}

void VoxelCache::admit_prefetches(std::vector<Command>& commands) {
  while (!unasked_.empty() && under_way_ < kCommandsUnderWayMax) {
    const VoxelId voxel = unasked_.front();
    const bool absent = slots_[index_of(voxel)].state == State::kAbsent;
    const std::uint64_t bytes = block_bytes(voxel) + voxels_[index_of(voxel)].bvh_bytes_max;
    if (absent && promised_bytes_ + bytes > limit_bytes_) {
      unasked_.clear();  // what is held is used by now
      return;
    }
    unasked_.pop_front();
    if (absent) { admit(voxel, commands); }
  }
}

bool VoxelCache::is_behind(VoxelId a, VoxelId b) const {
  const std::uint64_t waiting_a = slots_[index_of(a)].waiting;
  const std::uint64_t waiting_b = slots_[index_of(b)].waiting;
  return waiting_a != waiting_b ? waiting_a < waiting_b : a > b;
}

void VoxelCache::note_what_is_short() {
  constexpr double kOfOneStep = 1.0 / 64.0;
  const auto building = static_cast<double>(under_way_ - fetching_);
  fetches_ahead_ += kOfOneStep * (static_cast<double>(fetching_) - building - fetches_ahead_);
}

std::vector<VoxelCache::Command> VoxelCache::step() {
  note_what_is_short();
  std::vector<Command> commands;
  // Blocks that have arrived for an admitted voxel: their BVH's bytes are promised already.
  for (const VoxelId voxel : std::exchange(arrived_, {})) {
    slots_[index_of(voxel)].state = State::kBuilding;
    commands.push_back({Action::kBuild, voxel});
  }
  while (!wanted_.empty() && under_way_ < kCommandsUnderWayMax) {
    const auto first = std::max_element(wanted_.begin(), wanted_.end(),
                                        [this](VoxelId a, VoxelId b) { return is_behind(a, b); });
    const VoxelId voxel = *first;
    const Slot& slot = slots_[index_of(voxel)];
    if (slot.state == State::kWithdrawing) { break; }
    const std::uint64_t bytes = voxels_[index_of(voxel)].bvh_bytes_max +
                                (slot.state == State::kRaw ? 0 : block_bytes(voxel));
    if (!make_room(voxel, bytes, commands)) { break; }
    *first = wanted_.back();
    wanted_.pop_back();
    admit(voxel, commands);
  }
  if (wanted_.empty()) { admit_prefetches(commands); }
  CHECK(held_bytes_ <= promised_bytes_ && promised_bytes_ <= limit_bytes_);
  return commands;
}

}  // namespace preheat
