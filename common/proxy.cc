#include "common/proxy.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <string>
#include <type_traits>
#include <utility>

#include "common/proxy_packed.h"
#include "common/voxel_block.h"

namespace preheat {
namespace {

static_assert(std::endian::native == std::endian::little);

tl::unexpected<Error> damaged(const std::string& what) {
  return fail(ExitCode::kStoreDamaged, "proxy: " + what);
}

// Rebuilds the nodes with their bounds, and checks what the nodes rely on.
class Expander {
 public:
  explicit Expander(PackedProxy packed) : packed_(std::move(packed)) {}

  Result<Proxy> expand() {
    for (std::size_t voxel = 0; voxel < packed_.cells.size(); ++voxel) {
      const Result<void> done = expand_voxel(voxel);
      if (!done) { return tl::unexpected<Error>(done.error()); }
    }
    if (inner_taken_ != packed_.inner.size() || records_taken_ != packed_.records.size()) {
      return damaged("nodes or records that no voxel owns");
    }
    proxy_.cells = std::move(packed_.cells);
    proxy_.records = std::move(packed_.records);
    proxy_.materials = std::move(packed_.materials);
    return std::move(proxy_);
  }

 private:
  struct Pending {
    Aabb cell{};
    unsigned depth = 0;
    bool is_leaf = false;
  };

  Result<void> expand_voxel(std::size_t voxel) {
    const std::size_t begin = proxy_.nodes.size();
    proxy_.roots.push_back(static_cast<std::uint32_t>(begin));
    proxy_.nodes.emplace_back();
    pending_.assign(1, {packed_.cells[voxel], 0, packed_.root_inner[voxel] == 0});
    for (std::size_t at = 0; at < pending_.size(); ++at) {
      const Pending pending = pending_[at];
      if (pending.is_leaf) {
        if (records_taken_ == packed_.records.size()) { return damaged("too few records"); }
        proxy_.nodes[begin + at].first = static_cast<std::uint32_t>(records_taken_);
        proxy_.nodes[begin + at].bounds =
            record_bounds(packed_.records[records_taken_++], pending.cell);
        continue;
      }
      if (inner_taken_ == packed_.inner.size()) { return damaged("too few nodes"); }
      if (pending.depth == kProxyDepthMax) { return damaged("a tree deeper than 24 levels"); }
      const PackedProxy::InnerNode inner = packed_.inner[inner_taken_++];
      if (inner.child_mask == 0 || (inner.leaf_mask & ~inner.child_mask) != 0) {
        return damaged("a node with impossible children");
      }
      proxy_.nodes[begin + at].child_mask = inner.child_mask;
      proxy_.nodes[begin + at].first = static_cast<std::uint32_t>(proxy_.nodes.size());
      for (unsigned octant = 0; octant < 8; ++octant) {
        if ((inner.child_mask >> octant & 1U) == 0) { continue; }
        pending_.push_back({child_cell(pending.cell, octant), pending.depth + 1,
                            (inner.leaf_mask >> octant & 1U) != 0});
        proxy_.nodes.emplace_back();
      }
    }
    for (std::size_t node = proxy_.nodes.size(); node-- > begin;) { join_children(node); }
    return {};
  }

  void join_children(std::size_t node) {
    const int count = std::popcount(proxy_.nodes[node].child_mask);
    for (int child = 0; child < count; ++child) {
      const std::size_t at = proxy_.nodes[node].first + static_cast<std::size_t>(child);
      proxy_.nodes[node].bounds.extend(proxy_.nodes[at].bounds);
    }
  }

  PackedProxy packed_;
  Proxy proxy_;
  std::vector<Pending> pending_;
  std::size_t inner_taken_ = 0;
  std::size_t records_taken_ = 0;
};

template <class T>
void append(std::vector<std::byte>& bytes, const std::vector<T>& values) {
  const std::size_t end = bytes.size();
  bytes.resize(end + values.size() * sizeof(T));
  if (!values.empty()) {
    std::memcpy(bytes.data() + end, values.data(), values.size() * sizeof(T));
  }
}

// Requires: the bytes hold so many values; the whole length was checked against the header.
template <class T>
void take(std::span<const std::byte>& bytes, std::vector<T>& values, std::size_t count) {
  static_assert(std::is_trivially_copyable_v<T>);
  values.resize(count);
  if (count > 0) { std::memcpy(values.data(), bytes.data(), count * sizeof(T)); }
  bytes = bytes.subspan(count * sizeof(T));
}

bool is_cell(const Aabb& cell) {
  for (int axis = 0; axis < 3; ++axis) {
    const bool inside = cell.low[axis] >= -4.0F && cell.high[axis] <= 4.0F;  // false for NaN
    if (!inside || !(cell.low[axis] < cell.high[axis])) { return false; }
  }
  return true;
}

Result<void> check_packed(const PackedProxy& packed) {
  if (!std::all_of(packed.cells.begin(), packed.cells.end(), is_cell)) {
    return damaged("a voxel without a cell inside the scene frame");
  }
  for (const ProxyRecord& record : packed.records) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      if (record.low[axis] > record.high[axis]) { return damaged("a record without bounds"); }
    }
    const std::size_t material = std::max(record.material_major, record.material_minor);
    if (material >= packed.materials.size()) { return damaged("a record without a material"); }
  }
  return {};
}

}  // namespace

Aabb record_bounds(const ProxyRecord& record, const Aabb& cell) {
  Aabb bounds;
  const Vec3 step = cell.extent() * (1.0F / 255.0F);
  for (int axis = 0; axis < 3; ++axis) {
    const auto i = static_cast<std::size_t>(axis);
    bounds.low[axis] = cell.low[axis] + step[axis] * static_cast<float>(record.low[i]);
    bounds.high[axis] = record.high[i] == 255
                            ? cell.high[axis]
                            : cell.low[axis] + step[axis] * static_cast<float>(record.high[i]);
    if (bounds.high[axis] - bounds.low[axis] < kProxyExtentMin) {
      const float middle = 0.5F * (bounds.low[axis] + bounds.high[axis]);
      bounds.low[axis] = middle - 0.5F * kProxyExtentMin;
      bounds.high[axis] = middle + 0.5F * kProxyExtentMin;
    }
  }
  return bounds;
}

Vec3 record_normal(const ProxyRecord& record) {
  return decode_normal(record.normal[0] | static_cast<std::uint32_t>(record.normal[1]) << 16U);
}

float record_roundness(const ProxyRecord& record, bool of_minor) {
  const unsigned code = record.shape >> (of_minor ? kShapeMinorRoundness : kShapeMajorRoundness);
  return static_cast<float>(code & 7U) / 7.0F;
}

float record_minor_share(const ProxyRecord& record, int axis, bool from_low_side) {
  const unsigned shares = record.place[static_cast<std::size_t>(axis)];
  return static_cast<float>(from_low_side ? shares & 15U : shares >> 4U) / 15.0F;
}

void set_record_plane(ProxyRecord& record, float share) {
  const auto offset = static_cast<unsigned>(std::clamp(share, 0.0F, 1.0F) * 65535.0F + 0.5F);
  record.place = {static_cast<std::uint8_t>(offset), static_cast<std::uint8_t>(offset >> 8U), 0};
}

Result<Proxy> expand_proxy(PackedProxy packed) { return Expander(std::move(packed)).expand(); }

std::vector<std::byte> encode_proxy(const Proxy& proxy) {
  std::vector<std::uint8_t> root_inner;
  for (const std::uint32_t root : proxy.roots) {
    root_inner.push_back(proxy.nodes[root].child_mask != 0 ? 1 : 0);
  }
  std::vector<PackedProxy::InnerNode> inner;
  for (const ProxyNode& node : proxy.nodes) {
    if (node.child_mask == 0) { continue; }
    PackedProxy::InnerNode packed{node.child_mask, 0};
    std::uint32_t child = node.first;
    for (unsigned octant = 0; octant < 8; ++octant) {
      if ((node.child_mask >> octant & 1U) == 0) { continue; }
      if (proxy.nodes[child++].child_mask == 0) {
        packed.leaf_mask |= static_cast<std::uint8_t>(1U << octant);
      }
    }
    inner.push_back(packed);
  }
  std::vector<PackedProxyHeader> header(1);
  header[0].voxel_count = static_cast<std::uint32_t>(proxy.roots.size());
  header[0].material_count = static_cast<std::uint32_t>(proxy.materials.size());
  header[0].inner_count = static_cast<std::uint32_t>(inner.size());
  header[0].record_count = static_cast<std::uint32_t>(proxy.records.size());
  std::vector<std::byte> bytes;
  append(bytes, header);
  append(bytes, proxy.materials);
  std::vector<PackedCell> cells;
  for (const Aabb& cell : proxy.cells) {
    cells.push_back({cell.low.x, cell.low.y, cell.low.z, cell.high.x, cell.high.y, cell.high.z});
  }
  append(bytes, cells);
  append(bytes, root_inner);
  append(bytes, inner);
  append(bytes, proxy.records);
  return bytes;
}

Result<Proxy> decode_proxy(std::span<const std::byte> bytes, std::size_t voxel_count) {
  PackedProxyHeader header;
  const std::uint32_t magic = header.magic;
  if (bytes.size() < sizeof(PackedProxyHeader)) { return damaged("shorter than its header"); }
  std::memcpy(&header, bytes.data(), sizeof(PackedProxyHeader));
  const std::uint64_t size_expected = sizeof(PackedProxyHeader) +
                                      sizeof(std::uint32_t) * std::uint64_t{header.material_count} +
                                      (kPackedCellBytes + 1) * std::uint64_t{header.voxel_count} +
                                      kPackedInnerNodeBytes * std::uint64_t{header.inner_count} +
                                      sizeof(ProxyRecord) * std::uint64_t{header.record_count};
  if (header.magic != magic || header.voxel_count != voxel_count) {
    return damaged("not the proxy of a scene of " + std::to_string(voxel_count) + " voxels");
  }
  if (bytes.size() != size_expected) {
    return damaged(std::to_string(bytes.size()) + " bytes instead of " +
                   std::to_string(size_expected));
  }
  bytes = bytes.subspan(sizeof(PackedProxyHeader));
  PackedProxy packed;
  take(bytes, packed.materials, header.material_count);
  std::vector<PackedCell> cells;
  take(bytes, cells, header.voxel_count);
  for (const PackedCell& cell : cells) {
    packed.cells.push_back({{cell[0], cell[1], cell[2]}, {cell[3], cell[4], cell[5]}});
  }
  take(bytes, packed.root_inner, header.voxel_count);
  take(bytes, packed.inner, header.inner_count);
  take(bytes, packed.records, header.record_count);
  const Result<void> checked = check_packed(packed);
  if (!checked) { return tl::unexpected<Error>(checked.error()); }
  return Expander(std::move(packed)).expand();
}

}  // namespace preheat
