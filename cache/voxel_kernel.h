// Rays against a voxel's own small tree: the layout of the tree and the kernels that walk it, one
// for each instruction set that tracing may be pinned to.
//
// A kernel meets exactly the triangles that Embree's robust single-ray query would report, with the
// same bits of t, u and v: the test is the one with Pluecker coordinates in Embree's order of
// operations and with its reciprocal, lane by lane. Boxes are tested more generously than Embree
// does. The tests hold both against each other over millions of triangles met.
#pragma once

#include <cstddef>
#include <cstdint>

namespace preheat {

// The boxes of up to 8 children, empty ones inverted.
struct alignas(32) VoxelTreeNode {
  static constexpr unsigned kWidth = 8;
  float faces[6][kWidth];          // low x, y, z, high x, y, z
  std::uint32_t children[kWidth];  // as VoxelTree::root
};

// A group is kGroupWidth triangles that follow each other in the block, the last one perhaps fewer.
// A leaf is up to kLeafGroupsMax groups that follow each other.
struct VoxelTree {
  static constexpr std::uint32_t kGroupWidth = 4;
  static constexpr std::uint32_t kLeaf = 0x80000000U;  // then 2 bits groups - 1, then first group
  static constexpr std::uint32_t kLeafGroupsMax = 4;
  static constexpr std::uint32_t kLeafGroupsShift = 29;
  static constexpr std::uint32_t kFirstGroupMask = (1U << kLeafGroupsShift) - 1;
  static constexpr std::size_t kDepthMax = 32;

  const VoxelTreeNode* nodes = nullptr;
  const void* indices = nullptr;     // [triangle_count * 3] of 16 or 32 bits
  const float* positions = nullptr;  // [vertex_count * 3], 4 readable bytes behind
  bool indices_are_narrow = false;
  std::uint32_t triangle_count = 0;
  std::uint32_t root = 0;  // a node's index, or a leaf
};

struct KernelRay {
  float origin[3];
  float direction[3];
  float reciprocal[3];    // of the direction, finite
  unsigned near_face[3];  // of VoxelTreeNode::faces, where the ray enters a slab and leaves it
  unsigned far_face[3];
  float t_near = 0.0F;
  float t_far = 0.0F;
};

// Called for each triangle that the ray meets in [t_near, t_far], in no particular order. Returns
// the t_far to go on with; below t_near ends the query.
using KernelHit = float (*)(void* context, std::uint32_t triangle, float t, float u, float v);
using VoxelKernel = void (*)(const VoxelTree& tree, const KernelRay& ray, KernelHit hit,
                             void* context);

void trace_voxel_avx2(const VoxelTree& tree, const KernelRay& ray, KernelHit hit, void* context);
void trace_voxel_sse42(const VoxelTree& tree, const KernelRay& ray, KernelHit hit, void* context);

}  // namespace preheat
