// A renderer whose voxels all come from a store in this process, every one of them hot.
#pragma once

#include "cache/renderer.h"
#include "common/result.h"
#include "common/store.h"

namespace preheat {

// Hands the renderer a block of the mapping, which the store must keep for as long as the renderer
// lives. kStoreDamaged if the block is not what the directory names.
[[nodiscard]] Result<void> deliver_from(const Store& store, VoxelId voxel, Renderer& renderer);

// Makes every voxel hot and delivers it. Instead of Renderer::set_hot_voxels.
[[nodiscard]] Result<void> make_everything_hot(const Store& store, Renderer& renderer);

}  // namespace preheat
