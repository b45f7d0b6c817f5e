#include "worker/block_shelf.h"

#include <algorithm>

#include "common/check.h"

namespace preheat {

void BlockShelf::make_room(std::uint64_t bytes) {
  while (bytes_ + bytes > budget_) {
    const auto last = kept_.find(order_.back());
    bytes_ -= last->second.block.bytes.size();
    kept_.erase(last);
    order_.pop_back();
  }
}

void BlockShelf::set_budget(std::uint64_t bytes) {
  budget_ = bytes;
  make_room(0);
}

void BlockShelf::put(VoxelId voxel, const Payload& block) {
  CHECK(block.owner != nullptr);
  if (block.bytes.size() > budget_ || kept_.contains(voxel)) { return; }
  make_room(block.bytes.size());
  order_.push_front(voxel);
  kept_[voxel] = {block, order_.begin()};
  bytes_ += block.bytes.size();
  bytes_peak_ = std::max(bytes_peak_, bytes_);
}

void BlockShelf::lend(VoxelId voxel, const Payload& block) {
  lent_[voxel] = {block.bytes, block.owner};
  if (lent_.size() < lent_look_at_) { return; }
  std::erase_if(lent_, [](const auto& entry) { return entry.second.owner.expired(); });
  lent_look_at_ = 64 + 2 * lent_.size();
}

std::optional<Payload> BlockShelf::find(VoxelId voxel) {
  if (const auto kept = kept_.find(voxel); kept != kept_.end()) {
    order_.splice(order_.begin(), order_, kept->second.place);
    return kept->second.block;
  }
  const auto lent = lent_.find(voxel);
  if (lent == lent_.end()) { return std::nullopt; }
  std::shared_ptr<const void> owner = lent->second.owner.lock();
  if (!owner) {
    lent_.erase(lent);
    return std::nullopt;
  }
  return Payload{lent->second.bytes, std::move(owner)};
}

}  // namespace preheat
