// What one proxy record tells of some pieces of triangles, and how much it cannot tell.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "common/proxy.h"

namespace preheat {

inline constexpr std::size_t kPieceVerticesMax = 9;  // a triangle cut by the six faces of a cell

// A convex polygon: what a cell holds of a triangle.
struct ProxyPiece {
  std::uint32_t material = 0;
  bool emits = false;
  std::uint8_t count = 0;
  float twice_area = 0.0F;
  Vec3 normal{0.0F};  // as long as twice_area
  std::array<Vec3, kPieceVerticesMax> vertices{};

  void add(const Vec3& vertex) {
    if (count < kPieceVerticesMax) { vertices[count++] = vertex; }
  }
  void measure() {
    normal = Vec3(0.0F);
    for (std::uint32_t i = 2; i < count; ++i) {
      normal += glm::cross(vertices[i - 1] - vertices[0], vertices[i] - vertices[0]);
    }
    twice_area = glm::length(normal);
  }
  // False where rounding leaves nothing but a sliver.
  [[nodiscard]] bool has_area() const { return count >= 3 && twice_area > 0.0F; }
};

// Some of a voxel's pieces.
struct PieceSelection {
  const std::vector<ProxyPiece>& pieces;
  std::span<const std::uint32_t> indices;

  template <class Visit>
  void for_each(Visit&& visit) const {
    for (const std::uint32_t index : indices) { visit(pieces[index]); }
  }
  [[nodiscard]] const ProxyPiece& first() const { return pieces[indices[0]]; }
  [[nodiscard]] bool has_one_material() const {
    return std::all_of(indices.begin(), indices.end(), [this](std::uint32_t index) {
      return pieces[index].material == first().material;
    });
  }
};

struct ProxySummary {
  ProxyRecord record{};  // without materials
  std::array<std::uint32_t, 2> materials{};
  // How much a ray's fate is misjudged: the chance that a random ray meets the bounds, by their
  // surface, times a measure in [0,1] of what one record cannot tell.
  float error = 0.0F;
};

// Of pieces that lie in the cell. Requires: every piece has an area.
[[nodiscard]] ProxySummary summarise(const PieceSelection& selection, const Aabb& cell);

}  // namespace preheat
