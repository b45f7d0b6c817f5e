#include "master/home_assignment.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <set>
#include <unordered_map>
#include <utility>

#include "common/check.h"

namespace preheat {
namespace {

// Of a cache, at most.
constexpr std::uint64_t kHomePart = 20;
// A worker may have so much more than its share before voxels move away from it.
constexpr double kShareSlack = 1.05;
// So many of the least loaded workers are asked for room before one without room becomes the home.
constexpr std::size_t kLooks = 8;

// The workers by what they have been given so far.
class Loads {
 public:
  explicit Loads(std::span<const HomeCandidate> workers) : loads_(workers.size()) {
    for (const HomeCandidate& worker : workers) { room_.push_back(worker.bytes_max); }
    for (std::size_t worker = 0; worker < workers.size(); ++worker) {
      order_.insert({0.0, worker});
    }
  }

  // True if the worker has room for it.
  bool give(std::size_t worker, double fetches, std::uint64_t bytes) {
    order_.erase({loads_[worker], worker});
    loads_[worker] += fetches;
    order_.insert({loads_[worker], worker});
    if (room_[worker] < bytes) { return false; }
    room_[worker] -= bytes;
    return true;
  }

  // The least loaded one with room; if there is none among the first, the least loaded.
  [[nodiscard]] std::size_t best(std::uint64_t bytes) const {
    std::size_t looks = 0;
    for (const auto& [load, worker] : order_) {
      if (room_[worker] >= bytes) { return worker; }
      if (++looks == kLooks) { break; }
    }
    return order_.begin()->second;
  }

  [[nodiscard]] double load(std::size_t worker) const { return loads_[worker]; }

 private:
  std::vector<double> loads_;
  std::vector<std::uint64_t> room_;
  std::set<std::pair<double, std::size_t>> order_;
};

}  // namespace

std::vector<double> expected_fetches(std::span<const double> rays, double generations) {
  CHECK(generations > 0.0);
  std::vector<double> fetches;
  fetches.reserve(rays.size());
  for (const double expected : rays) {
    fetches.push_back(-generations * std::expm1(-std::max(expected, 0.0) / generations));
  }
  return fetches;
}

std::uint64_t home_bytes(const SceneTables& tables, std::uint64_t cold_block_bytes,
                         std::uint64_t cache_limit_bytes, std::size_t workers) {
  const std::uint64_t smallest = tables.resident_bytes_min();
  if (workers < 2 || cache_limit_bytes <= smallest) { return 0; }
  const std::uint64_t share = cold_block_bytes / workers;
  const std::uint64_t room = std::min(cache_limit_bytes / kHomePart, cache_limit_bytes - smallest);
  return share <= room ? share : 0;
}

std::vector<std::uint16_t> assign_homes(std::span<const HomeCandidate> workers,
                                        std::span<const double> fetches,
                                        std::span<const VoxelEntry> voxels,
                                        std::span<const WorkerId> before) {
  CHECK(workers.size() <= kPeersMax && fetches.size() == voxels.size());
  std::vector<std::uint16_t> homes(voxels.size(), HomePlan::kNoHome);
  if (workers.empty()) { return homes; }
  std::unordered_map<WorkerId, std::size_t> index_of_worker;
  for (std::size_t i = 0; i < workers.size(); ++i) { index_of_worker[workers[i].worker] = i; }
  std::vector<std::uint32_t> order;
  double total = 0.0;
  for (std::uint32_t voxel = 0; voxel < voxels.size(); ++voxel) {
    if (!(fetches[voxel] > 0.0)) { continue; }
    order.push_back(voxel);
    total += fetches[voxel];
  }
  std::stable_sort(order.begin(), order.end(),
                   [&](std::uint32_t a, std::uint32_t b) { return fetches[a] > fetches[b]; });
  const double share = total / static_cast<double>(workers.size()) * kShareSlack;

  Loads loads(workers);
  const auto give = [&](std::uint32_t voxel, std::size_t worker) {
    const bool kept = loads.give(worker, fetches[voxel], voxels[voxel].block_bytes);
    homes[voxel] = static_cast<std::uint16_t>(worker | (kept ? HomePlan::kKept : 0U));
  };
  for (const std::uint32_t voxel : order) {
    if (before.empty()) { break; }
    const auto known = index_of_worker.find(before[voxel]);
    if (known == index_of_worker.end()) { continue; }
    if (loads.load(known->second) + fetches[voxel] <= share) { give(voxel, known->second); }
  }
  for (const std::uint32_t voxel : order) {
    if (homes[voxel] == HomePlan::kNoHome) { give(voxel, loads.best(voxels[voxel].block_bytes)); }
  }
  return homes;
}

}  // namespace preheat
