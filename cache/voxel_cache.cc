#include "cache/voxel_cache.h"

#include <algorithm>
#include <utility>

#include "common/check.h"

namespace preheat {

VoxelCache::VoxelCache(std::vector<Size> voxels, std::uint64_t limit_bytes,
                       std::function<std::uint64_t(VoxelId)> last_used)
    : voxels_(std::move(voxels)),
      limit_bytes_(limit_bytes),
      last_used_(std::move(last_used)),
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

void VoxelCache::served(VoxelId voxel, std::uint64_t rays) {
  Slot& slot = slots_[index_of(voxel)];
  CHECK(slot.state == State::kBuilt && slot.waiting >= rays);
  slot.waiting -= rays;
}

bool VoxelCache::block_arrived(VoxelId voxel) {
  Slot& slot = slots_[index_of(voxel)];
  if (slot.state != State::kFetching) { return false; }
  slot.state = State::kRaw;
  slot.held_before = false;
  hold(block_bytes(voxel));
  ++counts_.fetches;
  counts_.fetched_bytes += block_bytes(voxel);
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

std::vector<VoxelId>::iterator VoxelCache::find_victim(VoxelId kept) {
  auto victim = occupied_.end();
  std::pair<bool, std::uint64_t> victim_rank;
  for (auto candidate = occupied_.begin(); candidate != occupied_.end(); ++candidate) {
    const Slot& slot = slots_[index_of(*candidate)];
    // A block that rays wait for but that is not admitted yet may go too, after all others:
    // it must not keep the room that an admission before it needs.
    const bool idle_mesh = slot.state == State::kBuilt && slot.waiting == 0;
    const bool idle_block = slot.state == State::kRaw && slot.bvh_bytes == 0 && *candidate != kept;
    if (!idle_mesh && !idle_block) { continue; }
    const std::pair<bool, std::uint64_t> rank{slot.waiting > 0, last_used_(*candidate)};
    if (victim == occupied_.end() || rank < victim_rank) {
      victim = candidate;
      victim_rank = rank;
    }
  }
  return victim;
}

bool VoxelCache::make_room(VoxelId kept, std::uint64_t bytes, std::vector<Command>& commands) {
  while (promised_bytes_ + bytes > limit_bytes_ + withdrawing_bytes_) {
    const auto victim = find_victim(kept);
    if (victim == occupied_.end()) { return false; }
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
      *victim = occupied_.back();
      occupied_.pop_back();
    }
  }
  return promised_bytes_ + bytes <= limit_bytes_;
}

std::vector<VoxelCache::Command> VoxelCache::step() {
  std::vector<Command> commands;
  // Blocks that have arrived for an admitted voxel: their BVH's bytes are promised already.
  for (const VoxelId voxel : occupied_) {
    Slot& slot = slots_[index_of(voxel)];
    if (slot.state == State::kRaw && slot.bvh_bytes > 0) {
      slot.state = State::kBuilding;
      commands.push_back({Action::kBuild, voxel});
    }
  }
  std::erase_if(wanted_, [this](VoxelId voxel) { return slots_[index_of(voxel)].waiting == 0; });
  std::sort(wanted_.begin(), wanted_.end(), [this](VoxelId a, VoxelId b) {
    const std::uint64_t waiting_a = slots_[index_of(a)].waiting;
    const std::uint64_t waiting_b = slots_[index_of(b)].waiting;
    return waiting_a != waiting_b ? waiting_a > waiting_b : a < b;
  });
  std::size_t admitted = 0;
  for (; admitted < wanted_.size() && under_way_ < kCommandsUnderWayMax; ++admitted) {
    const VoxelId voxel = wanted_[admitted];
    Slot& slot = slots_[index_of(voxel)];
    if (slot.state == State::kWithdrawing) { break; }
    const bool raw = slot.state == State::kRaw;
    const std::uint64_t bvh_bytes = voxels_[index_of(voxel)].bvh_bytes_max;
    const std::uint64_t bytes = bvh_bytes + (raw ? 0 : block_bytes(voxel));
    if (!make_room(voxel, bytes, commands)) { break; }
    promised_bytes_ += bytes;
    slot.bvh_bytes = bvh_bytes;
    ++under_way_;
    if (raw) {
      slot.state = State::kBuilding;
      commands.push_back({Action::kBuild, voxel});
    } else {
      slot.state = State::kFetching;
      occupied_.push_back(voxel);
      commands.push_back({Action::kFetch, voxel});
    }
  }
  wanted_.erase(wanted_.begin(), wanted_.begin() + static_cast<std::ptrdiff_t>(admitted));
  CHECK(held_bytes_ <= promised_bytes_ && promised_bytes_ <= limit_bytes_);
  return commands;
}

}  // namespace preheat
