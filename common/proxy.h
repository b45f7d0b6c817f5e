// What prediction knows of a scene: one small record per proxy leaf, and no triangle.
//
// Below every voxel's octree node hangs a proxy tree. Its cells are octree cells, but they are
// split where a ray's fate is uncertain and left whole where one record tells it: a bare wall is
// one leaf however many triangles it has, a chair gets many. A record says where the geometry of
// its cell lies, how likely it stops a ray, and of what material it is.
//
// Bound: the encoded proxy is at most kProxyShareMax of what else the store is known to hold, but
// has at least one record per voxel. Same bytes on any number of threads.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "common/octree.h"
#include "common/result.h"
#include "common/scene.h"
#include "common/scene_tables.h"

namespace preheat {

inline constexpr double kProxyShareMax = 0.108;  // of the rest: less than a tenth of the whole
inline constexpr unsigned kProxyDepthMax = 24;   // levels below a voxel
inline constexpr float kProxyExtentMin = 2.0F * kVoxelMargin;  // of a leaf's bounds along an axis

// The geometry inside one cell, as stored, little-endian.
//
// A *flat* leaf holds geometry near one plane: a ray that crosses the plane inside the bounds stops
// there with probability coverage[0] where the mask has geometry. For convex planar pieces, which
// real scenes mostly hold, this is exact, where the ratio of projected areas,
// sum_k |d_k| A_k * chord / volume, stops too few of the rays whose chord is long (it is cut at 1)
// and lets their reflections begin inside the cell.
//
// Any other leaf is *scattered* over the occupied ones of 4 x 4 x 4 blocks of its bounds. A ray
// straight along axis k passes an occupied block with probability 1 - coverage[k], so that the
// geometry's shadow along k is as large as the true one, a union, in which layers do not count
// twice. A chord of length l in direction d through occupied blocks of extent e passes with
// probability exp(-l * |v|), v_k = d_k * -ln(1 - coverage[k]) / e_k. Of what has faces along the
// axes the norm is the sum of the components, as the shadow of a box is; of what has normals in all
// directions it is the length, as the shadow of an ellipsoid is. roundness mixes the two: the sum
// would stop half as many rays again as a sphere does.
struct ProxyRecord {
  std::array<std::uint16_t, 2> normal{};  // encode_normal of the mean by area, low half first
  std::array<std::uint16_t, 4> mask{};    // flat: 8 x 8 squares of the face that the plane's normal
                                          // sees most of; scattered: 4 x 4 x 4 blocks. Bit of
                                          // (x, y, z): see flat_bit and block_bit
  std::uint16_t material_major = 0;   // into Proxy::materials. Flat: what the normal's side shows
  std::uint16_t material_minor = 0;   // most, and the other side; scattered: the two seen most
  std::array<std::uint8_t, 3> low{};  // bounds in 255ths of the cell, rounded outwards
  std::array<std::uint8_t, 3> high{};
  std::array<std::uint8_t, 3> coverage{};  // 255ths
  // Flat: 65535ths of the range of normal . x over the bounds at which the plane lies, low byte
  // first. Scattered: of each axis, how often the minor material is seen of both, 15ths, from the
  // low side (low half of the byte) and from the high side.
  std::array<std::uint8_t, 3> place{};
  // Flat: its thickness across the plane, 255ths of the diagonal; scattered: its roundness, 255ths.
  std::uint8_t thickness = 0;
  std::uint8_t shape = 0;  // kShape* bits
};
inline constexpr std::uint8_t kShapeFlat = 1;
inline constexpr std::uint8_t kShapeOriented = 2;  // the normals agree on a side
// Scattered: the roundness of either material's own surfaces, 7ths: a pipe's is not its wall's.
inline constexpr unsigned kShapeMajorRoundness = 2;  // the lowest of three bits
inline constexpr unsigned kShapeMinorRoundness = 5;
static_assert(sizeof(ProxyRecord) == 30);

[[nodiscard]] constexpr unsigned flat_bit(unsigned u, unsigned v) { return v * 8 + u; }
[[nodiscard]] constexpr unsigned block_bit(unsigned x, unsigned y, unsigned z) {
  return (z * 4 + y) * 4 + x;
}
[[nodiscard]] Vec3 record_normal(const ProxyRecord& record);

[[nodiscard]] inline std::uint64_t record_mask(const ProxyRecord& record) {
  std::uint64_t mask = 0;
  for (std::size_t part = record.mask.size(); part-- > 0;) {
    mask = mask << 16U | record.mask[part];
  }
  return mask;
}

// The axis along which a flat record's mask looks, and the axes of its columns and rows.
struct FlatAxes {
  int axis = 0;
  int u = 1;
  int v = 2;
};
[[nodiscard]] constexpr FlatAxes axes_along(int axis) {
  return {axis, axis == 2 ? 0 : axis + 1, axis == 0 ? 2 : axis - 1};
}
[[nodiscard]] inline FlatAxes flat_axes(const Vec3& normal) {
  const Vec3 a = glm::abs(normal);
  return axes_along(a.x >= a.y ? (a.x >= a.z ? 0 : 2) : (a.y >= a.z ? 1 : 2));
}

// Where the record's geometry lies, in the scene frame.
[[nodiscard]] Aabb record_bounds(const ProxyRecord& record, const Aabb& cell);
[[nodiscard]] float record_roundness(const ProxyRecord& record, bool of_minor);
// How often a scattered record's minor material is seen of both by rays along the axis.
[[nodiscard]] float record_minor_share(const ProxyRecord& record, int axis, bool from_low_side);

// What normal . x may be inside the bounds.
struct PlaneRange {
  float low = 0.0F;
  float high = 0.0F;
};
[[nodiscard]] inline PlaneRange plane_range(const Vec3& normal, const Aabb& bounds) {
  const float middle = glm::dot(normal, 0.5F * (bounds.low + bounds.high));
  const float half = glm::dot(glm::abs(normal), 0.5F * bounds.extent());
  return {middle - half, middle + half};
}

// normal . x on a flat record's plane. `normal` is the record's, decoded.
[[nodiscard]] inline float record_plane_offset(const ProxyRecord& record, const Vec3& normal,
                                               const Aabb& bounds) {
  const PlaneRange range = plane_range(normal, bounds);
  const auto offset = static_cast<float>(record.place[0] | unsigned{record.place[1]} << 8U);
  return range.low + (range.high - range.low) * (offset * (1.0F / 65535.0F));
}
// `share` in [0,1] of the range of normal . x over the bounds.
void set_record_plane(ProxyRecord& record, float share);

struct ProxyNode {
  Aabb bounds{};                // of the geometry below
  std::uint32_t first = 0;      // inner: its first child in Proxy::nodes; leaf: into Proxy::records
  std::uint8_t child_mask = 0;  // bit i: octant i has geometry; the children follow in that order.
                                // 0 = leaf
};

struct Proxy {
  std::vector<Aabb> cells{};               // [voxel_count] the octree cell of each voxel
  std::vector<std::uint32_t> roots{};      // [voxel_count] into nodes
  std::vector<ProxyNode> nodes{};          // of each voxel breadth first, voxels in order
  std::vector<ProxyRecord> records{};      // in the order of the leaves in `nodes`
  std::vector<std::uint32_t> materials{};  // material ids that records refer to, by first use
};

// `voxel_roots[v]` is the octree node whose subtree is voxel v; the nodes above it hold no leaf
// with references. The store holds `store_bytes_other` beside the voxel blocks and their directory.
[[nodiscard]] Proxy build_proxy(const Scene& scene, const Octree& octree,
                                std::span<const std::uint32_t> voxel_roots,
                                std::uint64_t store_bytes_other = 0);

[[nodiscard]] std::vector<std::byte> encode_proxy(const Proxy& proxy);

// Every index, cell and count is checked; material ids must be checked against the scene's tables
// by who joins the two.
[[nodiscard]] Result<Proxy> decode_proxy(std::span<const std::byte> bytes, std::size_t voxel_count);

}  // namespace preheat
