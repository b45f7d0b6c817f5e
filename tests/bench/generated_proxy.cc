#include "tests/bench/generated_proxy.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "common/voxel_block.h"

namespace preheat {
namespace {

constexpr unsigned kLeafDepth = 5;

float height(float x, float z) { return 0.1F * std::sin(5.0F * x) * std::cos(4.0F * z); }

Vec3 normal_at(float x, float z) {
  return glm::normalize(Vec3(-0.5F * std::cos(5.0F * x) * std::cos(4.0F * z), 1.0F,
                             0.4F * std::sin(5.0F * x) * std::sin(4.0F * z)));
}

// Whether the hills pass through the cell; their slope is below 0.7 everywhere.
bool holds_surface(const Aabb& cell) {
  const Vec3 middle = 0.5F * (cell.low + cell.high);
  const Vec3 half = 0.5F * cell.extent();
  return std::abs(height(middle.x, middle.z) - middle.y) <= half.y + 0.7F * half.x;
}

ProxyRecord record_of(const Aabb& cell) {
  const Vec3 middle = 0.5F * (cell.low + cell.high);
  const Vec3 normal = normal_at(middle.x, middle.z);
  ProxyRecord record;
  const std::uint32_t code = encode_normal(normal);
  record.normal = {static_cast<std::uint16_t>(code), static_cast<std::uint16_t>(code >> 16U)};
  record.mask.fill(0xFFFF);
  record.high.fill(255);
  record.coverage.fill(255);
  record.shape = kShapeFlat | kShapeOriented;
  const float half = glm::dot(glm::abs(normal), 0.5F * cell.extent());
  const float offset = (height(middle.x, middle.z) - middle.y) * normal.y;
  set_record_plane(record, 0.5F + 0.5F * offset / half);
  return record;
}

struct Place {
  Aabb cell{};
  unsigned depth = 0;
};

void add_voxel_tree(const Aabb& cell, Proxy& proxy) {
  const std::size_t begin = proxy.nodes.size();
  proxy.cells.push_back(cell);
  proxy.roots.push_back(static_cast<std::uint32_t>(begin));
  std::vector<Place> places{{cell, 0}};
  for (std::size_t at = 0; at < places.size(); ++at) {
    const Place place = places[at];
    ProxyNode node;
    node.bounds = place.cell;
    const auto first_child = static_cast<std::uint32_t>(begin + places.size());
    for (unsigned octant = 0; octant < 8 && place.depth < kLeafDepth; ++octant) {
      const Aabb child = child_cell(place.cell, octant);
      if (!holds_surface(child)) { continue; }
      node.child_mask |= static_cast<std::uint8_t>(1U << octant);
      places.push_back({child, place.depth + 1});
    }
    // Also where no child holds what its parent was thought to.
    const bool is_leaf = node.child_mask == 0;
    node.first = is_leaf ? static_cast<std::uint32_t>(proxy.records.size()) : first_child;
    if (is_leaf) { proxy.records.push_back(record_of(place.cell)); }
    proxy.nodes.push_back(node);
  }
}

// A tree of four children a node over squares of voxels, whose ids are in Morton order.
void add_voxel_nodes(std::uint32_t side, SceneTables& tables) {
  tables.voxel_nodes.resize(1);
  struct Square {
    std::uint32_t first_voxel = 0;
    std::uint32_t voxels = 0;
  };
  std::vector<Square> squares{{0, side * side}};
  for (std::size_t at = 0; at < squares.size(); ++at) {
    const Square square = squares[at];
    if (square.voxels == 1) {
      tables.voxel_nodes[at] = {tables.voxels[square.first_voxel].bounds, square.first_voxel, 0};
      continue;
    }
    tables.voxel_nodes[at].first = static_cast<std::uint32_t>(squares.size());
    tables.voxel_nodes[at].count = 4;
    for (std::uint32_t quarter = 0; quarter < 4; ++quarter) {
      squares.push_back({square.first_voxel + quarter * (square.voxels / 4), square.voxels / 4});
    }
    tables.voxel_nodes.resize(squares.size());
  }
  for (std::size_t at = tables.voxel_nodes.size(); at-- > 0;) {
    VoxelNode& node = tables.voxel_nodes[at];
    for (std::uint32_t i = 0; i < node.count; ++i) {
      node.bounds.extend(tables.voxel_nodes[node.first + i].bounds);
    }
  }
}

}  // namespace

GeneratedProxy generate_hills(std::uint32_t voxels_side) {
  GeneratedProxy hills;
  hills.tables.materials.resize(1);
  hills.proxy.materials = {0};
  const float width = 2.0F / static_cast<float>(voxels_side);
  for (std::uint32_t voxel = 0; voxel < voxels_side * voxels_side; ++voxel) {
    std::uint32_t column = 0;
    std::uint32_t row = 0;
    for (std::uint32_t bit = 0; bit < 16; ++bit) {
      column |= (voxel >> (2 * bit) & 1U) << bit;
      row |= (voxel >> (2 * bit + 1) & 1U) << bit;
    }
    const float x = -1.0F + width * static_cast<float>(column);
    const float z = -1.0F + width * static_cast<float>(row);
    const float middle = height(x + 0.5F * width, z + 0.5F * width);
    const Aabb cell{{x, middle - 0.5F * width, z}, {x + width, middle + 0.5F * width, z + width}};
    add_voxel_tree(cell, hills.proxy);
    VoxelEntry entry;
    entry.bounds = grown_cell(cell);
    hills.tables.voxels.push_back(entry);
  }
  add_voxel_nodes(voxels_side, hills.tables);
  hills.settings.sky = Vec3(1.0F);
  hills.settings.view.origin = Vec3(0.0F, 0.4F, 1.2F);
  hills.settings.view.forward = glm::normalize(Vec3(0.0F, -0.4F, -1.0F));
  hills.settings.view.right = Vec3(0.8F, 0.0F, 0.0F);
  hills.settings.view.up =
      0.6F * glm::normalize(glm::cross(hills.settings.view.right, hills.settings.view.forward));
  return hills;
}

}  // namespace preheat
