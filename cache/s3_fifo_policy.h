// S3-FIFO as its paper has it (section 4.2; see eviction_policy.h), with bytes for objects and
// periods for requests. The main queue's voxels get up to three further rounds, one for each period
// in which they were used since.
#pragma once

#include <deque>
#include <vector>

#include "cache/eviction_policy.h"

namespace preheat {

class S3FifoPolicy : public EvictionPolicy {
 public:
  explicit S3FifoPolicy(std::vector<std::uint64_t> bytes);

  void admitted(VoxelId voxel) override;
  void dropped(VoxelId voxel) override;
  void used(VoxelId voxel, std::uint64_t rays) override;
  void begin_period() override { ++period_; }
  // O(1) amortised, and as many steps as there are voxels at the heads that may not go.
  [[nodiscard]] std::optional<VoxelId> first_to_go(const Filter& may_go) override;

 private:
  enum class Place : std::uint8_t { kOutside, kGhost, kSmall, kMain };
  struct Record {
    Place place = Place::kOutside;
    std::uint8_t uses = 0;  // since it joined or last moved; at most kUsesMax
    std::uint64_t period_used = 0;
    std::uint64_t ghost_entry = 0;  // which of several entries in ghosts_ counts
  };
  struct Queue {
    std::deque<VoxelId> voxels{};
    std::uint64_t bytes = 0;
  };
  struct Ghost {
    VoxelId voxel{};
    std::uint64_t entry = 0;
  };

  void push(Queue& queue, Place place, VoxelId voxel);
  void take(Queue& queue, std::deque<VoxelId>::iterator at);
  void remember(VoxelId voxel);
  std::optional<VoxelId> from_small(const Filter& may_go);
  std::optional<VoxelId> from_main(const Filter& may_go);

  std::vector<std::uint64_t> bytes_;
  std::vector<Record> records_;
  Queue small_;
  Queue main_;
  std::deque<Ghost> ghosts_;
  std::uint64_t ghost_bytes_ = 0;
  std::uint64_t ghost_entries_ = 0;
  std::uint64_t period_ = 1;
};

}  // namespace preheat
