#include "tests/bench/belady_policy.h"

#include <limits>
#include <utility>

namespace preheat {

BeladyPolicy::BeladyPolicy(std::vector<std::vector<std::uint32_t>> periods_of_use)
    : RankedPolicy(periods_of_use.size()),
      periods_of_use_(std::move(periods_of_use)),
      next_(periods_of_use_.size()) {}

void BeladyPolicy::admitted(VoxelId voxel) {
  RankedPolicy::admitted(voxel);
  rank_by_use_from(voxel, period_);
}

void BeladyPolicy::used(VoxelId voxel, std::uint64_t /*rays*/) {
  rank_by_use_from(voxel, period_ + 1);
}

void BeladyPolicy::rank_by_use_from(VoxelId voxel, std::uint32_t period) {
  const std::vector<std::uint32_t>& periods = periods_of_use_[index_of(voxel)];
  std::size_t& next = next_[index_of(voxel)];
  while (next < periods.size() && periods[next] < period) { ++next; }
  set_rank(voxel, next < periods.size() ? -static_cast<double>(periods[next])
                                        : -std::numeric_limits<double>::infinity());
}

}  // namespace preheat
