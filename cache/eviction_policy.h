// Who is given up first when a cache of voxels needs room.
//
// A policy knows which voxels are held and how rays used them, and puts them in an order. Time is
// counted in periods of many batches: rays of neighbouring paths enter a voxel together, so several
// uses within a period are one observation. Pure and deterministic: ties go to the lower voxel id.
//
//   lru      used longest ago.
//   lfu      used in the smallest share of the periods, old ones counting less and less. A voxel's
//            record outlives its stay.
//   prior    as lfu, beginning with what the prediction says: the record starts as some periods in
//            each of which the voxel was used with its predicted chance.
//   s3-fifo  Yang, Zhang, Qiu, Yue, Vinayak, "FIFO queues are all you need for cache eviction",
//            SOSP 2023: newcomers pass through a small queue and stay only if used again; who was
//            thrown out lately and returns goes to the main queue at once. Queues are measured in
//            bytes.
//
// Threads: none of its own; the owner locks.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "common/eviction.h"
#include "common/ids.h"

namespace preheat {

class EvictionPolicy {
 public:
  virtual ~EvictionPolicy() = default;

  // The voxel is held from now on, until `dropped`.
  virtual void admitted(VoxelId voxel) = 0;
  virtual void dropped(VoxelId voxel) = 0;

  // `rays` rays entered a voxel that is held.
  virtual void used(VoxelId voxel, std::uint64_t rays) = 0;

  virtual void begin_period() = 0;

  // Of the held voxels for which `may_go`, the first to be given up. It stays held until dropped.
  using Filter = std::function<bool(VoxelId)>;
  [[nodiscard]] virtual std::optional<VoxelId> first_to_go(const Filter& may_go) = 0;
};

struct EvictionInput {
  std::vector<std::uint64_t> bytes{};  // [voxel_count] of the blocks
  // [voxel_count] chance that the rays of one period enter the voxel, as predicted; empty where
  // nothing is. For `prior`.
  std::vector<double> chance_expected{};
};

[[nodiscard]] std::unique_ptr<EvictionPolicy> make_eviction_policy(Eviction eviction,
                                                                   EvictionInput input);

// Of expected rays per voxel: that at least one of a period's rays enters it, where rays come
// independently and `periods` make the frame.
[[nodiscard]] std::vector<double> chance_per_period(std::span<const double> rays_expected,
                                                    double periods);

}  // namespace preheat
