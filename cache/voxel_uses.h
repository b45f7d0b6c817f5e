// How many of one tracer's rays entered which resident cold voxels since this was last taken: what
// eviction goes by. One thread; adding costs two instructions and no shared memory.
#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "common/ids.h"

namespace preheat {

struct VoxelRays {
  VoxelId voxel{};
  std::uint64_t rays = 0;
};

class VoxelUses {
 public:
  explicit VoxelUses(std::size_t voxel_count) : rays_(voxel_count) {}

  void add(VoxelId voxel) {
    if (rays_[index_of(voxel)]++ == 0) { used_.push_back(voxel); }
  }

  [[nodiscard]] std::vector<VoxelRays> take() {
    std::vector<VoxelRays> uses;
    uses.reserve(used_.size());
    for (const VoxelId voxel : used_) {
      uses.push_back({voxel, std::exchange(rays_[index_of(voxel)], 0U)});
    }
    used_.clear();
    return uses;
  }

 private:
  std::vector<std::uint32_t> rays_;  // [voxel_count]
  std::vector<VoxelId> used_;        // voxels with rays, in the order of first use
};

}  // namespace preheat
