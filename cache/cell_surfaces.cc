#include "cache/cell_surfaces.h"

#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <span>

#include "common/box_clip.h"
#include "common/compensated_sum.h"
#include "common/flat_index.h"
#include "common/voxel_block.h"

namespace preheat {
namespace {

using Corners = std::array<Vec3d, 3>;

// Squares of the octahedral map a side: normals in one differ by some ten degrees at most, and the
// axes lie in the middle of squares or on their corners alike, so that walls are never mixed with
// what is far from parallel to them.
constexpr std::uint32_t kNormalSquares = 16;

// The octahedral map: the unit sphere onto a square, with + and / only (Meyer et al. 2010).
[[nodiscard]] std::uint32_t square_of(const Vec3d& normal) {
  const double scale = std::abs(normal.x) + std::abs(normal.y) + std::abs(normal.z);
  double u = normal.x / scale;
  double v = normal.y / scale;
  if (normal.z < 0.0) {
    const double folded_u = std::copysign(1.0 - std::abs(v), u);
    v = std::copysign(1.0 - std::abs(u), v);
    u = folded_u;
  }
  const auto square = [](double at) {
    const double place = (at + 1.0) * 0.5 * kNormalSquares;
    return std::min(kNormalSquares - 1, static_cast<std::uint32_t>(std::max(0.0, place)));
  };
  return square(v) * kNormalSquares + square(u);
}

// Twice the area of the part of a triangle inside a box, as a vector along its normal.
[[nodiscard]] Vec3d doubled_area_inside(const Corners& corners, const Aabb& box) {
  const ClippedTriangle clipped = clip_to_box(corners, box);
  const std::span<const Vec3d> polygon = clipped.vertices();
  Vec3d doubled(0.0);
  for (std::size_t i = 1; i + 1 < polygon.size(); ++i) {
    doubled += glm::cross(polygon[i] - polygon[0], polygon[i + 1] - polygon[0]);
  }
  return doubled;
}

class CellGatherer {
 public:
  explicit CellGatherer(const Aabb& cell) : cell_(cell) {}

  // The triangles of a voxel. Where several voxels lie in the cell, each counts what lies in
  // itself, so that a triangle that is stored twice is not counted twice.
  void add(const VoxelBlockView& block, const Aabb& voxel_cell) {
    const Aabb box{glm::max(cell_.low, voxel_cell.low), glm::min(cell_.high, voxel_cell.high)};
    for (std::size_t triangle = 0; triangle < block.triangles.size(); ++triangle) {
      Corners corners{};
      bool is_inside = true;
      bool is_outside = false;
      for (int axis = 0; axis < 3; ++axis) {
        float low = kInfinity;
        float high = -kInfinity;
        for (std::size_t i = 0; i < 3; ++i) {
          const std::size_t vertex = block.indices[3 * triangle + i];
          const float at = block.positions[3 * vertex + static_cast<std::size_t>(axis)];
          corners[i][axis] = static_cast<double>(at);
          low = std::min(low, at);
          high = std::max(high, at);
        }
        is_inside = is_inside && low >= box.low[axis] && high <= box.high[axis];
        // What lies in a face shared by two cells belongs to the upper one.
        is_outside = is_outside || low >= box.high[axis] || high < box.low[axis];
      }
      if (is_outside) { continue; }
      add(is_inside ? glm::cross(corners[1] - corners[0], corners[2] - corners[0])
                    : doubled_area_inside(corners, box),
          block.materials[triangle]);
    }
  }

  [[nodiscard]] std::vector<SurfaceGroup> groups() const {
    std::vector<SurfaceGroup> groups;
    for (const Sums& sums : sums_) {
      const double length = glm::length(sums.doubled_area);
      const double area = 0.5 * sums.area.value();
      if (!(length > 0.0) || !(area > 0.0)) { continue; }
      groups.push_back({Vec3(sums.doubled_area / length), sums.material, area});
    }
    return groups;
  }

 private:
  struct Sums {
    std::uint32_t material = 0;
    Vec3d doubled_area{0.0};
    CompensatedSum area{};  // doubled
  };

  void add(const Vec3d& doubled_area, std::uint32_t material) {
    const double length = glm::length(doubled_area);
    if (!(length > 0.0) || !std::isfinite(length)) { return; }
    const std::uint32_t square = square_of(doubled_area);
    const std::uint32_t group =
        index_.number_of(material * kNormalSquares * kNormalSquares + square);
    if (group == sums_.size()) { sums_.push_back({.material = material}); }
    sums_[group].doubled_area += doubled_area;
    sums_[group].area.add(length);
  }

  Aabb cell_;
  FlatIndex index_{};
  std::vector<Sums> sums_{};
};

}  // namespace

Result<std::vector<std::vector<SurfaceGroup>>> gather_surfaces(const Store& store,
                                                               const OctreeCut& cut) {
  const std::vector<Aabb>& voxel_cells = store.proxy().cells;
  const std::size_t material_count = store.tables().materials.size();
  std::vector<VoxelBlockView> blocks;
  std::vector<std::vector<std::uint32_t>> voxels_of(cut.cells.size());
  for (std::uint32_t voxel = 0; voxel < voxel_cells.size(); ++voxel) {
    Result<VoxelBlockView> block = view_voxel_block(store.block(VoxelId{voxel}), material_count);
    if (!block) {
      return fail(ExitCode::kStoreDamaged,
                  fmt::format("voxel {}: {}", voxel, block.error().message));
    }
    blocks.push_back(*block);
    const CutRange range = cut_cells_of(store.octree_summary(), cut, voxel_cells[voxel]);
    for (std::uint32_t cell = range.begin; cell < range.end; ++cell) {
      voxels_of[cell].push_back(voxel);
    }
  }
  std::vector<std::vector<SurfaceGroup>> groups(cut.cells.size());
  tbb::parallel_for(std::size_t{0}, cut.cells.size(), [&](std::size_t cell) {
    CellGatherer gatherer(cut.cells[cell].cell);
    for (const std::uint32_t voxel : voxels_of[cell]) {
      gatherer.add(blocks[voxel], voxel_cells[voxel]);
    }
    groups[cell] = gatherer.groups();
  });
  return groups;
}

}  // namespace preheat
