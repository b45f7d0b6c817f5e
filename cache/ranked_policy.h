// Eviction by a number per voxel: the lowest goes first.
#pragma once

#include <set>
#include <utility>
#include <vector>

#include "cache/eviction_policy.h"

namespace preheat {

class RankedPolicy : public EvictionPolicy {
 public:
  explicit RankedPolicy(std::size_t voxel_count) : ranks_(voxel_count), is_held_(voxel_count) {}

  void admitted(VoxelId voxel) override;
  void dropped(VoxelId voxel) override;
  [[nodiscard]] std::optional<VoxelId> first_to_go(const Filter& may_go) override;

 protected:
  // O(log held).
  void set_rank(VoxelId voxel, double rank);
  [[nodiscard]] double rank(VoxelId voxel) const { return ranks_[index_of(voxel)]; }

 private:
  std::vector<double> ranks_;
  std::vector<bool> is_held_;
  std::set<std::pair<double, VoxelId>> held_;
};

}  // namespace preheat
