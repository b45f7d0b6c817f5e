#include "cache/ranked_policy.h"

#include "common/check.h"

namespace preheat {

void RankedPolicy::admitted(VoxelId voxel) {
  CHECK(!is_held_[index_of(voxel)]);
  is_held_[index_of(voxel)] = true;
  held_.emplace(rank(voxel), voxel);
}

void RankedPolicy::dropped(VoxelId voxel) {
  CHECK(is_held_[index_of(voxel)]);
  is_held_[index_of(voxel)] = false;
  held_.erase({rank(voxel), voxel});
}

void RankedPolicy::set_rank(VoxelId voxel, double rank) {
  double& current = ranks_[index_of(voxel)];
  if (rank == current) { return; }
  if (is_held_[index_of(voxel)]) {
    held_.erase({current, voxel});
    held_.emplace(rank, voxel);
  }
  current = rank;
}

std::optional<VoxelId> RankedPolicy::first_to_go(const Filter& may_go) {
  for (const auto& [rank, voxel] : held_) {
    if (may_go(voxel)) { return voxel; }
  }
  return std::nullopt;
}

}  // namespace preheat
