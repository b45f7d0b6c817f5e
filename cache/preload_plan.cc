#include "cache/preload_plan.h"

#include <algorithm>
#include <numeric>

#include "cache/tracing.h"

namespace preheat {
namespace {

// Of a cache that cannot hold all that rays enter. A hot triangle is traced about twice as fast as
// one behind a box but takes more than twice the room, and what does not fit is fetched again and
// again: between 0.3 and 0.9 the least was the best at a quarter of the resident size.
constexpr double kShareOfSmallCache = 0.3;

std::uint64_t share_of(std::uint64_t bytes, double share) {
  if (share >= 1.0) { return bytes; }
  return static_cast<std::uint64_t>(share * static_cast<double>(bytes));
}

// The largest voxel that is not hot, as voxels become so one by one.
class LargestCold {
 public:
  explicit LargestCold(const std::vector<VoxelEntry>& voxels)
      : voxels_(voxels), is_hot_(voxels.size(), false), by_size_(voxels.size()) {
    std::iota(by_size_.begin(), by_size_.end(), 0U);
    std::sort(by_size_.begin(), by_size_.end(), [&](std::uint32_t a, std::uint32_t b) {
      return voxels[a].resident_bytes > voxels[b].resident_bytes;
    });
  }

  void make_hot(std::uint32_t voxel) {
    is_hot_[voxel] = true;
    while (largest_ < by_size_.size() && is_hot_[by_size_[largest_]]) { ++largest_; }
  }

  // Bytes of the largest, were `voxel` hot as well; 0 if nothing else is cold.
  [[nodiscard]] std::uint64_t bytes_without(std::uint32_t voxel) const {
    for (std::size_t at = largest_; at < by_size_.size(); ++at) {
      const std::uint32_t candidate = by_size_[at];
      if (candidate != voxel && !is_hot_[candidate]) { return voxels_[candidate].resident_bytes; }
    }
    return 0;
  }

 private:
  const std::vector<VoxelEntry>& voxels_;
  std::vector<bool> is_hot_;
  std::vector<std::uint32_t> by_size_;
  std::size_t largest_ = 0;  // into by_size_
};

// Hot bytes such that, where the cache allows it, every other voxel that a ray is expected to enter
// fits beside them. `order`: the hottest first.
std::uint64_t budget_auto(const std::vector<VoxelEntry>& voxels,
                          const std::vector<std::uint32_t>& order,
                          std::uint64_t cache_limit_bytes) {
  const auto cold_bytes = [&](std::uint32_t voxel) {
    const VoxelEntry& entry = voxels[voxel];
    return std::min(entry.resident_bytes,
                    entry.block_bytes + VoxelMesh::bytes_max(entry.triangle_count));
  };
  std::uint64_t needed = 0;
  for (const std::uint32_t voxel : order) { needed += cold_bytes(voxel); }
  std::uint64_t hot_bytes = 0;
  for (const std::uint32_t voxel : order) {
    needed += voxels[voxel].resident_bytes - cold_bytes(voxel);
    if (needed > cache_limit_bytes) { break; }
    hot_bytes += voxels[voxel].resident_bytes;
  }
  return std::max(hot_bytes, share_of(cache_limit_bytes, kShareOfSmallCache));
}

}  // namespace

PreloadPlan plan_preload(const SceneTables& tables, const Prediction& prediction,
                         std::uint64_t cache_limit_bytes, double share) {
  const std::size_t voxel_count = tables.voxels.size();
  std::vector<double> rays_per_byte(voxel_count, 0.0);
  for (std::size_t voxel = 0; voxel < voxel_count; ++voxel) {
    const auto bytes = std::max<std::uint64_t>(1, tables.voxels[voxel].resident_bytes);
    rays_per_byte[voxel] = prediction.rays(voxel) / static_cast<double>(bytes);
  }
  std::vector<std::uint32_t> order(voxel_count);
  std::iota(order.begin(), order.end(), 0U);
  std::stable_sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) {
    return rays_per_byte[a] > rays_per_byte[b];
  });

  std::erase_if(order, [&](std::uint32_t voxel) { return !(rays_per_byte[voxel] > 0.0); });
  const std::uint64_t budget = share < 0.0 ? budget_auto(tables.voxels, order, cache_limit_bytes)
                                           : share_of(cache_limit_bytes, share);
  LargestCold largest_cold(tables.voxels);
  PreloadPlan plan;
  for (const std::uint32_t voxel : order) {
    const std::uint64_t bytes = tables.voxels[voxel].resident_bytes;
    if (bytes > budget - plan.hot_bytes) { continue; }
    const std::uint64_t room_left = cache_limit_bytes - plan.hot_bytes - bytes;
    if (largest_cold.bytes_without(voxel) > room_left) { continue; }
    plan.hot.push_back(VoxelId{voxel});
    plan.hot_bytes += bytes;
    largest_cold.make_hot(voxel);
  }
  return plan;
}

}  // namespace preheat
