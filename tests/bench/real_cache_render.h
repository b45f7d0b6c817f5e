// A render in this process whose cold voxels come from the store when they are asked for, as a
// worker's come from the network: what a policy really fetches.
#pragma once

#include <string>
#include <vector>

#include "cache/renderer.h"
#include "common/store.h"

namespace preheat {

struct RealCacheRender {
  std::string pixels_sha256{};
  CacheStats cache{};
  double user_seconds = 0.0;  // of the processor, all threads, from the first tile to the last
};

[[nodiscard]] Result<RealCacheRender> render_with_cache(const Store& store,
                                                        const RenderSettings& settings,
                                                        const RendererOptions& options,
                                                        const std::vector<VoxelId>& hot);

}  // namespace preheat
