#include "master/voxel_cut.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <unordered_map>

#include "common/box_clip.h"
#include "common/flat_index.h"
#include "common/voxel_block.h"

namespace preheat {
namespace {

constexpr std::uint64_t kVoxelsPerScene = 256;

// Sizes subtrees; keeps its tables from one to the next.
class SubtreeMeasure {
 public:
  SubtreeMeasure(const Scene& scene, const Octree& octree) : scene_(scene), octree_(octree) {}

  // Whether the block of the subtree has no more bytes than the limit. Stops as soon as it has not,
  // so that large nodes cost no more than small ones.
  [[nodiscard]] bool fits(std::uint32_t node, std::uint64_t limit_bytes) {
    const OctreeNode& subtree = octree_.nodes[node];
    triangles_.reset(kKeysExpected);
    vertices_.reset(kKeysExpected);
    bool has_normals = false;
    for (std::uint64_t i = 0; i < subtree.references_count; ++i) {
      const std::uint32_t id = octree_.references[subtree.references_begin + i];
      const std::size_t known = triangles_.size();
      if (triangles_.number_of(id) < known) { continue; }
      for (const std::uint32_t vertex : scene_.triangles[id].vertices) {
        static_cast<void>(vertices_.number_of(vertex));
        has_normals = has_normals || scene_.normals[vertex] != Vec3(0.0F);
      }
      if (voxel_block_bytes(vertices_.size(), triangles_.size(), has_normals) > limit_bytes) {
        return false;
      }
    }
    return true;
  }

 private:
  static constexpr std::size_t kKeysExpected = 1024;

  const Scene& scene_;
  const Octree& octree_;
  FlatIndex triangles_{};
  FlatIndex vertices_{};
};

// What the part of a triangle inside the box extends over. Empty if nothing is left.
[[nodiscard]] Aabb clipped_extent(const std::array<Vec3, 3>& triangle, const Aabb& box) {
  const ClippedTriangle clipped =
      clip_to_box({Vec3d(triangle[0]), Vec3d(triangle[1]), Vec3d(triangle[2])}, box);
  Aabb extent;
  for (const Vec3d& vertex : clipped.vertices()) { extent.extend(Vec3(vertex)); }
  return extent;
}

[[nodiscard]] bool lies_inside(const Aabb& inner, const Aabb& outer) {
  bool inside = true;
  for (int axis = 0; axis < 3; ++axis) {
    inside = inside && inner.low[axis] >= outer.low[axis] && inner.high[axis] <= outer.high[axis];
  }
  return inside;
}

[[nodiscard]] Aabb overlap(const Aabb& one, const Aabb& other) {
  return {glm::max(one.low, other.low), glm::min(one.high, other.high)};
}

// The nodes above the voxels, breadth-first. Only children stand for their parents.
[[nodiscard]] std::vector<VoxelNode> collapse(const Octree& octree,
                                              const std::vector<std::uint32_t>& roots) {
  if (roots.empty()) { return {}; }
  std::unordered_map<std::uint32_t, std::uint32_t> voxel_of_node;
  for (std::size_t voxel = 0; voxel < roots.size(); ++voxel) {
    voxel_of_node.emplace(roots[voxel], static_cast<std::uint32_t>(voxel));
  }
  std::vector<VoxelNode> nodes(1);
  std::vector<std::uint32_t> octree_node{0};  // of each in `nodes`
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    for (;;) {
      if (const auto voxel = voxel_of_node.find(octree_node[i]); voxel != voxel_of_node.end()) {
        nodes[i].first = voxel->second;
        break;
      }
      const std::uint32_t first_child = octree.nodes[octree_node[i]].first_child;
      std::vector<std::uint32_t> children;
      for (std::uint32_t child = first_child; child < first_child + 8; ++child) {
        if (octree.nodes[child].references_count > 0) { children.push_back(child); }
      }
      if (children.size() == 1) {
        octree_node[i] = children[0];
        continue;
      }
      nodes[i].first = static_cast<std::uint32_t>(nodes.size());
      nodes[i].count = static_cast<std::uint32_t>(children.size());
      nodes.resize(nodes.size() + children.size());
      octree_node.insert(octree_node.end(), children.begin(), children.end());
      break;
    }
  }
  return nodes;
}

}  // namespace

std::uint64_t default_voxel_size(const Scene& scene) {
  const bool has_normals = std::any_of(scene.normals.begin(), scene.normals.end(),
                                       [](const Vec3& normal) { return normal != Vec3(0.0F); });
  const std::uint64_t scene_bytes =
      voxel_block_bytes(scene.positions.size(), scene.triangles.size(), has_normals);
  return std::clamp(scene_bytes / kVoxelsPerScene, kVoxelSizeBytesMin, kVoxelSizeBytesDefaultMax);
}

VoxelCut cut_into_voxels(const Scene& scene, const Octree& octree, std::uint64_t voxel_size_bytes) {
  struct Place {
    std::uint32_t node = 0;
    Aabb cell{};
  };
  VoxelCut cut;
  SubtreeMeasure measure(scene, octree);
  std::vector<Place> waiting{{0, octree.root}};
  while (!waiting.empty()) {
    const Place place = waiting.back();
    waiting.pop_back();
    const OctreeNode& node = octree.nodes[place.node];
    if (node.references_count == 0) { continue; }
    if (node.first_child == 0 || measure.fits(place.node, voxel_size_bytes)) {
      cut.roots.push_back(place.node);
      cut.cells.push_back(place.cell);
      continue;
    }
    for (unsigned octant = 8; octant-- > 0;) {
      waiting.push_back({node.first_child + octant, child_cell(place.cell, octant)});
    }
  }
  cut.nodes = collapse(octree, cut.roots);
  return cut;
}

Aabb voxel_bounds(const Scene& scene, const std::vector<std::uint32_t>& triangle_ids,
                  const Aabb& cell) {
  const Aabb grown = grown_cell(cell);
  Aabb bounds;
  for (const std::uint32_t id : triangle_ids) {
    std::array<Vec3, 3> vertices{};
    Aabb extent;
    for (std::size_t i = 0; i < 3; ++i) {
      vertices[i] = scene.positions[scene.triangles[id].vertices[i]];
      extent.extend(vertices[i]);
    }
    if (lies_inside(overlap(extent, grown), bounds)) { continue; }  // clipping could not grow them
    bounds.extend(lies_inside(extent, grown) ? extent : clipped_extent(vertices, grown));
  }
  return grown_cell(bounds);
}

void set_node_bounds(std::vector<VoxelNode>& nodes, const std::vector<VoxelEntry>& voxels) {
  for (std::size_t i = nodes.size(); i-- > 0;) {  // children lie behind their parent
    VoxelNode& node = nodes[i];
    if (node.count == 0) { node.bounds = voxels[node.first].bounds; }
    for (std::uint32_t child = 0; child < node.count; ++child) {
      node.bounds.extend(nodes[node.first + child].bounds);
    }
  }
}

}  // namespace preheat
