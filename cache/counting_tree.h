// What a render counts accesses in, where that is not the scene's voxels: e.g. the leaves of the
// fine octree, whose traversals [P] predicts.
#pragma once

#include <cstddef>
#include <vector>

#include "common/scene_tables.h"

namespace preheat {

struct CountingTree {
  std::vector<VoxelNode> nodes{};  // as SceneTables::voxel_nodes; a leaf's `first` is its cell
  std::size_t cell_count = 0;      // every leaf's `first` is below this
};

}  // namespace preheat
