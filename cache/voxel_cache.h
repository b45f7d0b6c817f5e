// Decides which cold voxels a worker holds, raw or built, and never lets them exceed a byte limit.
//
// A state machine without Embree, threads or clocks. Per voxel:
//
//   absent -> fetching -> raw -> building -> built -> withdrawing -> raw -> absent
//
// A voxel that rays wait for is admitted when its whole resident size (block and bound of its BVH)
// can be had; what is admitted is never evicted before it has served the rays that waited for it.
// So admitted voxels always come to an end, and a limit of one voxel still renders: they are
// admitted in turn. What is prefetched is admitted while nothing is waited for, and never takes the
// place of anything. Room is made from the voxel that the policy names: first its BVH goes, then
// its block. A BVH costs a build to have again and a block a fetch and a build: while nearly
// all that is under way is on its way here and next to nothing waits to be built, fetches are what
// is short, and every BVH that can go goes before any block.
//
// Invariant, checked after every step: held_bytes() <= promised_bytes() <= limit_bytes.
//
// Threads: none of its own; the owner locks.
#pragma once

#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "cache/eviction_policy.h"
#include "common/ids.h"

namespace preheat {

class VoxelCache {
 public:
  enum class Action : std::uint8_t {
    kFetch,      // get the block, then call block_arrived
    kBuild,      // build the BVH, then call built
    kWithdraw,   // take the mesh out of use and free it, then call withdrawn
    kDropBlock,  // free the block; done at once
  };
  struct Command {
    Action action{};
    VoxelId voxel{};
    friend bool operator==(const Command&, const Command&) = default;
  };
  struct Counts {
    std::uint64_t fetches = 0;  // blocks that arrived because rays waited
    std::uint64_t fetched_bytes = 0;
    std::uint64_t prefetches = 0;  // blocks that arrived unasked
    std::uint64_t prefetched_bytes = 0;
    std::uint64_t rebuilds = 0;   // builds from a block that was held already
    std::uint64_t evictions = 0;  // blocks or BVHs given up
  };

  // What a voxel takes.
  struct Size {
    std::uint64_t block_bytes = 0;
    std::uint64_t bvh_bytes_max = 0;
  };

  VoxelCache(std::vector<Size> voxels, std::uint64_t limit_bytes,
             std::unique_ptr<EvictionPolicy> policy);

  // Commands to carry out after the calls since the last step, in this order. At most
  // `commands_under_way_max` fetches and builds run at a time.
  [[nodiscard]] std::vector<Command> step();

  // Voxels to hold before rays ask for them, in this order, as far as there is room.
  void prefetch(std::span<const VoxelId> voxels);

  // Rays began to wait for a voxel, or have been served.
  void add_waiting(VoxelId voxel, std::uint64_t rays);
  void served(VoxelId voxel, std::uint64_t rays);

  // What the policy goes by: rays entered a voxel that is or was held; a period of them is over.
  void used(VoxelId voxel, std::uint64_t rays);
  void begin_period() { policy_->begin_period(); }

  // False if the voxel was not being fetched: the caller drops the bytes.
  [[nodiscard]] bool block_arrived(VoxelId voxel);
  // Requires: bvh_bytes <= Size::bvh_bytes_max.
  void built(VoxelId voxel, std::uint64_t bvh_bytes);
  void withdrawn(VoxelId voxel);

  [[nodiscard]] bool is_built(VoxelId voxel) const {
    return slots_[index_of(voxel)].state == State::kBuilt;
  }
  [[nodiscard]] bool is_waited_for(VoxelId voxel) const {
    return slots_[index_of(voxel)].waiting > 0;
  }
  [[nodiscard]] std::uint64_t limit_bytes() const { return limit_bytes_; }
  [[nodiscard]] std::uint64_t promised_bytes() const { return promised_bytes_; }
  [[nodiscard]] std::uint64_t held_bytes() const { return held_bytes_; }
  [[nodiscard]] std::uint64_t held_bytes_peak() const { return held_bytes_peak_; }
  [[nodiscard]] const Counts& counts() const { return counts_; }

  static constexpr std::size_t kCommandsUnderWayMax = 16;

 private:
  enum class State : std::uint8_t { kAbsent, kFetching, kRaw, kBuilding, kBuilt, kWithdrawing };
  struct Slot {
    State state = State::kAbsent;
    bool held_before = false;     // the block was there before the build was asked for
    bool prefetched = false;      // what is being fetched was not asked for
    std::uint64_t bvh_bytes = 0;  // promised until built, then real
    std::uint64_t waiting = 0;
  };

  // Makes room for `bytes` more beside `kept`, by commands; false if it must wait for withdrawals
  // under way or for admitted voxels to be served.
  [[nodiscard]] bool make_room(VoxelId kept, std::uint64_t bytes, std::vector<Command>& commands);
  [[nodiscard]] std::optional<VoxelId> find_victim(VoxelId kept);
  void note_what_is_short();
  // Of two that are waited for, whether the first is admitted later.
  [[nodiscard]] bool is_behind(VoxelId a, VoxelId b) const;
  [[nodiscard]] std::uint64_t block_bytes(VoxelId voxel) const {
    return voxels_[index_of(voxel)].block_bytes;
  }
  void hold(std::uint64_t bytes);
  // Promises the room that there must be, and says what comes next.
  void admit(VoxelId voxel, std::vector<Command>& commands);
  void admit_prefetches(std::vector<Command>& commands);

  std::vector<Size> voxels_;
  std::uint64_t limit_bytes_;
  std::unique_ptr<EvictionPolicy> policy_;
  std::vector<Slot> slots_;
  std::vector<VoxelId> wanted_;   // waited for and not yet admitted
  std::deque<VoxelId> unasked_;   // to be prefetched
  std::vector<VoxelId> arrived_;  // admitted, raw since the last step
  std::uint64_t promised_bytes_ = 0;
  std::uint64_t held_bytes_ = 0;
  std::uint64_t held_bytes_peak_ = 0;
  std::uint64_t withdrawing_bytes_ = 0;  // comes back without a further command
  std::size_t under_way_ = 0;
  std::size_t fetching_ = 0;    // of those under way
  double fetches_ahead_ = 0.0;  // how many more are being fetched than built, over the last steps
  Counts counts_{};
};

}  // namespace preheat
