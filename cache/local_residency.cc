#include "cache/local_residency.h"

#include <fmt/format.h>

#include <cstdint>
#include <vector>

namespace preheat {

Result<void> deliver_from(const Store& store, VoxelId voxel, Renderer& renderer) {
  if (!store.block_is_intact(voxel)) {
    return fail(ExitCode::kStoreDamaged,
                fmt::format("store damaged: voxel {} does not have the content that its "
                            "directory names",
                            index_of(voxel)));
  }
  return renderer.deliver(voxel, VoxelBytes{store.block(voxel), nullptr});
}

Result<void> make_everything_hot(const Store& store, Renderer& renderer) {
  std::vector<VoxelId> voxels;
  for (std::uint32_t voxel = 0; voxel < store.tables().voxels.size(); ++voxel) {
    voxels.push_back(VoxelId{voxel});
  }
  renderer.set_hot_voxels(voxels);
  for (const VoxelId voxel : voxels) {
    if (auto delivered = deliver_from(store, voxel, renderer); !delivered) { return delivered; }
  }
  return {};
}

}  // namespace preheat
