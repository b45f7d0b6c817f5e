// The truth that predictions are judged by: a render in this process, everything hot, whose rays
// are counted. The image itself is dropped.
#pragma once

#include <memory>
#include <vector>

#include "cache/counting_tree.h"
#include "common/render_settings.h"
#include "common/result.h"
#include "common/stats.h"
#include "common/store.h"

namespace preheat {

struct CountedRenderOptions {
  unsigned threads = 1;
  AccessCounting count_accesses = AccessCounting::kExact;
  std::shared_ptr<const CountingTree> counting_tree{};  // nullptr: the voxels
};

struct CountedRender {
  // [voxel_count], or [cell_count] of the counting tree; not scaled up where sampled.
  std::vector<CellAccesses> accesses{};
  RayStats rays{};
  double build_seconds = 0.0;  // reading the blocks and building the BVH
  double trace_seconds = 0.0;  // first tile to last, counting included
};

// kStoreDamaged if a block is not what the directory names.
[[nodiscard]] Result<CountedRender> render_counted(const Store& store,
                                                   const RenderSettings& settings,
                                                   const CountedRenderOptions& options);

}  // namespace preheat
