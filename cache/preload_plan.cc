#include "cache/preload_plan.h"

#include <algorithm>
#include <numeric>

#include "cache/tracing.h"
#include "common/voxel_block.h"

namespace preheat {
namespace {

// Of a cache that cannot hold all that rays enter. A hot triangle is traced 1.7 to 2 times as fast
// as one behind a box but takes nearly four times the room, and what does not fit is fetched again
// and again. On three scenes at 3 to 29 % of the resident size 0.5 took 5 % less time than 0.3 on
// the average, and a tenth more bytes, where nearly all fits up to twice as many.
constexpr double kShareOfSmallCache = 0.5;

std::uint64_t share_of(std::uint64_t bytes, double share) {
  if (share >= 1.0) { return bytes; }
  return static_cast<std::uint64_t>(share * static_cast<double>(bytes));
}

// Fewer expected rays than this in the whole frame, and a voxel is not worth fetching unasked.
constexpr double kWarmRaysMin = 1.0;

// A voxel that no sample met and that has fewer rays than this by its neighbours. From 10 to 30 a
// third of mgf_cruiser's were entered after all, from 30 to 300 three in five, of all of them one
// in four; of mgf_conference's all, nearly all and seven in eight.
constexpr double kUnseenRaysMin = 12.0;

// Of a voxel with a tree of its own.
std::uint64_t cold_bytes(const VoxelEntry& entry) {
  return std::min(entry.resident_bytes,
                  entry.block_bytes + VoxelMesh::bytes_max(entry.triangle_count));
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

double surface_area(const Aabb& bounds) {
  const Vec3 extent = bounds.extent();
  return 2.0 * (double{extent.x} * double{extent.y} + double{extent.y} * double{extent.z} +
                double{extent.z} * double{extent.x});
}

// That no sample of a model that samples met is not that no ray will: a few thousand paths stand
// for millions. Of such a voxel this takes the rays to be those of the smallest octree node around
// it that samples met, by its share of the surface of the voxels below.
class UnseenVoxels {
 public:
  UnseenVoxels(const SceneTables& tables, const Prediction& prediction)
      : tables_(tables), prediction_(prediction), rays_(tables.voxels.size(), 0.0) {
    if (prediction.rays_error.empty() || tables.voxel_nodes.empty()) { return; }
    std::vector<std::uint32_t> unseen;
    add(tables.voxel_nodes.front(), unseen);
  }

  // Those that are worth fetching unasked, most rays per byte first.
  [[nodiscard]] std::vector<std::uint32_t> likely() const {
    std::vector<std::uint32_t> voxels;
    for (std::uint32_t voxel = 0; voxel < rays_.size(); ++voxel) {
      if (rays_[voxel] >= kUnseenRaysMin) { voxels.push_back(voxel); }
    }
    const auto rays_per_byte = [this](std::uint32_t voxel) {
      return rays_[voxel] / static_cast<double>(cold_bytes(tables_.voxels[voxel]));
    };
    std::stable_sort(voxels.begin(), voxels.end(), [&](std::uint32_t a, std::uint32_t b) {
      return rays_per_byte(a) > rays_per_byte(b);
    });
    return voxels;
  }

 private:
  struct Sum {
    double rays = 0.0;
    double area = 0.0;
  };

  // Of the voxels below; appends to `unseen` those whose node is above.
  Sum add(const VoxelNode& node, std::vector<std::uint32_t>& unseen) {
    if (node.count == 0) {
      const Sum leaf{prediction_.rays(node.first), surface_area(tables_.voxels[node.first].bounds)};
      if (!(leaf.rays > 0.0)) { unseen.push_back(node.first); }
      return leaf;
    }
    Sum sum;
    std::vector<std::uint32_t> below;
    for (std::uint32_t child = 0; child < node.count; ++child) {
      const Sum part = add(tables_.voxel_nodes[node.first + child], below);
      sum.rays += part.rays;
      sum.area += part.area;
    }
    if (sum.rays > 0.0) {
      for (const std::uint32_t voxel : below) {
        const double area = surface_area(tables_.voxels[voxel].bounds);
        rays_[voxel] = sum.area > 0.0 ? sum.rays * area / sum.area : 0.0;
      }
    } else {
      unseen.insert(unseen.end(), below.begin(), below.end());
    }
    return sum;
  }

  const SceneTables& tables_;
  const Prediction& prediction_;
  std::vector<double> rays_;  // [voxel_count]; 0 of what samples met
};

// Hot bytes such that, where the cache allows it, every other voxel that a ray is expected to enter
// fits beside them. `order`: the hottest first; `unseen`: likely to be entered all the same.
std::uint64_t budget_auto(const std::vector<VoxelEntry>& voxels,
                          const std::vector<std::uint32_t>& order,
                          const std::vector<std::uint32_t>& unseen,
                          std::uint64_t cache_limit_bytes) {
  std::uint64_t needed = 0;
  for (const std::uint32_t voxel : order) { needed += cold_bytes(voxels[voxel]); }
  for (const std::uint32_t voxel : unseen) { needed += cold_bytes(voxels[voxel]); }
  std::uint64_t hot_bytes = 0;
  for (const std::uint32_t voxel : order) {
    const std::uint64_t bytes = voxels[voxel].hot_bytes();
    needed += bytes - std::min(bytes, cold_bytes(voxels[voxel]));
    if (needed > cache_limit_bytes) { break; }
    hot_bytes += bytes;
  }
  return std::max(hot_bytes, share_of(cache_limit_bytes, kShareOfSmallCache));
}

// As far as there is room. `order`: what is to be warm or is hot.
void add_warm(PreloadPlan& plan, const SceneTables& tables, const std::vector<std::uint32_t>& order,
              std::uint64_t cache_limit_bytes) {
  std::vector<bool> is_hot(tables.voxels.size(), false);
  for (const VoxelId voxel : plan.hot) { is_hot[index_of(voxel)] = true; }
  std::uint64_t room = cache_limit_bytes - plan.hot_bytes;
  for (const std::uint32_t voxel : order) {
    const std::uint64_t bytes = cold_bytes(tables.voxels[voxel]);
    if (is_hot[voxel] || bytes > room) { continue; }
    plan.warm.push_back(VoxelId{voxel});
    room -= bytes;
  }
}

}  // namespace

PreloadPlan plan_preload(const SceneTables& tables, const Prediction& prediction,
                         std::uint64_t cache_bytes, double share) {
  const std::uint64_t cache_limit_bytes = cache_bytes - std::min(cache_bytes, kBvhBytesFixed);
  const std::size_t voxel_count = tables.voxels.size();
  std::vector<double> rays_per_byte(voxel_count, 0.0);
  for (std::size_t voxel = 0; voxel < voxel_count; ++voxel) {
    const auto bytes = std::max<std::uint64_t>(1, tables.voxels[voxel].hot_bytes());
    rays_per_byte[voxel] = prediction.rays(voxel) / static_cast<double>(bytes);
  }
  std::vector<std::uint32_t> order(voxel_count);
  std::iota(order.begin(), order.end(), 0U);
  std::stable_sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) {
    return rays_per_byte[a] > rays_per_byte[b];
  });

  std::erase_if(order, [&](std::uint32_t voxel) { return !(rays_per_byte[voxel] > 0.0); });
  const bool is_auto = share < 0.0;
  std::vector<std::uint32_t> unseen;
  if (is_auto) { unseen = UnseenVoxels(tables, prediction).likely(); }
  const std::uint64_t budget = is_auto
                                   ? budget_auto(tables.voxels, order, unseen, cache_limit_bytes)
                                   : share_of(cache_limit_bytes, share);
  LargestCold largest_cold(tables.voxels);
  PreloadPlan plan;
  for (const std::uint32_t voxel : order) {
    const std::uint64_t bytes = tables.voxels[voxel].hot_bytes();
    if (bytes > budget - plan.hot_bytes) { continue; }
    const std::uint64_t room_left = cache_limit_bytes - plan.hot_bytes - bytes;
    if (largest_cold.bytes_without(voxel) > room_left) { continue; }
    plan.hot.push_back(VoxelId{voxel});
    plan.hot_bytes += bytes;
    largest_cold.make_hot(voxel);
  }
  if (is_auto) {
    std::erase_if(order,
                  [&](std::uint32_t voxel) { return prediction.rays(voxel) < kWarmRaysMin; });
    order.insert(order.end(), unseen.begin(), unseen.end());
    add_warm(plan, tables, order, cache_limit_bytes);
  }
  return plan;
}

}  // namespace preheat
