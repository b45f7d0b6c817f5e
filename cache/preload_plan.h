// Expected rays and a byte budget -> what a worker holds before rays ask for it: the hot set before
// its first tile, the warm voxels soon after.
//
// Pure and deterministic: ties go to the lower voxel id.
#pragma once

#include <cstdint>
#include <vector>

#include "cache/prediction.h"
#include "common/scene_tables.h"

namespace preheat {

struct PreloadPlan {
  std::vector<VoxelId> hot{};   // hottest per byte first
  std::uint64_t hot_bytes = 0;  // VoxelEntry::hot_bytes of `hot`; <= the budget
  // What the rest of the cache has room for, most rays per byte first, then what no sample of the
  // model met but rays are likely to: fetched while tiles run, as far as nothing has to go for it.
  std::vector<VoxelId> warm{};
};

// What of `cache_bytes` may be hot, beside the kBvhBytesFixed of its BVH. `share` in [0,1]; negative
// = auto: as much as leaves room for every other voxel that rays are expected or likely to enter,
// and at least 0.3. The rest always holds the largest voxel that is not hot, so that every cache
// renders. Only auto makes voxels warm.
[[nodiscard]] PreloadPlan plan_preload(const SceneTables& tables, const Prediction& prediction,
                                       std::uint64_t cache_bytes, double share);

}  // namespace preheat
