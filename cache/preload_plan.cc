#include "cache/preload_plan.h"

#include <algorithm>
#include <numeric>

namespace preheat {

PreloadPlan plan_preload(const SceneTables& tables, const Prediction& prediction,
                         std::uint64_t cache_limit_bytes, double share) {
  const std::size_t voxel_count = tables.voxels.size();
  std::vector<std::uint32_t> order(voxel_count);
  std::iota(order.begin(), order.end(), 0U);
  std::vector<double> rays_per_byte(voxel_count, 0.0);
  for (std::size_t voxel = 0; voxel < voxel_count; ++voxel) {
    rays_per_byte[voxel] =
        prediction.rays(voxel) / static_cast<double>(tables.voxels[voxel].resident_bytes);
  }
  std::stable_sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) {
    return rays_per_byte[a] > rays_per_byte[b];
  });

  PreloadPlan plan;
  const bool holds_everything = cache_limit_bytes >= tables.resident_bytes();
  const std::uint64_t room_for_rest = holds_everything ? 0 : tables.resident_bytes_min();
  const std::uint64_t budget_max =
      cache_limit_bytes > room_for_rest ? cache_limit_bytes - room_for_rest : 0;
  const double share_used = share >= 0.0 ? std::min(share, 1.0) : holds_everything ? 1.0 : 0.5;
  const auto budget = std::min(
      budget_max, static_cast<std::uint64_t>(share_used * static_cast<double>(cache_limit_bytes)));
  for (const std::uint32_t voxel : order) {
    const std::uint64_t bytes = tables.voxels[voxel].resident_bytes;
    if (rays_per_byte[voxel] <= 0.0) { break; }
    if (plan.hot_bytes + bytes > budget) { continue; }
    plan.hot.push_back(VoxelId{voxel});
    plan.hot_bytes += bytes;
  }
  return plan;
}

}  // namespace preheat
