#include "common/octree_statistics.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <vector>

namespace preheat {
namespace {

struct Leaf {
  Aabb cell{};
  std::uint32_t node = 0;
  std::uint32_t depth = 0;
};

// Areas of the three faces that meet in a corner.
[[nodiscard]] double half_surface(const Vec3& extent) {
  const Vec3d e(extent);
  return e.x * e.y + e.y * e.z + e.z * e.x;
}

// [P] section 2: p_i.
[[nodiscard]] double blocking_factor(const Scene& scene, const Octree& octree, const Leaf& leaf) {
  const OctreeNode& node = octree.nodes[leaf.node];
  double area = 0.0;
  for (std::uint64_t i = 0; i < node.references_count; ++i) {
    const Triangle& triangle = scene.triangles[octree.references[node.references_begin + i]];
    Aabb box;
    for (const std::uint32_t vertex : triangle.vertices) { box.extend(scene.positions[vertex]); }
    // Empty along an axis where only the cell's margin is touched.
    const Vec3 extent =
        glm::max(glm::min(box.high, leaf.cell.high) - glm::max(box.low, leaf.cell.low), Vec3(0.0F));
    area += half_surface(extent);
  }
  return std::min(1.0, area / half_surface(leaf.cell.extent()));
}

[[nodiscard]] std::vector<Leaf> leaves_of(const Octree& octree) {
  std::vector<Leaf> leaves;
  std::vector<Leaf> waiting{{octree.root, 0, 0}};
  while (!waiting.empty()) {
    const Leaf at = waiting.back();
    waiting.pop_back();
    const OctreeNode& node = octree.nodes[at.node];
    if (node.first_child == 0) {
      leaves.push_back(at);
      continue;
    }
    for (unsigned octant = 0; octant < 8; ++octant) {
      waiting.push_back({child_cell(at.cell, octant), node.first_child + octant, at.depth + 1});
    }
  }
  return leaves;
}

}  // namespace

OctreeStatistics measure_octree(const Scene& scene, const Octree& octree) {
  const std::vector<Leaf> leaves = leaves_of(octree);
  std::vector<double> blocking(leaves.size());
  tbb::parallel_for(std::size_t{0}, leaves.size(), [&](std::size_t i) {
    blocking[i] = blocking_factor(scene, octree, leaves[i]);
  });

  OctreeStatistics statistics;
  statistics.voxels_internal = octree.nodes.size() - leaves.size();
  statistics.level_min = leaves.front().depth;
  double surface = 0.0;
  double volume = 0.0;
  for (std::size_t i = 0; i < leaves.size(); ++i) {
    const std::uint32_t depth = leaves[i].depth;
    const bool empty = octree.nodes[leaves[i].node].references_count == 0;
    ++(empty ? statistics.voxels_empty : statistics.voxels_leaf);
    statistics.level_min = std::min(statistics.level_min, depth);
    statistics.level_max = std::max(statistics.level_max, depth);
    const double leaf_surface = std::ldexp(1.0, -2 * static_cast<int>(depth));
    const double leaf_volume = std::ldexp(1.0, -3 * static_cast<int>(depth));
    surface += leaf_surface;
    volume += leaf_volume;
    statistics.depth_mean += leaf_surface * depth;
    statistics.blocking_mean += leaf_volume * blocking[i];
  }
  statistics.depth_mean /= surface;
  statistics.blocking_mean = std::min(1.0, statistics.blocking_mean / volume);
  statistics.objects_per_leaf =
      static_cast<double>(octree.references.size()) / static_cast<double>(leaves.size());
  statistics.traversal_cost = traversal_cost(statistics.depth_mean, statistics.blocking_mean);
  return statistics;
}

double traversal_cost(double depth_mean, double blocking_mean) {
  const double cells = std::exp2(depth_mean);
  const double whole_cells = std::floor(cells);
  const double part = cells - whole_cells;
  if (blocking_mean >= 1.0) { return 1.0; }  // every ray ends in its first cell
  const double log_pass = std::log1p(-blocking_mean);
  double cost = 0.0;
  double pass = 1.0;  // (1 - p)^(i - 1)
  for (double i = 1.0; i <= whole_cells && pass > 0.0; ++i) {
    cost += i * blocking_mean * pass;
    pass *= 1.0 - blocking_mean;
  }
  cost += cells * part * blocking_mean * std::exp(part * log_pass);
  return cost + cells * std::exp(cells * log_pass);
}

}  // namespace preheat
