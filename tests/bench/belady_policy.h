// Belady's MIN: gives up the voxel whose next use is farthest, which it knows from a recorded
// trace.
//
// With voxels of one size no policy misses less (Belady 1966; Mattson et al. 1970). With different
// sizes it is a heuristic, for whole voxels have to fit: see fetched_bytes_bound for what cannot be
// beaten.
#pragma once

#include <vector>

#include "cache/ranked_policy.h"

namespace preheat {

class BeladyPolicy : public RankedPolicy {
 public:
  // The periods, counted from 1, in which each voxel is used, ascending. [voxel_count]
  explicit BeladyPolicy(std::vector<std::vector<std::uint32_t>> periods_of_use);

  void admitted(VoxelId voxel) override;
  void used(VoxelId voxel, std::uint64_t rays) override;
  void begin_period() override { ++period_; }

 private:
  // Ranks a voxel by its first use in or after `period`.
  void rank_by_use_from(VoxelId voxel, std::uint32_t period);

  std::vector<std::vector<std::uint32_t>> periods_of_use_;
  std::vector<std::size_t> next_;  // into periods_of_use_[voxel]; only grows
  std::uint32_t period_ = 0;
};

}  // namespace preheat
