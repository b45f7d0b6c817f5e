#include <tbb/parallel_for.h>
#include <tbb/parallel_sort.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <unordered_map>
#include <utility>

#include "common/check.h"
#include "common/flat_index.h"
#include "common/proxy.h"
#include "common/proxy_packed.h"
#include "common/proxy_summary.h"
#include "common/voxel_block.h"

namespace preheat {
namespace {

// ---- pieces of triangles, clipped to a cell ----

// Both parts of a piece beside the plane x[axis] = at, not measured where they are new. A piece in
// the plane is wholly below.
void split_piece(const ProxyPiece& piece, int axis, float at, ProxyPiece& below,
                 ProxyPiece& above) {
  below.material = above.material = piece.material;
  below.emits = above.emits = piece.emits;
  below.count = above.count = 0;
  bool has_below = false;
  bool has_above = false;
  for (std::uint32_t i = 0; i < piece.count; ++i) {
    has_below |= piece.vertices[i][axis] < at;
    has_above |= piece.vertices[i][axis] > at;
  }
  if (!has_above) {
    below = piece;
    return;
  }
  if (!has_below) {
    above = piece;
    return;
  }
  for (std::uint32_t i = 0; i < piece.count; ++i) {
    const Vec3& from = piece.vertices[i];
    const Vec3& to = piece.vertices[i + 1 == piece.count ? 0 : i + 1];
    if (from[axis] <= at) { below.add(from); }
    if (from[axis] >= at) { above.add(from); }
    if ((from[axis] < at && to[axis] > at) || (from[axis] > at && to[axis] < at)) {
      // From the lower end, so that neighbours which share the edge cut it at the same point.
      const Vec3& low = from[axis] < to[axis] ? from : to;
      const Vec3& high = from[axis] < to[axis] ? to : from;
      Vec3 cut = low + (high - low) * ((at - low[axis]) / (high[axis] - low[axis]));
      cut[axis] = at;
      below.add(cut);
      above.add(cut);
    }
  }
}

Aabb bounds_of(const ProxyPiece& piece) {
  Aabb bounds;
  for (std::uint32_t i = 0; i < piece.count; ++i) { bounds.extend(piece.vertices[i]); }
  return bounds;
}

std::vector<ProxyPiece> pieces_in_cell(const Scene& scene, std::span<const std::uint32_t> triangles,
                                       const Aabb& cell) {
  std::vector<ProxyPiece> pieces;
  pieces.reserve(triangles.size());
  for (const std::uint32_t id : triangles) {
    const Triangle& triangle = scene.triangles[id];
    const bool emits = scene.materials[triangle.material].emission != Vec3(0.0F);
    ProxyPiece piece;
    piece.material = triangle.material;
    piece.emits = emits;
    for (const std::uint32_t vertex : triangle.vertices) { piece.add(scene.positions[vertex]); }
    // What lies in the lower face belongs to this cell too, as a voxel's triangles do: a wall
    // between two voxels stops the rays of both.
    const Aabb bounds = bounds_of(piece);
    ProxyPiece kept;
    ProxyPiece outside;
    for (int axis = 0; axis < 3; ++axis) {
      if (bounds.high[axis] > cell.high[axis]) {
        split_piece(piece, axis, cell.high[axis], kept, outside);
        piece = kept;
      }
      if (bounds.low[axis] < cell.low[axis]) {
        split_piece(piece, axis, cell.low[axis], outside, kept);
        piece = kept;
      }
    }
    piece.measure();
    if (piece.has_area()) { pieces.push_back(piece); }
  }
  return pieces;
}

// ---- one voxel's tree, split where the error is largest first ----

constexpr std::uint32_t kNeverSplit = 0xFFFFFFFF;
// Rays that meet less than this of the scene's unit surface are too few to tell apart.
constexpr float kErrorMin = 2e-7F;

// So many rays meet this that a voxel of few triangles, the edge of a room, is split for them too.
constexpr float kErrorLarge = 1e-4F;
constexpr std::size_t kLeavesMax = 256;

struct BuildNode {
  ProxySummary summary{};
  std::uint32_t first_child = 0;
  std::uint8_t child_mask = 0;
  std::uint32_t split = kNeverSplit;  // how many splits of the voxel came before its own
};

struct BuildSplit {
  float error = 0.0F;       // the least of this split's and all earlier ones'
  std::uint32_t added = 0;  // leaves
};

struct VoxelTree {
  Aabb cell{};
  std::vector<BuildNode> nodes{};
  std::vector<BuildSplit> splits{};  // in order
  std::uint32_t splits_kept = 0;
  float error_min = kInfinity;  // every split of at least this error is there; infinity = not built
};

// Where many triangles coincide every split multiplies their pieces, so splitting ends at this many
// times the voxel's own.
constexpr std::size_t kPieceGrowthMax = 8;
constexpr std::size_t kPiecesFree = 4096;

class VoxelTreeBuilder {
 public:
  explicit VoxelTreeBuilder(VoxelTree& tree) : tree_(tree) {}

  // Leaves out splits of an error below `error_min`.
  void build(std::vector<ProxyPiece> pieces, std::size_t leaf_count_max, float error_min) {
    const std::size_t pieces_max = kPieceGrowthMax * pieces.size() + kPiecesFree;
    pieces_ = std::move(pieces);
    std::vector<std::uint32_t> all(pieces_.size());
    std::iota(all.begin(), all.end(), 0U);
    tree_.nodes.push_back({summarise({pieces_, all}, tree_.cell)});
    push({0, 0, tree_.cell, std::move(all)});
    std::size_t leaf_count = 1;
    float error = kInfinity;
    while (!open_.empty()) {
      const float error_next = tree_.nodes[open_.front().node].summary.error;
      if (error_next < error_min) {
        tree_.error_min = error_min;
        return;
      }
      const std::size_t max = error_next > kErrorLarge ? kLeavesMax : leaf_count_max;
      if (leaf_count >= max || pieces_.size() > pieces_max) { break; }
      std::pop_heap(open_.begin(), open_.end(), later_);
      const Open open = std::move(open_.back());
      open_.pop_back();
      const std::uint32_t children = split(open);
      if (children == 0) { continue; }
      BuildNode& node = tree_.nodes[open.node];
      node.split = static_cast<std::uint32_t>(tree_.splits.size());
      error = std::min(error, node.summary.error);
      tree_.splits.push_back({error, children - 1});
      leaf_count += children - 1;
    }
    tree_.error_min = 0.0F;
  }

 private:
  struct Open {
    std::uint32_t node = 0;
    unsigned depth = 0;
    Aabb cell{};
    std::vector<std::uint32_t> pieces{};  // into pieces_
  };

  struct Later {
    const VoxelTree* tree;
    bool operator()(const Open& a, const Open& b) const {
      const float error_a = tree->nodes[a.node].summary.error;
      const float error_b = tree->nodes[b.node].summary.error;
      return error_a != error_b ? error_a < error_b : a.node > b.node;
    }
  };

  void push(Open open) {
    const bool is_small = open.cell.extent().x < 8.0F * kVoxelMargin;
    if (tree_.nodes[open.node].summary.error < kErrorMin || open.depth == kProxyDepthMax ||
        is_small) {
      return;
    }
    open_.push_back(std::move(open));
    std::push_heap(open_.begin(), open_.end(), later_);
  }

  using Parts = std::array<std::vector<std::uint32_t>, 8>;  // by octant, into pieces_

  // Returns how many children the node got; none if rounding leaves nothing of its slivers.
  std::uint32_t split(const Open& open) {
    const Vec3 middle = child_cell(open.cell, 0).high;
    Parts parts;
    for (const std::uint32_t piece : open.pieces) { distribute(piece, middle, parts); }
    const auto first_child = static_cast<std::uint32_t>(tree_.nodes.size());
    tree_.nodes[open.node].first_child = first_child;
    std::uint32_t count = 0;
    for (unsigned octant = 0; octant < 8; ++octant) {
      if (parts[octant].empty()) { continue; }
      const Aabb cell = child_cell(open.cell, octant);
      tree_.nodes.push_back({summarise({pieces_, parts[octant]}, cell)});
      tree_.nodes[open.node].child_mask |= static_cast<std::uint8_t>(1U << octant);
      push({first_child + count, open.depth + 1, cell, std::move(parts[octant])});
      ++count;
    }
    return count;
  }

  void distribute(std::uint32_t index, const Vec3& middle, Parts& parts) {
    const ProxyPiece& piece = pieces_[index];
    unsigned above = 0;  // bit per axis
    unsigned cut_axes = 0;
    for (unsigned axis = 0; axis < 3; ++axis) {
      const int i = static_cast<int>(axis);
      bool has_below = false;
      bool has_above = false;
      for (std::uint32_t vertex = 0; vertex < piece.count; ++vertex) {
        has_below |= piece.vertices[vertex][i] < middle[i];
        has_above |= piece.vertices[vertex][i] > middle[i];
      }
      if (has_above && has_below) { cut_axes |= 1U << axis; }
      if (has_above && !has_below) { above |= 1U << axis; }
    }
    if (cut_axes == 0) {
      parts[above].push_back(index);
      return;
    }
    for (ProxyPiece& cut : cut_) { cut.count = 0; }
    cut_[above] = piece;
    for (unsigned axis = 0; axis < 3; ++axis) {
      if ((cut_axes >> axis & 1U) == 0) { continue; }
      for (unsigned octant = 0; octant < 8; ++octant) {
        if ((octant >> axis & 1U) != 0 || cut_[octant].count == 0) { continue; }
        const ProxyPiece whole = cut_[octant];
        split_piece(whole, static_cast<int>(axis), middle[static_cast<int>(axis)], cut_[octant],
                    cut_[octant | (1U << axis)]);
      }
    }
    for (unsigned octant = 0; octant < 8; ++octant) {
      ProxyPiece& cut = cut_[octant];
      if (cut.count < 3) { continue; }
      cut.measure();
      if (!cut.has_area()) { continue; }
      parts[octant].push_back(static_cast<std::uint32_t>(pieces_.size()));
      pieces_.push_back(cut);
    }
  }

  VoxelTree& tree_;
  Later later_{&tree_};
  std::vector<Open> open_;
  std::vector<ProxyPiece> pieces_;  // whole and cut, of all nodes
  std::array<ProxyPiece, 8> cut_;   // by octant: the parts of the piece that is distributed
};

// ---- the cut through all trees that the budget allows ----

// At most a record for so many triangles while splitting; the cut across voxels takes its pick.
constexpr std::size_t kTrianglesPerLeafMin = 5;
constexpr std::size_t kLeavesPerVoxelFree = 12;
constexpr std::uint64_t kDirectoryBytesPerVoxel = 96;

// The cells of the octree nodes that are voxels.
std::vector<Aabb> voxel_cells(const Octree& octree, std::span<const std::uint32_t> voxel_roots) {
  std::vector<Aabb> cells(voxel_roots.size());
  std::unordered_map<std::uint32_t, std::size_t> voxel_of_node;
  for (std::size_t voxel = 0; voxel < voxel_roots.size(); ++voxel) {
    voxel_of_node.emplace(voxel_roots[voxel], voxel);
  }
  if (voxel_roots.empty()) { return cells; }
  std::vector<std::pair<std::uint32_t, Aabb>> pending{{0U, octree.root}};
  while (!pending.empty()) {
    const auto [node, cell] = pending.back();
    pending.pop_back();
    const auto found = voxel_of_node.find(node);
    if (found != voxel_of_node.end()) {
      cells[found->second] = cell;
      continue;
    }
    const std::uint32_t first_child = octree.nodes[node].first_child;
    for (unsigned octant = 0; octant < 8 && first_child != 0; ++octant) {
      pending.emplace_back(first_child + octant, child_cell(cell, octant));
    }
  }
  return cells;
}

// A lower bound of the voxel's bytes in the store.
std::uint64_t voxel_bytes(const Scene& scene, const Octree& octree, std::uint32_t root) {
  const OctreeNode& node = octree.nodes[root];
  FlatIndex triangles(node.references_count / 2);
  FlatIndex vertices(node.references_count / 2);
  bool has_normals = false;
  for (std::uint64_t i = 0; i < node.references_count; ++i) {
    const std::uint32_t id = octree.references[node.references_begin + i];
    const std::size_t known = triangles.size();
    if (triangles.number_of(id) < known) { continue; }
    for (const std::uint32_t vertex : scene.triangles[id].vertices) {
      static_cast<void>(vertices.number_of(vertex));
      has_normals = has_normals || scene.normals[vertex] != Vec3(0.0F);
    }
  }
  return voxel_block_bytes(vertices.size(), triangles.size(), has_normals) +
         kDirectoryBytesPerVoxel;
}

void build_voxel_tree(const Scene& scene, const Octree& octree, std::uint32_t root, float error_min,
                      VoxelTree& tree) {
  const std::vector<std::uint32_t> triangles = triangles_below(octree, root);
  tree.nodes.clear();
  tree.splits.clear();
  VoxelTreeBuilder(tree).build(pieces_in_cell(scene, triangles, tree.cell),
                               kLeavesPerVoxelFree + triangles.size() / kTrianglesPerLeafMin,
                               error_min);
}

// A split of some voxel, by what is kept first.
struct RankedSplit {
  float error = 0.0F;
  std::uint32_t voxel = 0;
  std::uint32_t index = 0;
};

std::vector<RankedSplit> rank_splits(const std::vector<VoxelTree>& trees) {
  std::vector<RankedSplit> ranked;
  for (std::uint32_t voxel = 0; voxel < trees.size(); ++voxel) {
    for (std::uint32_t index = 0; index < trees[voxel].splits.size(); ++index) {
      ranked.push_back({trees[voxel].splits[index].error, voxel, index});
    }
  }
  tbb::parallel_sort(ranked.begin(), ranked.end(), [](const RankedSplit& a, const RankedSplit& b) {
    if (a.error != b.error) { return a.error > b.error; }
    return a.voxel != b.voxel ? a.voxel < b.voxel : a.index < b.index;
  });
  return ranked;
}

std::uint64_t bytes_of(const BuildSplit& split) {
  return split.added * sizeof(ProxyRecord) + kPackedInnerNodeBytes;
}

// Keeps the splits of largest error, over all voxels, whose bytes fit. A voxel's errors never grow
// along its splits, so what is kept of it is always a prefix: a tree. Returns the error of the
// first split that is not kept; 0 if all are.
float keep_splits(std::vector<VoxelTree>& trees, std::uint64_t budget_bytes) {
  for (VoxelTree& tree : trees) { tree.splits_kept = 0; }
  std::uint64_t bytes = 0;
  for (const RankedSplit& split : rank_splits(trees)) {
    VoxelTree& tree = trees[split.voxel];
    bytes += bytes_of(tree.splits[split.index]);
    if (bytes > budget_bytes) { return split.error; }
    tree.splits_kept = split.index + 1;
  }
  return 0.0F;
}

// Most splits that a voxel allows are beyond the budget: nine of ten of a small scene, every second
// or third of a large one. Some voxels, split as far as they allow, tell about where the budget
// ends; the others are split down to a share of that error. Where the budget then ends no lower, no
// split that was left out would have been kept, so the guess never changes the result.
// The stride is odd, as a power of two would meet the same octants again and again. A smaller share
// is cheap: at a fifth of the error there are a sixth more leaves than at the error itself.
constexpr std::size_t kSampleStride = 17;
constexpr std::size_t kSampleVoxelsMin = 32;
constexpr std::array<float, 2> kErrorSharesOfGuess{0.5F, 0.1F};

// What keep_splits() would return if all voxels were as those that are built.
float guess_error_kept(const std::vector<VoxelTree>& trees, std::size_t voxels_built,
                       std::uint64_t budget_bytes) {
  const auto share = static_cast<double>(voxels_built) / static_cast<double>(trees.size());
  double left = share * static_cast<double>(budget_bytes);
  for (const RankedSplit& split : rank_splits(trees)) {
    left -= static_cast<double>(bytes_of(trees[split.voxel].splits[split.index]));
    if (left < 0.0) { return split.error; }
  }
  return 0.0F;
}

// Builds the trees, whose cells are given, as far as the budget keeps their splits.
void build_trees(const Scene& scene, const Octree& octree,
                 std::span<const std::uint32_t> voxel_roots, std::uint64_t budget_bytes,
                 std::vector<VoxelTree>& trees) {
  const auto build_every = [&](std::size_t stride, float error_min) {
    const std::size_t count = (trees.size() + stride - 1) / stride;
    tbb::parallel_for(std::size_t{0}, count, [&](std::size_t i) {
      VoxelTree& tree = trees[i * stride];
      if (tree.error_min <= error_min) { return; }
      build_voxel_tree(scene, octree, voxel_roots[i * stride], error_min, tree);
    });
    return count;
  };
  if (trees.size() >= kSampleStride * kSampleVoxelsMin) {
    const std::size_t count = build_every(kSampleStride, 0.0F);
    const float guess = guess_error_kept(trees, count, budget_bytes);
    for (const float share : kErrorSharesOfGuess) {
      build_every(1, share * guess);
      if (keep_splits(trees, budget_bytes) >= share * guess) { return; }
    }
  }
  build_every(1, 0.0F);
  keep_splits(trees, budget_bytes);
}

// ---- what is kept, packed ----

class MaterialPalette {
 public:
  std::uint16_t index_of(std::uint32_t material) {
    const auto next = static_cast<std::uint32_t>(materials_.size());
    const auto [at, is_new] = index_.emplace(material, next);
    if (is_new) { materials_.push_back(material); }
    CHECK(at->second < kMaterialCountMax);
    return static_cast<std::uint16_t>(at->second);
  }
  [[nodiscard]] std::vector<std::uint32_t> take() { return std::move(materials_); }

 private:
  std::unordered_map<std::uint32_t, std::uint32_t> index_;
  std::vector<std::uint32_t> materials_;
};

void pack_tree(const VoxelTree& tree, MaterialPalette& palette, PackedProxy& packed) {
  const auto is_inner = [&](std::uint32_t node) {
    return tree.nodes[node].split < tree.splits_kept;
  };
  packed.cells.push_back(tree.cell);
  packed.root_inner.push_back(is_inner(0) ? 1 : 0);
  std::vector<std::uint32_t> order{0};
  for (std::size_t at = 0; at < order.size(); ++at) {
    const BuildNode& node = tree.nodes[order[at]];
    if (!is_inner(order[at])) {
      ProxyRecord record = node.summary.record;
      record.material_major = palette.index_of(node.summary.materials[0]);
      record.material_minor = palette.index_of(node.summary.materials[1]);
      packed.records.push_back(record);
      continue;
    }
    PackedProxy::InnerNode inner{node.child_mask, 0};
    std::uint32_t child = node.first_child;
    for (unsigned octant = 0; octant < 8; ++octant) {
      if ((node.child_mask >> octant & 1U) == 0) { continue; }
      if (!is_inner(child)) { inner.leaf_mask |= static_cast<std::uint8_t>(1U << octant); }
      order.push_back(child++);
    }
    packed.inner.push_back(inner);
  }
}

}  // namespace

Proxy build_proxy(const Scene& scene, const Octree& octree,
                  std::span<const std::uint32_t> voxel_roots, std::uint64_t store_bytes_other) {
  std::vector<VoxelTree> trees(voxel_roots.size());
  const std::vector<Aabb> cells = voxel_cells(octree, voxel_roots);
  std::vector<std::uint64_t> bytes(voxel_roots.size());
  tbb::parallel_for(std::size_t{0}, trees.size(), [&](std::size_t voxel) {
    trees[voxel].cell = cells[voxel];
    bytes[voxel] = voxel_bytes(scene, octree, voxel_roots[voxel]);
  });
  const std::uint64_t store_bytes = std::accumulate(bytes.begin(), bytes.end(), store_bytes_other);
  const auto proxy_bytes_max =
      static_cast<std::uint64_t>(static_cast<double>(store_bytes) * kProxyShareMax);
  // No record names a material that the scene does not have.
  const std::uint64_t proxy_bytes_min = sizeof(PackedProxyHeader) +
                                        sizeof(std::uint32_t) * scene.materials.size() +
                                        trees.size() * (kPackedCellBytes + 1 + sizeof(ProxyRecord));
  build_trees(scene, octree, voxel_roots,
              proxy_bytes_max - std::min(proxy_bytes_min, proxy_bytes_max), trees);

  PackedProxy packed;
  MaterialPalette palette;
  for (const VoxelTree& tree : trees) { pack_tree(tree, palette, packed); }
  packed.materials = palette.take();
  Result<Proxy> proxy = expand_proxy(std::move(packed));
  CHECK(proxy.has_value());
  return std::move(*proxy);
}

}  // namespace preheat
