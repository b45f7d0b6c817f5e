// A voxel's own tree over the triangles of its block, in the order that they have there: a tenth of
// what Embree takes, and built in a fraction of the time. Finds what Embree would find, bit by bit
// (see voxel_kernel.h).
//
// Boxes are grown by kVoxelMargin, so that the rounding of a slab test loses nothing.
// Threads: immutable after construction.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "cache/voxel_kernel.h"
#include "common/ray.h"
#include "common/voxel_block.h"

namespace preheat {

class VoxelBvh {
 public:
  // The block's bytes outlive this. Requires: a block with triangles.
  explicit VoxelBvh(const VoxelBlockView& block);

  [[nodiscard]] VoxelTree tree() const {
    return {nodes_.data(),        indices_.data(), positions_,
            indices_.is_narrow(), triangle_count_, root_};
  }

  [[nodiscard]] std::uint64_t bytes() const { return nodes_.capacity() * sizeof(VoxelTreeNode); }
  // What bytes() never exceeds.
  [[nodiscard]] static std::uint64_t bytes_max(std::uint64_t triangle_count);

 private:
  PackedIndices indices_;
  const float* positions_;
  std::uint32_t triangle_count_;
  std::uint32_t root_ = 0;
  std::vector<VoxelTreeNode> nodes_;
};

// A ray with the reciprocals that the kernels need.
[[nodiscard]] KernelRay kernel_ray(const Ray& ray, float t_far);

// The kernel of tracing_isa().
[[nodiscard]] VoxelKernel voxel_kernel();

}  // namespace preheat
