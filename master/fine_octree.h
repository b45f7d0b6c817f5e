// The fine octree of a compiled scene, rebuilt from the store's blocks, and rays counted in its
// leaves: the unit of [P], whose model predicts how many leaves rays traverse.
//
// A store keeps voxels, not the octree that they were cut from. It is the same octree again: the
// same triangles in the same order, split by the same rules.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "cache/counting_tree.h"
#include "common/octree.h"
#include "common/result.h"
#include "common/stats.h"
#include "common/store.h"
#include "master/evaluation_record.h"

namespace preheat {

// What rays are counted in: voxels, leaves, or the nodes of the octree cut at a depth, where a ray
// counts once for each leaf below that it traverses, empty ones included, as C_t of [P] counts.
struct CountingUnit {
  enum class Kind : std::uint8_t { kVoxel, kLeaf, kNode };
  Kind kind = Kind::kVoxel;
  unsigned depth = 0;  // of kNode
};
// "voxel", "leaf" or "node:D" with D in 0..kOctreeDepthMax.
[[nodiscard]] Result<CountingUnit> parse_counting_unit(const std::string& text);
[[nodiscard]] std::string name_of(const CountingUnit& unit);

class FineOctree {
 public:
  // kStoreDamaged if a block is damaged; kMismatch if the octree is not the one that the store was
  // cut from, because it was compiled with other limits.
  [[nodiscard]] static Result<FineOctree> rebuild(const Store& store, unsigned threads);

  // One cell for each node; only leaves are entered.
  [[nodiscard]] const std::shared_ptr<const CountingTree>& counting_tree() const { return tree_; }

  // The cells of a unit that hold triangles, in Morton order. Requires: not kVoxel.
  [[nodiscard]] std::vector<std::uint32_t> cells_of(const CountingUnit& unit) const;

  // Per cell, from the counts of the tree's leaves.
  [[nodiscard]] CellRays counted(std::span<const CellAccesses> by_node,
                                 std::span<const std::uint32_t> cells) const;

  // Per cell, what a model expects. A prediction of nodes cut at the unit's own depth is taken as
  // it is. Otherwise what was predicted is handed down to leaves by surfaces, as Crofton's ratio
  // for random lines says, and summed up again: a leaf sees its voxel's rays times the leaf's
  // surface over that of the voxel's bounds, at most all of them; of a node's leaf traversals each
  // leaf has its share by surface.
  [[nodiscard]] CellRays estimated(const Prediction& prediction, const CountingUnit& unit,
                                   std::span<const std::uint32_t> cells) const;

  // Whether `prediction` estimates this unit itself.
  [[nodiscard]] static bool is_estimated_by(const Prediction& prediction, const CountingUnit& unit);

 private:
  FineOctree() = default;
  [[nodiscard]] std::vector<double> sum_below(std::vector<double> by_leaf,
                                              std::span<const std::uint32_t> cells) const;
  [[nodiscard]] std::vector<double> leaves_from_voxels(const std::vector<double>& voxel_rays) const;
  [[nodiscard]] std::vector<double> leaves_from_nodes(const std::vector<double>& node_rays,
                                                      std::span<const std::uint32_t> nodes) const;

  Octree octree_{};
  std::vector<unsigned> depths_{};       // [nodes]
  std::vector<std::uint32_t> voxels_{};  // [nodes] the voxel that a node lies in, or kNoVoxel
  std::vector<Aabb> voxel_bounds_{};     // [voxel_count]
  std::shared_ptr<const CountingTree> tree_{};  // cells of the nodes are its bounds
};

}  // namespace preheat
