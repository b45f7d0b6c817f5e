// The raw blocks that a worker keeps for others, and whatever else it could pass on.
//
//   put:  kept here, within a budget; the one that was asked for longest ago goes first
//   lend: kept by somebody else, who may let go of it at any time
//
// Invariant: bytes() <= budget. Threads: one owner calls every member; what is found may be dropped
// by any thread.
#pragma once

#include <cstddef>
#include <cstdint>
#include <list>
#include <memory>
#include <optional>
#include <span>
#include <unordered_map>

#include "common/ids.h"
#include "common/transport.h"

namespace preheat {

class BlockShelf {
 public:
  // Lets go of what no longer fits.
  void set_budget(std::uint64_t bytes);

  // Requires: block.owner. A block that exceeds the budget is not kept.
  void put(VoxelId voxel, const Payload& block);
  void lend(VoxelId voxel, const Payload& block);

  // The block, if it is here or still with whom it was lent to.
  [[nodiscard]] std::optional<Payload> find(VoxelId voxel);
  [[nodiscard]] bool keeps(VoxelId voxel) const { return kept_.contains(voxel); }

  [[nodiscard]] std::uint64_t budget() const { return budget_; }
  [[nodiscard]] std::uint64_t bytes() const { return bytes_; }
  [[nodiscard]] std::uint64_t bytes_peak() const { return bytes_peak_; }
  void reset_peak() { bytes_peak_ = bytes_; }

 private:
  struct Kept {
    Payload block{};
    std::list<VoxelId>::iterator place{};
  };
  struct Lent {
    std::span<const std::byte> bytes{};
    std::weak_ptr<const void> owner{};
  };

  void make_room(std::uint64_t bytes);

  std::uint64_t budget_ = 0;
  std::uint64_t bytes_ = 0;
  std::uint64_t bytes_peak_ = 0;
  std::list<VoxelId> order_;  // of kept_, the one asked for last in front
  std::unordered_map<VoxelId, Kept> kept_;
  std::unordered_map<VoxelId, Lent> lent_;
  std::size_t lent_look_at_ = 64;  // so many before the next look for what was let go of
};

}  // namespace preheat
