#include "master/fine_octree.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>

#include "common/voxel_block.h"

namespace preheat {
namespace {

constexpr std::uint32_t kNoVoxel = UINT32_MAX;

double surface(const Aabb& box) {
  const Vec3d extent(box.extent());
  return 2.0 * (extent.x * extent.y + extent.y * extent.z + extent.z * extent.x);
}

// The triangles by their ids, each with vertices of its own; nothing else of the scene.
Result<Scene> scene_of(const Store& store) {
  const SceneTables& tables = store.tables();
  Scene scene;
  scene.materials.emplace_back();
  scene.positions.resize(tables.triangle_count * 3);
  scene.triangles.resize(tables.triangle_count);
  for (std::uint32_t id = 0; id < tables.voxels.size(); ++id) {
    const VoxelId voxel{id};
    if (!store.block_is_intact(voxel)) {
      return fail(ExitCode::kStoreDamaged,
                  fmt::format("store damaged: voxel {} does not have the content that its "
                              "directory names",
                              id));
    }
    const auto block = view_voxel_block(store.block(voxel), tables.materials.size());
    if (!block) { return tl::unexpected(block.error()); }
    for (std::size_t i = 0; i < block->triangles.size(); ++i) {
      const std::uint32_t triangle = block->triangles[i];
      if (triangle >= tables.triangle_count) {
        return fail(ExitCode::kStoreDamaged,
                    fmt::format("store damaged: voxel {} holds triangle {}, the scene has {}", id,
                                triangle, tables.triangle_count));
      }
      for (std::uint32_t corner = 0; corner < 3; ++corner) {
        const float* const position =
            block->positions.data() + std::size_t{block->indices[i * 3 + corner]} * 3;
        const std::uint32_t vertex = triangle * 3 + corner;
        scene.positions[vertex] = Vec3(position[0], position[1], position[2]);
        scene.triangles[triangle].vertices[corner] = vertex;
      }
    }
  }
  return scene;
}

CountingTree counting_tree_of(const Octree& octree) {
  CountingTree tree;
  tree.cell_count = octree.nodes.size();
  tree.nodes.resize(octree.nodes.size());
  tree.nodes[0].bounds = octree.root;
  for (std::uint32_t i = 0; i < octree.nodes.size(); ++i) {
    const OctreeNode& node = octree.nodes[i];
    VoxelNode& counting = tree.nodes[i];
    counting.first = i;
    if (node.first_child == 0) { continue; }
    counting.first = node.first_child;
    counting.count = 8;
    for (unsigned octant = 0; octant < 8; ++octant) {
      tree.nodes[node.first_child + octant].bounds = child_cell(counting.bounds, octant);
    }
  }
  return tree;
}

}  // namespace

Result<CountingUnit> parse_counting_unit(const std::string& text) {
  if (text == "voxel") { return CountingUnit{}; }
  if (text == "leaf") { return CountingUnit{CountingUnit::Kind::kLeaf, 0}; }
  constexpr std::string_view kNode = "node:";
  if (text.starts_with(kNode)) {
    unsigned depth = 0;
    const char* const end = text.data() + text.size();
    const auto [rest, error] = std::from_chars(text.data() + kNode.size(), end, depth);
    if (error == std::errc{} && rest == end && depth <= kOctreeDepthMax) {
      return CountingUnit{CountingUnit::Kind::kNode, depth};
    }
  }
  return fail(ExitCode::kUsage, fmt::format("'{}' is not voxel, leaf or node:D with D in 0..{}",
                                            text, kOctreeDepthMax));
}

std::string name_of(const CountingUnit& unit) {
  switch (unit.kind) {
    case CountingUnit::Kind::kVoxel:
      return "voxel";
    case CountingUnit::Kind::kLeaf:
      return "leaf";
    case CountingUnit::Kind::kNode:
      return fmt::format("node:{}", unit.depth);
  }
  return {};
}

Result<FineOctree> FineOctree::rebuild(const Store& store, unsigned threads) {
  const Result<Scene> scene = scene_of(store);
  if (!scene) { return tl::unexpected(scene.error()); }
  FineOctree fine;
  OctreeLimits limits;
  limits.threads = threads;
  fine.octree_ = build_octree(*scene, limits);
  fine.tree_ = std::make_shared<const CountingTree>(counting_tree_of(fine.octree_));
  for (const VoxelEntry& voxel : store.tables().voxels) {
    fine.voxel_bounds_.push_back(voxel.bounds);
  }
  // Children lie behind their parents, and voxels are in the order of a depth-first walk.
  const std::size_t node_count = fine.octree_.nodes.size();
  fine.depths_.resize(node_count, 0);
  fine.voxels_.resize(node_count, kNoVoxel);
  const std::vector<Aabb>& voxel_cells = store.proxy().cells;
  std::uint32_t next_voxel = 0;
  std::vector<std::uint32_t> pending{0};
  while (!pending.empty()) {
    const std::uint32_t at = pending.back();
    pending.pop_back();
    const OctreeNode& node = fine.octree_.nodes[at];
    const Aabb& cell = fine.tree_->nodes[at].bounds;
    if (fine.voxels_[at] == kNoVoxel && node.references_count > 0 &&
        next_voxel < voxel_cells.size() && voxel_cells[next_voxel].low == cell.low &&
        voxel_cells[next_voxel].high == cell.high) {
      fine.voxels_[at] = next_voxel++;
    }
    for (unsigned octant = 8; node.first_child != 0 && octant-- > 0;) {
      const std::uint32_t child = node.first_child + octant;
      fine.depths_[child] = fine.depths_[at] + 1;
      fine.voxels_[child] = fine.voxels_[at];
      pending.push_back(child);
    }
  }
  const std::size_t leaves = fine.cells_of({CountingUnit::Kind::kLeaf, 0}).size();
  if (next_voxel != voxel_cells.size() || leaves != store.info().voxels_leaf) {
    return fail(ExitCode::kMismatch,
                fmt::format("the store was cut from another octree: it has {} filled leaves, the "
                            "octree rebuilt from it {}",
                            store.info().voxels_leaf, leaves));
  }
  return fine;
}

std::vector<std::uint32_t> FineOctree::cells_of(const CountingUnit& unit) const {
  std::vector<std::uint32_t> cells;
  std::vector<std::uint32_t> pending{0};
  while (!pending.empty()) {
    const std::uint32_t at = pending.back();
    pending.pop_back();
    const OctreeNode& node = octree_.nodes[at];
    if (node.references_count == 0) { continue; }
    const bool is_cut = unit.kind == CountingUnit::Kind::kNode && depths_[at] >= unit.depth;
    if (is_cut || node.first_child == 0) {
      cells.push_back(at);
      continue;
    }
    for (unsigned octant = 8; octant-- > 0;) { pending.push_back(node.first_child + octant); }
  }
  return cells;
}

std::vector<double> FineOctree::sum_below(std::vector<double> by_leaf,
                                          std::span<const std::uint32_t> cells) const {
  for (std::size_t at = octree_.nodes.size(); at-- > 0;) {
    const OctreeNode& node = octree_.nodes[at];
    for (unsigned octant = 0; node.first_child != 0 && octant < 8; ++octant) {
      by_leaf[at] += by_leaf[node.first_child + octant];
    }
  }
  std::vector<double> sums;
  for (const std::uint32_t cell : cells) { sums.push_back(by_leaf[cell]); }
  return sums;
}

CellRays FineOctree::counted(std::span<const CellAccesses> by_node,
                             std::span<const std::uint32_t> cells) const {
  std::vector<double> camera;
  std::vector<double> all;
  for (const CellAccesses& node : by_node) {
    camera.push_back(static_cast<double>(node.camera));
    all.push_back(static_cast<double>(node.total()));
  }
  return {sum_below(std::move(camera), cells), sum_below(std::move(all), cells)};
}

std::vector<double> FineOctree::leaves_from_voxels(const std::vector<double>& voxel_rays) const {
  std::vector<double> rays(octree_.nodes.size(), 0.0);
  for (std::size_t at = 0; at < rays.size(); ++at) {
    if (octree_.nodes[at].first_child != 0 || voxels_[at] == kNoVoxel) { continue; }
    const double voxel = surface(voxel_bounds_[voxels_[at]]);
    const double leaf = surface(tree_->nodes[at].bounds);
    rays[at] = voxel_rays[voxels_[at]] * (leaf < voxel ? leaf / voxel : 1.0);
  }
  return rays;
}

std::vector<double> FineOctree::leaves_from_nodes(const std::vector<double>& node_rays,
                                                  std::span<const std::uint32_t> nodes) const {
  std::vector<double> surfaces(octree_.nodes.size(), 0.0);
  for (std::size_t at = 0; at < surfaces.size(); ++at) {
    if (octree_.nodes[at].first_child == 0) { surfaces[at] = surface(tree_->nodes[at].bounds); }
  }
  const std::vector<double> totals = sum_below(surfaces, nodes);
  std::vector<double> per_surface(octree_.nodes.size(), 0.0);
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    if (totals[i] > 0.0) { per_surface[nodes[i]] = node_rays[i] / totals[i]; }
  }
  std::vector<double> rays(octree_.nodes.size(), 0.0);
  for (std::size_t at = 0; at < rays.size(); ++at) {
    const OctreeNode& node = octree_.nodes[at];
    rays[at] = surfaces[at] * per_surface[at];
    for (unsigned octant = 0; node.first_child != 0 && octant < 8; ++octant) {
      double& below = per_surface[node.first_child + octant];
      if (per_surface[at] > 0.0) { below = per_surface[at]; }
    }
  }
  return rays;
}

bool FineOctree::is_estimated_by(const Prediction& prediction, const CountingUnit& unit) {
  switch (unit.kind) {
    case CountingUnit::Kind::kVoxel:
      return prediction.nodes.rays_camera.empty();
    case CountingUnit::Kind::kLeaf:
      return false;
    case CountingUnit::Kind::kNode:
      break;
  }
  return !prediction.nodes.rays_camera.empty() && prediction.nodes.depth == unit.depth;
}

CellRays FineOctree::estimated(const Prediction& prediction, const CountingUnit& unit,
                               std::span<const std::uint32_t> cells) const {
  const NodePrediction& nodes = prediction.nodes;
  if (nodes.rays_camera.empty()) {
    const CellRays voxels = rays_of(prediction);
    return {sum_below(leaves_from_voxels(voxels.camera), cells),
            sum_below(leaves_from_voxels(voxels.all), cells)};
  }
  CellRays rays{nodes.rays_camera, nodes.rays_camera};
  for (std::size_t i = 0; i < rays.all.size(); ++i) {
    rays.all[i] += nodes.rays_scatter[i] + nodes.rays_shadow[i];
  }
  if (is_estimated_by(prediction, unit)) { return rays; }
  const std::vector<std::uint32_t> own = cells_of({CountingUnit::Kind::kNode, nodes.depth});
  return {sum_below(leaves_from_nodes(rays.camera, own), cells),
          sum_below(leaves_from_nodes(rays.all, own), cells)};
}

}  // namespace preheat
