#include "common/octree.h"

#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstddef>
#include <limits>
#include <numeric>
#include <span>
#include <utility>

#include "common/check.h"
#include "common/flat_index.h"
#include "common/scene_tables.h"

namespace preheat {
namespace {

constexpr std::size_t kChildren = 8;

// A node with at most this many references is built by one task, with all that lies below it. The
// result does not depend on it.
constexpr std::size_t kTaskReferencesMax = std::size_t{1} << 14;

// References that one task distributes of a node above that.
constexpr std::size_t kChunkReferences = std::size_t{1} << 13;

constexpr int kAnyDirection = 3;

// The axis that is the cross product of an edge and the coordinate axis kAcross. A template so that
// no component is looked up by a variable: this is the innermost code of the build.
template <int kAcross, class Visit>
[[nodiscard]] bool visit_edge_axis(const Vec3d& from, const Vec3d& along, const Vec3d& opposite,
                                   const Vec3d& reach, Visit&& visit) {
  constexpr int kU = (kAcross + 1) % 3;
  constexpr int kV = (kAcross + 2) % 3;
  Vec3d weights(0.0);
  weights[kU] = -along[kV];
  weights[kV] = along[kU];
  // Both ends of the edge project to the same value.
  const double at_edge = weights[kU] * from[kU] + weights[kV] * from[kV];
  const double at_opposite = weights[kU] * opposite[kU] + weights[kV] * opposite[kV];
  const double radius = std::abs(weights[kU]) * reach[kU] + std::abs(weights[kV]) * reach[kV];
  return visit(kAcross, weights, std::min(at_edge, at_opposite) - radius,
               std::max(at_edge, at_opposite) + radius);
}

// Calls visit(across, weights, low, high) for the ten axes on which a triangle and a box may be
// separated besides the box's own normals, until visit returns false: a box of the given half
// extent overlaps the triangle only if low <= dot(weights, its centre) <= high on every one. Nine
// are cross products of an edge and the coordinate axis `across`, where weights[across] is 0; the
// plane's normal has kAnyDirection and comes first, as it separates most often.
//
// Coordinates are floats, so in double a projection errs by no more than a few 2^-53 of what is
// summed; kSlack covers that many times over. The normal may cancel down to noise for slivers,
// which is why its slack is taken of the edges' lengths and not of its own.
template <class Visit>
void for_each_axis(const std::array<Vec3d, 3>& vertices, const Vec3d& half_extent, Visit&& visit) {
  constexpr double kSlack = 1.0 / static_cast<double>(std::uint64_t{1} << 48U);
  const auto sum_of = [](const Vec3d& v) { return v.x + v.y + v.z; };
  double magnitude = sum_of(half_extent);
  for (const Vec3d& vertex : vertices) { magnitude += sum_of(glm::abs(vertex)); }
  const Vec3d reach = half_extent + Vec3d(kSlack * magnitude);

  const std::array<Vec3d, 3> along{vertices[1] - vertices[0], vertices[2] - vertices[1],
                                   vertices[0] - vertices[2]};
  const Vec3d normal = glm::cross(along[0], along[1]);
  const double offset = glm::dot(normal, vertices[0]);
  const double radius = glm::dot(glm::abs(normal), reach) + kSlack * magnitude *
                                                                sum_of(glm::abs(along[0])) *
                                                                sum_of(glm::abs(along[1]));
  if (!visit(kAnyDirection, normal, offset - radius, offset + radius)) { return; }
  for (std::size_t edge = 0; edge < 3; ++edge) {
    const Vec3d& from = vertices[edge];
    const Vec3d& opposite = vertices[(edge + 2) % 3];
    const bool go_on = visit_edge_axis<0>(from, along[edge], opposite, reach, visit) &&
                       visit_edge_axis<1>(from, along[edge], opposite, reach, visit) &&
                       visit_edge_axis<2>(from, along[edge], opposite, reach, visit);
    if (!go_on) { return; }
  }
}

[[nodiscard]] Vec3d centre_of(const Aabb& box) { return 0.5 * (Vec3d(box.low) + Vec3d(box.high)); }
[[nodiscard]] Vec3d half_of(const Aabb& box) { return 0.5 * (Vec3d(box.high) - Vec3d(box.low)); }

[[nodiscard]] Vec3 split_point(const Aabb& cell) { return 0.5F * (cell.low + cell.high); }

// Which children of one cell a triangle overlaps. A set of children is a byte, bit i for child i.
class CellSplit {
 public:
  explicit CellSplit(const Aabb& cell)
      : cell_(cell),
        split_(split_point(cell)),
        lower_end_(split_ + Vec3(kVoxelMargin)),
        upper_begin_(split_ - Vec3(kVoxelMargin)) {
    for (const unsigned octant : {0U, 7U}) {  // the lower and the upper half on each axis
      const Aabb child = grown_cell(child_cell(cell, octant));
      centres_[octant & 1U] = centre_of(child);
      half_extent_ = glm::max(half_extent_, half_of(child));  // they differ by rounding
    }
  }

  // Requires: the triangle overlaps the grown cell.
  [[nodiscard]] unsigned children_of(const Vec3& a, const Vec3& b, const Vec3& c) const {
    const Vec3 low = glm::min(glm::min(a, b), c);
    const Vec3 high = glm::max(glm::max(a, b), c);
    const unsigned possible = on_sides(low.x, high.x, lower_end_.x, upper_begin_.x, kUpperX) &
                              on_sides(low.y, high.y, lower_end_.y, upper_begin_.y, kUpperY) &
                              on_sides(low.z, high.z, lower_end_.z, upper_begin_.z, kUpperZ);
    if (is_one(possible)) { return possible; }
    const bool inside = low.x >= cell_.low.x && low.y >= cell_.low.y && low.z >= cell_.low.z &&
                        high.x <= cell_.high.x && high.y <= cell_.high.y && high.z <= cell_.high.z;
    // Of a triangle that lies in the cell, the children that hold its vertices are certain.
    const unsigned certain = inside ? child_at(a) | child_at(b) | child_at(c) : 0U;
    return certain == possible ? certain
                               : separate({Vec3d(a), Vec3d(b), Vec3d(c)}, possible, certain);
  }

 private:
  // The children in the upper half on each axis.
  static constexpr unsigned kUpperX = 0xAA;
  static constexpr unsigned kUpperY = 0xCC;
  static constexpr unsigned kUpperZ = 0xF0;

  [[nodiscard]] static constexpr unsigned upper_half(int axis) {
    return axis == 0 ? kUpperX : axis == 1 ? kUpperY : kUpperZ;
  }
  // The children that an interval reaches on one axis, where `upper` are those in the upper half.
  [[nodiscard]] static unsigned on_sides(float low, float high, float lower_end, float upper_begin,
                                         unsigned upper) {
    return (low <= lower_end ? ~upper & 0xFFU : 0U) | (high >= upper_begin ? upper : 0U);
  }
  [[nodiscard]] static bool is_one(unsigned children) { return (children & (children - 1)) == 0; }

  [[nodiscard]] unsigned child_at(const Vec3& point) const {
    const unsigned octant = static_cast<unsigned>(point.x > split_.x) |
                            static_cast<unsigned>(point.y > split_.y) << 1U |
                            static_cast<unsigned>(point.z > split_.z) << 2U;
    return 1U << octant;
  }

  // Takes from `possible` what an axis separates from the triangle, until nothing but `certain` is
  // left, or one child: as the triangle overlaps the cell, it overlaps the last one.
  [[nodiscard]] unsigned separate(const std::array<Vec3d, 3>& vertices, unsigned possible,
                                  unsigned certain) const {
    for_each_axis(vertices, half_extent_,
                  [&](int across, const Vec3d& weights, double low, double high) {
                    const Vec3d at_lower = weights * centres_[0];
                    const Vec3d at_upper = weights * centres_[1];
                    const auto reached = [&](double at) {
                      return static_cast<unsigned>(at >= low && at <= high);
                    };
                    unsigned overlapped = 0;
                    if (across == kAnyDirection) {
                      for (unsigned octant = 0; octant < kChildren; ++octant) {
                        const double at = ((octant & 1U) != 0 ? at_upper.x : at_lower.x) +
                                          ((octant & 2U) != 0 ? at_upper.y : at_lower.y) +
                                          ((octant & 4U) != 0 ? at_upper.z : at_lower.z);
                        overlapped |= reached(at) << octant;
                      }
                    } else {
                      const int u = (across + 1) % 3;
                      const int v = (across + 2) % 3;
                      const unsigned upper_u = upper_half(u);
                      const unsigned upper_v = upper_half(v);
                      overlapped |= -reached(at_lower[u] + at_lower[v]) & ~upper_u & ~upper_v;
                      overlapped |= -reached(at_upper[u] + at_lower[v]) & upper_u & ~upper_v;
                      overlapped |= -reached(at_lower[u] + at_upper[v]) & ~upper_u & upper_v;
                      overlapped |= -reached(at_upper[u] + at_upper[v]) & upper_u & upper_v;
                    }
                    possible &= overlapped | certain;
                    return possible != certain && !is_one(possible);
                  });
    return possible;
  }

  Aabb cell_;
  Vec3 split_;
  Vec3 lower_end_;    // of the grown lower children
  Vec3 upper_begin_;  // of the grown upper children
  Vec3d half_extent_{0.0};
  std::array<Vec3d, 2> centres_{};  // of the lower and the upper children, by axis
};

// A node that waits to be split or to become a leaf.
struct Pending {
  Aabb cell{};
  double growth = 1.0;  // see kReferenceGrowthMax
  std::uint32_t depth = 0;
};

class Builder {
 public:
  Builder(const Scene& scene, const OctreeLimits& limits) : scene_(scene), limits_(limits) {}

  [[nodiscard]] Octree build();

 private:
  using Counts = std::array<std::size_t, kChildren>;

  // A tree of its own, whose nodes[0] goes where its parent's split put it.
  struct Subtree {
    std::vector<OctreeNode> nodes{};
    std::vector<std::uint32_t> references{};
    std::uint32_t depth_max = 0;
  };

  // The upper part of the octree: inner nodes, and where its leaves are built by a task each.
  struct TopNode {
    Pending place{};
    std::vector<std::uint32_t> triangles{};  // emptied once split
    std::uint32_t first_child = 0;           // into top_; 0 = `subtree` is built here
    bool is_leaf = false;                    // a split was tried and is not worth it
    Subtree subtree{};
  };

  [[nodiscard]] bool may_split(const Pending& place, std::size_t references) const;
  [[nodiscard]] static bool is_worth(const Pending& place, std::size_t references,
                                     std::size_t references_of_children);
  void find_children(const CellSplit& split, std::span<const std::uint32_t> triangles,
                     std::span<std::uint8_t> children, Counts& counts) const;
  void grow_top();
  void split_top(std::size_t index);
  [[nodiscard]] Subtree build_subtree(const Pending& root,
                                      std::vector<std::uint32_t> triangles) const;
  [[nodiscard]] Octree assemble(const Aabb& root_cell);

  const Scene& scene_;
  const OctreeLimits& limits_;
  std::vector<TopNode> top_{};
};

// A cube around the scene, anchored at its lower corner: the faces of a flat or box-shaped scene
// then lie in outer cells and not in the plane of the first split, which would reference them
// twice.
Aabb root_cube(const Scene& scene) {
  Aabb bounds;
  for (const Triangle& triangle : scene.triangles) {
    for (const std::uint32_t vertex : triangle.vertices) { bounds.extend(scene.positions[vertex]); }
  }
  if (bounds.is_empty()) { return {Vec3(-1.0F), Vec3(1.0F)}; }
  const Vec3 extent = bounds.extent();
  const float largest = std::max({extent.x, extent.y, extent.z});
  const Vec3 low = bounds.low - Vec3(4.0F * kVoxelMargin);
  return {low, low + Vec3(largest + 8.0F * kVoxelMargin)};
}

bool Builder::may_split(const Pending& place, std::size_t references) const {
  if (references <= limits_.leaf_references_max || place.depth >= limits_.depth_max) {
    return false;
  }
  const Vec3 extent = place.cell.extent();
  return std::min({extent.x, extent.y, extent.z}) >= 4.0F * kVoxelMargin;
}

bool Builder::is_worth(const Pending& place, std::size_t references,
                       std::size_t references_of_children) {
  const double growth =
      static_cast<double>(references_of_children) / static_cast<double>(references);
  return growth <= kSplitGrowthMax && place.growth * growth <= kReferenceGrowthMax;
}

void Builder::find_children(const CellSplit& split, std::span<const std::uint32_t> triangles,
                            std::span<std::uint8_t> children, Counts& counts) const {
  for (std::size_t i = 0; i < triangles.size(); ++i) {
    const std::array<std::uint32_t, 3>& vertices = scene_.triangles[triangles[i]].vertices;
    const unsigned overlapped =
        split.children_of(scene_.positions[vertices[0]], scene_.positions[vertices[1]],
                          scene_.positions[vertices[2]]);
    children[i] = static_cast<std::uint8_t>(overlapped);
    for (unsigned left = overlapped; left != 0; left &= left - 1) {
      ++counts[static_cast<std::size_t>(std::countr_zero(left))];
    }
  }
}

// Splits top_[index] with all threads, unless it shall be a leaf.
void Builder::split_top(std::size_t index) {
  const Pending place = top_[index].place;
  std::vector<std::uint32_t> triangles = std::move(top_[index].triangles);
  const CellSplit split(place.cell);
  const std::size_t chunks = (triangles.size() + kChunkReferences - 1) / kChunkReferences;
  std::vector<std::uint8_t> children(triangles.size());
  std::vector<Counts> counts(chunks, Counts{});
  const auto chunk_of = [&](std::size_t chunk, auto all) {
    const std::size_t begin = chunk * kChunkReferences;
    return all.subspan(begin, std::min(kChunkReferences, all.size() - begin));
  };
  tbb::parallel_for(std::size_t{0}, chunks, [&](std::size_t chunk) {
    find_children(split, chunk_of(chunk, std::span<const std::uint32_t>(triangles)),
                  chunk_of(chunk, std::span<std::uint8_t>(children)), counts[chunk]);
  });

  // Turns each chunk's counts into the places where it writes, so that the order is kept.
  Counts total{};
  for (Counts& of_chunk : counts) {
    for (std::size_t octant = 0; octant < kChildren; ++octant) {
      total[octant] += std::exchange(of_chunk[octant], total[octant]);
    }
  }
  const std::size_t sum = std::accumulate(total.begin(), total.end(), std::size_t{0});
  if (!is_worth(place, triangles.size(), sum)) {
    top_[index].triangles = std::move(triangles);
    top_[index].is_leaf = true;
    return;
  }

  const std::size_t first_child = top_.size();
  top_[index].first_child = static_cast<std::uint32_t>(first_child);
  for (unsigned octant = 0; octant < kChildren; ++octant) {
    TopNode& child = top_.emplace_back();
    child.place = {child_cell(place.cell, octant),
                   place.growth * static_cast<double>(sum) / static_cast<double>(triangles.size()),
                   place.depth + 1};
    child.triangles.resize(total[octant]);
  }
  tbb::parallel_for(std::size_t{0}, chunks, [&](std::size_t chunk) {
    const std::span<const std::uint32_t> from =
        chunk_of(chunk, std::span<const std::uint32_t>(triangles));
    const std::span<const std::uint8_t> where =
        chunk_of(chunk, std::span<const std::uint8_t>(children));
    Counts next = counts[chunk];
    for (std::size_t i = 0; i < from.size(); ++i) {
      for (unsigned left = where[i]; left != 0; left &= left - 1) {
        const auto octant = static_cast<std::size_t>(std::countr_zero(left));
        top_[first_child + octant].triangles[next[octant]++] = from[i];
      }
    }
  });
}

void Builder::grow_top() {
  for (std::size_t index = 0; index < top_.size(); ++index) {  // grows while it is walked
    const std::size_t references = top_[index].triangles.size();
    if (references > kTaskReferencesMax && may_split(top_[index].place, references)) {
      split_top(index);
    }
  }
}

// Depth-first with a stack of its own. The waiting nodes' triangles lie in one buffer in the order
// of the stack, so that a node's are always the last of it and its children's go behind.
Builder::Subtree Builder::build_subtree(const Pending& root,
                                        std::vector<std::uint32_t> triangles) const {
  struct Entry {
    Pending place{};
    std::size_t node = 0;
    std::size_t begin = 0;
    std::size_t count = 0;
  };
  Subtree tree;
  tree.nodes.emplace_back();
  std::vector<std::uint32_t> buffer = std::move(triangles);
  std::vector<std::uint8_t> children;
  std::vector<Entry> waiting{{root, 0, 0, buffer.size()}};
  while (!waiting.empty()) {
    const Entry entry = waiting.back();
    waiting.pop_back();
    buffer.resize(entry.begin + entry.count);

    Counts counts{};
    std::size_t sum = 0;
    bool split = may_split(entry.place, entry.count);
    if (split) {
      children.resize(entry.count);
      const std::span<const std::uint32_t> mine(buffer.data() + entry.begin, entry.count);
      find_children(CellSplit(entry.place.cell), mine, children, counts);
      sum = std::accumulate(counts.begin(), counts.end(), std::size_t{0});
      split = is_worth(entry.place, entry.count, sum);
    }
    if (!split) {
      OctreeNode& leaf = tree.nodes[entry.node];
      leaf.references_begin = tree.references.size();
      leaf.references_count = static_cast<std::uint32_t>(entry.count);
      tree.references.insert(tree.references.end(),
                             buffer.begin() + static_cast<std::ptrdiff_t>(entry.begin),
                             buffer.end());
      tree.depth_max = std::max(tree.depth_max, entry.place.depth);
      continue;
    }

    const std::size_t first_child = tree.nodes.size();
    tree.nodes[entry.node].first_child = static_cast<std::uint32_t>(first_child);
    tree.nodes.resize(first_child + kChildren);
    const double growth =
        entry.place.growth * static_cast<double>(sum) / static_cast<double>(entry.count);
    std::size_t end = buffer.size();
    buffer.resize(end + sum);
    Counts next{};
    for (unsigned octant = kChildren; octant-- > 0;) {  // octant 0 is popped first
      waiting.push_back({{child_cell(entry.place.cell, octant), growth, entry.place.depth + 1},
                         first_child + octant,
                         end,
                         counts[octant]});
      next[octant] = end;
      end += counts[octant];
    }
    for (std::size_t i = 0; i < entry.count; ++i) {
      for (unsigned left = children[i]; left != 0; left &= left - 1) {
        buffer[next[static_cast<std::size_t>(std::countr_zero(left))]++] = buffer[entry.begin + i];
      }
    }
  }
  return tree;
}

// Lays the subtrees out as one depth-first build would have done.
Octree Builder::assemble(const Aabb& root_cell) {
  struct Place {
    std::size_t top = 0;
    std::size_t node = 0;
  };
  struct Copy {
    Subtree* from = nullptr;
    std::size_t root = 0;
    std::size_t nodes_begin = 0;
    std::size_t references_begin = 0;
  };
  Octree octree;
  octree.root = root_cell;
  std::vector<Copy> copies;
  std::vector<std::array<std::size_t, 2>> inner;  // node, its first child
  std::size_t node_count = 1;
  std::size_t reference_count = 0;
  std::vector<Place> waiting{{0, 0}};
  while (!waiting.empty()) {
    const Place place = waiting.back();
    waiting.pop_back();
    TopNode& top = top_[place.top];
    if (top.first_child == 0) {
      copies.push_back({&top.subtree, place.node, node_count, reference_count});
      node_count += top.subtree.nodes.size() - 1;
      reference_count += top.subtree.references.size();
      octree.depth_max = std::max(octree.depth_max, top.subtree.depth_max);
      continue;
    }
    inner.push_back({place.node, node_count});
    for (std::size_t octant = kChildren; octant-- > 0;) {
      waiting.push_back({top.first_child + octant, node_count + octant});
    }
    node_count += kChildren;
  }
  CHECK(node_count <= std::numeric_limits<std::uint32_t>::max());
  CHECK(reference_count <= std::numeric_limits<std::uint32_t>::max());

  octree.nodes.resize(node_count);
  octree.references.resize(reference_count);
  for (const auto& [node, first_child] : inner) {
    octree.nodes[node].first_child = static_cast<std::uint32_t>(first_child);
  }
  tbb::parallel_for(std::size_t{0}, copies.size(), [&](std::size_t index) {
    const Copy& copy = copies[index];
    for (std::size_t i = 0; i < copy.from->nodes.size(); ++i) {
      OctreeNode node = copy.from->nodes[i];
      node.references_begin += copy.references_begin;
      if (node.first_child != 0) {
        node.first_child += static_cast<std::uint32_t>(copy.nodes_begin - 1);
      }
      octree.nodes[i == 0 ? copy.root : copy.nodes_begin + i - 1] = node;
    }
    std::copy(copy.from->references.begin(), copy.from->references.end(),
              octree.references.begin() + static_cast<std::ptrdiff_t>(copy.references_begin));
    *copy.from = {};
  });
  for (std::size_t i = node_count; i-- > 0;) {  // children lie behind their parent
    OctreeNode& node = octree.nodes[i];
    if (node.first_child == 0) { continue; }
    node.references_begin = octree.nodes[node.first_child].references_begin;
    for (std::size_t octant = 0; octant < kChildren; ++octant) {
      node.references_count += octree.nodes[node.first_child + octant].references_count;
    }
  }
  return octree;
}

Octree Builder::build() {
  TopNode& root = top_.emplace_back();
  root.place.cell = root_cube(scene_);
  const Aabb root_cell = root.place.cell;
  root.triangles.resize(scene_.triangles.size());
  std::iota(root.triangles.begin(), root.triangles.end(), 0U);
  grow_top();
  tbb::parallel_for(std::size_t{0}, top_.size(), [&](std::size_t index) {
    TopNode& top = top_[index];
    if (top.is_leaf) {
      top.subtree = {
          .nodes = {{.references_count = static_cast<std::uint32_t>(top.triangles.size())}},
          .references = std::move(top.triangles),
          .depth_max = top.place.depth};
    } else if (top.first_child == 0) {
      top.subtree = build_subtree(top.place, std::move(top.triangles));
    }
  });
  return assemble(root_cell);
}

}  // namespace

Aabb child_cell(const Aabb& cell, unsigned octant) {
  const Vec3 split = split_point(cell);
  Aabb child = cell;
  for (int axis = 0; axis < 3; ++axis) {
    if ((octant >> axis & 1U) != 0U) {
      child.low[axis] = split[axis];
    } else {
      child.high[axis] = split[axis];
    }
  }
  return child;
}

Aabb grown_cell(const Aabb& cell) {
  return {cell.low - Vec3(kVoxelMargin), cell.high + Vec3(kVoxelMargin)};
}

bool triangle_overlaps_box(const Vec3& a, const Vec3& b, const Vec3& c, const Aabb& box) {
  for (int axis = 0; axis < 3; ++axis) {
    if (std::min({a[axis], b[axis], c[axis]}) > box.high[axis]) { return false; }
    if (std::max({a[axis], b[axis], c[axis]}) < box.low[axis]) { return false; }
  }
  const Vec3d centre = centre_of(box);
  bool overlap = true;
  for_each_axis({Vec3d(a), Vec3d(b), Vec3d(c)}, half_of(box),
                [&](int /*across*/, const Vec3d& weights, double low, double high) {
                  const double at = glm::dot(weights, centre);
                  overlap = at >= low && at <= high;
                  return overlap;
                });
  return overlap;
}

std::vector<std::uint32_t> triangles_below(const Octree& octree, std::uint32_t node) {
  const OctreeNode& subtree = octree.nodes[node];
  const auto begin =
      octree.references.begin() + static_cast<std::ptrdiff_t>(subtree.references_begin);
  FlatIndex seen(subtree.references_count / 2);
  std::vector<std::uint32_t> ids;
  for (auto id = begin; id != begin + subtree.references_count; ++id) {
    if (seen.number_of(*id) == ids.size()) { ids.push_back(*id); }
  }
  std::sort(ids.begin(), ids.end());
  return ids;
}

Octree build_octree(const Scene& scene, const OctreeLimits& limits) {
  CHECK(limits.depth_max <= kOctreeDepthMax);
  CHECK(scene.triangles.size() < std::numeric_limits<std::uint32_t>::max());
  const int threads =
      limits.threads == 0 ? tbb::task_arena::automatic : static_cast<int>(limits.threads);
  return tbb::task_arena(threads).execute([&] { return Builder(scene, limits).build(); });
}

}  // namespace preheat
