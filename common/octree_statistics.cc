#include "common/octree_statistics.h"

namespace preheat {

OctreeStatistics measure_octree(const Scene& scene, const Octree& octree) {
  return statistics_of(build_octree_summary(scene, octree).sums());
}

OctreeStatistics statistics_of(const OctreeSums& sums) {
  OctreeStatistics statistics;
  statistics.voxels_leaf = sums.leaves_filled;
  statistics.voxels_empty = sums.leaves_empty;
  // Every split makes one internal voxel and seven more leaves.
  statistics.voxels_internal = (statistics.voxels_leaf + statistics.voxels_empty - 1) / 7;
  statistics.level_min = sums.level_min;
  statistics.level_max = sums.level_max;
  statistics.depth_mean = sums.depth_mean();
  statistics.blocking_mean = sums.blocking_mean();
  statistics.objects_per_leaf = sums.objects_per_leaf();
  statistics.traversal_cost = sums.traversal_cost();
  return statistics;
}

}  // namespace preheat
