// What prediction knows of a scene: one small record per fine octree leaf, and no triangle.
//
// At most 10 % of the store (DESIGN section 2).
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "common/octree.h"
#include "common/result.h"
#include "common/scene.h"

namespace preheat {

struct Proxy {
  std::vector<std::byte> placeholder{};
};

// `voxel_roots[v]` is the octree node whose subtree is voxel v; the nodes above it hold no leaf with
// references.
[[nodiscard]] Proxy build_proxy(const Scene& scene, const Octree& octree,
                                std::span<const std::uint32_t> voxel_roots);

[[nodiscard]] std::vector<std::byte> encode_proxy(const Proxy& proxy);
[[nodiscard]] Result<Proxy> decode_proxy(std::span<const std::byte> bytes,
                                         std::size_t voxel_count);

}  // namespace preheat
