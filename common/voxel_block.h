// The bytes of one voxel: what is stored, hashed, sent and cached.
//
// Layout, little-endian, every section 16-byte aligned and padded with zeros:
//   header     magic u32, vertex_count u32, triangle_count u32, flags u32 (bit 0: has normals)
//   positions  float [vertex_count * 3], scene frame, followed by at least 4 bytes of padding, as
//              Embree reads 16 bytes per vertex
//   normals    u32 [vertex_count], octahedral 2 x 16 bit, 0 = use the geometric normal; if flagged
//   indices    [triangle_count * 3], counting the block's vertices: u16 if there are at most 2^16,
//              else u32
//   materials  u16 [triangle_count]
//   triangles  u32 [triangle_count], global triangle ids
// Triangles are in the order of triangle_order.h and vertices in that of their first use, so that a
// tree over a block needs no lists of its own and neighbours share cache lines.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "common/packed_indices.h"
#include "common/result.h"
#include "common/scene.h"
#include "common/vec3.h"

namespace preheat {

// Blocks count materials with 16 bits; a scene of more is rejected when it is compiled.
inline constexpr std::size_t kMaterialCountMax = std::size_t{1} << 16U;

// Views into a block's bytes, valid while they live.
struct VoxelBlockView {
  std::span<const float> positions{};          // [vertex_count * 3]
  std::span<const std::uint32_t> normals{};    // [vertex_count] or empty
  PackedIndices indices{};                     // [triangle_count * 3]
  std::span<const std::uint16_t> materials{};  // [triangle_count]
  std::span<const std::uint32_t> triangles{};  // [triangle_count]
};

// Bytes of a block before it exists.
[[nodiscard]] std::size_t voxel_block_bytes(std::size_t vertex_count, std::size_t triangle_count,
                                            bool has_normals);

// Of the bound below, for a BVH and for each of its triangles.
inline constexpr std::uint64_t kBvhBytesFixed = 6144;
inline constexpr std::uint64_t kBvhBytesPerTriangle = 104;

// Never less than what Embree holds for a voxel's BVH (robust, medium quality), in steps of its own
// allocator, and the 6 bytes a triangle that its indices take beyond a block's. Of 37,000 subtrees
// of real scenes and hostile soups, 1 to 200,000 triangles, on avx2 and sse4.2 and with 1 and 2
// build threads, Embree 3.13 took at most 93 % of it without those, and in real scenes at most
// 80 %; above 1,000 triangles the mean is 67 %.
[[nodiscard]] constexpr std::uint64_t bvh_bytes_bound(std::uint64_t triangle_count) {
  return kBvhBytesFixed + kBvhBytesPerTriangle * triangle_count;
}

// The block of the given triangles of the scene. `triangle_ids` strictly increasing.
[[nodiscard]] std::vector<std::byte> encode_voxel_block(
    const Scene& scene, std::span<const std::uint32_t> triangle_ids);

// Checks everything that a reader relies on: counts against bytes, indices, finite positions,
// materials below `material_count`. Bytes must be 16-byte aligned.
[[nodiscard]] Result<VoxelBlockView> view_voxel_block(std::span<const std::byte> bytes,
                                                      std::size_t material_count);

// Octahedral encoding of unit vectors in 2 x 16 bits (Cigolle et al., JCGT 2014); error below
// 0.004 degrees. 0 is kept for "no normal". Decoding uses + - * / and sqrt only.
[[nodiscard]] std::uint32_t encode_normal(const Vec3& unit);
[[nodiscard]] Vec3 decode_normal(std::uint32_t code);

}  // namespace preheat
