// What [P] says of an octree: the rows of its Table 1 and the averages of its section 2.
#pragma once

#include <cstdint>

#include "common/blocking.h"
#include "common/octree.h"
#include "common/octree_summary.h"
#include "common/scene.h"

namespace preheat {

struct OctreeStatistics {
  std::uint64_t voxels_internal = 0;
  std::uint64_t voxels_leaf = 0;   // non-empty leaves
  std::uint64_t voxels_empty = 0;  // empty leaves
  std::uint32_t level_min = 0;     // of leaves, empty or not; the root's level is 0
  std::uint32_t level_max = 0;
  double depth_mean = 0.0;        // D-bar: depth of the leaves by their surface
  double blocking_mean = 0.0;     // p-bar: blocking factors by the leaves' volume
  double objects_per_leaf = 0.0;  // m-bar: triangles per leaf, empty leaves included
  double traversal_cost = 0.0;    // C_t: leaves that a ray traverses
};

// Same result on any number of threads. An object's box counts as far as it lies in the leaf, and a
// blocking factor is at most 1: the paper's sum exceeds it where boxes hide one another.
[[nodiscard]] OctreeStatistics measure_octree(const Scene& scene, const Octree& octree);

// The same of what a store keeps of its octree.
[[nodiscard]] OctreeStatistics statistics_of(const OctreeSums& sums);

}  // namespace preheat
