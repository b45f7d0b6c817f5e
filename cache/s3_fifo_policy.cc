#include "cache/s3_fifo_policy.h"

#include <algorithm>
#include <utility>

#include "common/check.h"

namespace preheat {
namespace {

constexpr std::uint8_t kUsesMax = 3;
constexpr std::uint64_t kSmallPart = 10;  // one in so many bytes is the small queue's

}  // namespace

S3FifoPolicy::S3FifoPolicy(std::vector<std::uint64_t> bytes)
    : bytes_(std::move(bytes)), records_(bytes_.size()) {}

void S3FifoPolicy::push(Queue& queue, Place place, VoxelId voxel) {
  records_[index_of(voxel)].place = place;
  records_[index_of(voxel)].uses = 0;
  queue.voxels.push_back(voxel);
  queue.bytes += bytes_[index_of(voxel)];
}

void S3FifoPolicy::take(Queue& queue, std::deque<VoxelId>::iterator at) {
  queue.bytes -= bytes_[index_of(*at)];
  queue.voxels.erase(at);
}

void S3FifoPolicy::admitted(VoxelId voxel) {
  Record& record = records_[index_of(voxel)];
  const bool returns = record.place == Place::kGhost;
  if (returns) { ghost_bytes_ -= bytes_[index_of(voxel)]; }
  // The rays that it is fetched for are the request, not a use beyond it.
  record.period_used = period_;
  push(returns ? main_ : small_, returns ? Place::kMain : Place::kSmall, voxel);
}

void S3FifoPolicy::dropped(VoxelId voxel) {
  const Place place = records_[index_of(voxel)].place;
  CHECK(place == Place::kSmall || place == Place::kMain);
  Queue& queue = place == Place::kSmall ? small_ : main_;
  take(queue, std::find(queue.voxels.begin(), queue.voxels.end(), voxel));
  records_[index_of(voxel)].place = Place::kOutside;
  if (place == Place::kSmall) { remember(voxel); }
}

void S3FifoPolicy::remember(VoxelId voxel) {
  Record& record = records_[index_of(voxel)];
  record.place = Place::kGhost;
  record.ghost_entry = ++ghost_entries_;
  ghosts_.push_back({voxel, record.ghost_entry});
  ghost_bytes_ += bytes_[index_of(voxel)];
  const std::uint64_t bytes_max = small_.bytes + main_.bytes;
  while (!ghosts_.empty()) {
    const Ghost oldest = ghosts_.front();
    Record& old_record = records_[index_of(oldest.voxel)];
    const bool counts = old_record.place == Place::kGhost && old_record.ghost_entry == oldest.entry;
    if (counts && (ghost_bytes_ <= bytes_max || ghosts_.size() == 1)) { break; }
    if (counts) {
      old_record.place = Place::kOutside;
      ghost_bytes_ -= bytes_[index_of(oldest.voxel)];
    }
    ghosts_.pop_front();
  }
}

void S3FifoPolicy::used(VoxelId voxel, std::uint64_t /*rays*/) {
  Record& record = records_[index_of(voxel)];
  if (record.period_used == period_) { return; }
  record.period_used = period_;
  record.uses = std::min<std::uint8_t>(kUsesMax, static_cast<std::uint8_t>(record.uses + 1));
}

std::optional<VoxelId> S3FifoPolicy::from_small(const Filter& may_go) {
  for (std::size_t at = 0; at < small_.voxels.size();) {
    const VoxelId voxel = small_.voxels[at];
    if (!may_go(voxel)) {
      ++at;
    } else if (records_[index_of(voxel)].uses > 0) {
      take(small_, small_.voxels.begin() + static_cast<std::ptrdiff_t>(at));
      push(main_, Place::kMain, voxel);
    } else {
      return voxel;
    }
  }
  return std::nullopt;
}

std::optional<VoxelId> S3FifoPolicy::from_main(const Filter& may_go) {
  for (std::size_t at = 0; at < main_.voxels.size();) {
    const VoxelId voxel = main_.voxels[at];
    const std::uint8_t uses = records_[index_of(voxel)].uses;
    if (!may_go(voxel)) {
      ++at;
    } else if (uses > 0) {
      take(main_, main_.voxels.begin() + static_cast<std::ptrdiff_t>(at));
      push(main_, Place::kMain, voxel);
      records_[index_of(voxel)].uses = static_cast<std::uint8_t>(uses - 1);
    } else {
      return voxel;
    }
  }
  return std::nullopt;
}

std::optional<VoxelId> S3FifoPolicy::first_to_go(const Filter& may_go) {
  const bool small_is_full = small_.bytes * kSmallPart >= small_.bytes + main_.bytes;
  if (small_is_full) {
    if (const auto voxel = from_small(may_go)) { return voxel; }
    return from_main(may_go);
  }
  if (const auto voxel = from_main(may_go)) { return voxel; }
  return from_small(may_go);
}

}  // namespace preheat
