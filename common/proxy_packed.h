// The proxy as it is stored: between the builder, the bytes and the value.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/proxy.h"

namespace preheat {

// What is stored. A node is inner or a leaf by its parent's leaf mask, a voxel's root by
// root_inner.
struct PackedProxy {
  struct InnerNode {
    std::uint8_t child_mask = 0;
    std::uint8_t leaf_mask = 0;  // which of the children are leaves
  };
  std::vector<Aabb> cells{};
  std::vector<std::uint8_t> root_inner{};  // [voxel_count]
  std::vector<InnerNode> inner{};          // in the order of Proxy::nodes
  std::vector<ProxyRecord> records{};
  std::vector<std::uint32_t> materials{};
};

// The encoded proxy: this header, materials, cells, root_inner, inner nodes, records, without
// padding.
struct PackedProxyHeader {
  std::uint32_t magic = 0x50525850;  // "PXRP"
  std::uint32_t voxel_count = 0;
  std::uint32_t material_count = 0;
  std::uint32_t inner_count = 0;
  std::uint32_t record_count = 0;
};

using PackedCell = std::array<float, 6>;  // low, high
inline constexpr std::size_t kPackedCellBytes = sizeof(PackedCell);
inline constexpr std::size_t kPackedInnerNodeBytes = 2;

// Rebuilds the nodes with their bounds, and checks what they rely on.
[[nodiscard]] Result<Proxy> expand_proxy(PackedProxy packed);

}  // namespace preheat
