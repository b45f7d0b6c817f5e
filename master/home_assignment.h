// Gives each cold voxel a home among the workers, and each worker room for the blocks it is home
// of.
//
// Pure and deterministic: ties go to the lower voxel and the worker that comes first.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "common/home_plan.h"
#include "common/scene_tables.h"

namespace preheat {

// What a voxel is expected to be fetched by all workers together. Rays that are in flight at the
// same time share a visit, so that many rays are about as many fetches as there are generations of
// paths in flight, and few rays one fetch each.
[[nodiscard]] std::vector<double> expected_fetches(std::span<const double> rays,
                                                   double generations);

// Room for the blocks that a worker keeps as their home, out of its cache: its part of the cold
// blocks where so many workers share them that this is a small part of the cache and leaves what
// the largest voxel needs to be held. With fewer workers nothing: what it takes is missing
// elsewhere, and a home without room still knows who holds a voxel.
[[nodiscard]] std::uint64_t home_bytes(const SceneTables& tables, std::uint64_t cold_block_bytes,
                                       std::uint64_t cache_limit_bytes, std::size_t workers);

struct HomeCandidate {
  WorkerId worker{};
  std::uint64_t bytes_max = 0;  // of blocks
};

// HomePlan::homes: [voxel_count] index into `workers`, or kNoHome where nothing is fetched. The
// fetches are shared out evenly; a worker stays the home of what it was the home of in `before`
// ([voxel_count], or empty) unless that is more than its share. Room goes to those voxels first
// that are fetched most often; a home without room for one still knows who holds it.
[[nodiscard]] std::vector<std::uint16_t> assign_homes(std::span<const HomeCandidate> workers,
                                                      std::span<const double> fetches,
                                                      std::span<const VoxelEntry> voxels,
                                                      std::span<const WorkerId> before);

}  // namespace preheat
