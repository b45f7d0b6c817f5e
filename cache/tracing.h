// Embree behind one file: the hot BVH with boxes for the rest, and ray queries.
//
// One scene holds the hot set as one triangle geometry and every cold voxel as a user-geometry box.
// A query meets a cold voxel in a callback: if it is resident its own small tree is walked there
// (see voxel_bvh.h), otherwise the ray notes (voxel, entry distance) and goes on.
//
// The nearest hit is the lowest (t, global triangle id) among all candidates. Embree alone does not
// give that: it keeps whichever of two equal hits it met first, and may skip a triangle whose box
// begins a rounding error behind the best hit. So a filter judges every hit (see hit_filter.h) and
// keeps tfar a little behind the best t; and a hit is final only if it lies clearly before every
// noted entry. Only then are bits independent of the layout.
// Bits also depend on ISA, ROBUST and query width: all three are fixed here.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "cache/hit_filter.h"
#include "cache/mesh_arrays.h"
#include "cache/resident_table.h"
#include "cache/voxel_bvh.h"
#include "cache/voxel_uses.h"
#include "common/path.h"
#include "common/ray.h"
#include "common/result.h"
#include "common/scene_tables.h"
#include "common/voxel_block.h"

namespace preheat {

// What Embree takes for the box of a voxel outside the hot set, at most, beside kBvhBytesFixed for
// all: memory of a worker that is no part of its cache.
inline constexpr std::uint64_t kColdBoxBytes = 128;

struct MissingVoxel {
  float t_enter = 0.0F;
  VoxelId voxel{};
  friend bool operator==(const MissingVoxel&, const MissingVoxel&) = default;
  friend bool operator<(const MissingVoxel& a, const MissingVoxel& b) {
    return a.t_enter != b.t_enter ? a.t_enter < b.t_enter : index_of(a.voxel) < index_of(b.voxel);
  }
};

// A ray and what is known of its answer; carried while the ray waits for a voxel.
struct RayQuery {
  static constexpr std::size_t kMissingMax = 8;

  Ray ray{};
  bool any_hit = false;  // true: only whether something blocks; t_best stays unset
  bool blocked = false;  // any_hit only
  float t_best = kInfinity;
  std::uint32_t triangle_best = kNoTriangle;
  // Where triangle_best was met, which Residency::surface looks up: if it is hot, its place there,
  // else kNoTriangle and the surface itself.
  std::uint32_t hot_primitive = kNoTriangle;
  float hot_u = 0.0F;
  float hot_v = 0.0F;
  SurfaceHit surface{};
  // The nearest missing voxels, in order; [0] is the one to wait for.
  std::array<MissingVoxel, kMissingMax> missing{};
  std::uint8_t missing_count = 0;
  bool missing_overflow = false;     // more voxels than fit are missing
  MissingVoxel tested_up_to{-1.0F};  // missing voxels up to here have been tested

  [[nodiscard]] bool has_hit() const { return triangle_best != kNoTriangle; }
};

class TracingDevice {
 public:
  // `build_threads` for commits; the calling thread counts as one.
  explicit TracingDevice(unsigned build_threads);
  ~TracingDevice();
  TracingDevice(const TracingDevice&) = delete;
  TracingDevice& operator=(const TracingDevice&) = delete;

  // Embree's own count of the memory of this device's scenes, now and at its highest since reset.
  [[nodiscard]] std::uint64_t bytes() const;
  [[nodiscard]] std::uint64_t bytes_peak() const;
  void reset_peak();
  // The first error since the last call, e.g. out of memory; empty = none.
  [[nodiscard]] std::string take_error();

  struct Impl;
  [[nodiscard]] Impl& impl() const { return *impl_; }

 private:
  std::unique_ptr<Impl> impl_;
};

// One cold voxel, built: its block stays with the owner, the tree over it lives here.
class VoxelMesh {
 public:
  explicit VoxelMesh(const VoxelBlockView& block)
      : arrays_{block.positions, block.normals, block.indices, block.materials, block.triangles},
        bvh_(block) {}
  VoxelMesh(const VoxelMesh&) = delete;
  VoxelMesh& operator=(const VoxelMesh&) = delete;

  [[nodiscard]] const MeshArrays& arrays() const { return arrays_; }
  [[nodiscard]] VoxelTree tree() const { return bvh_.tree(); }

  // Beside the block.
  [[nodiscard]] std::uint64_t bytes() const { return sizeof(VoxelMesh) + bvh_.bytes(); }
  // What bytes() never exceeds.
  [[nodiscard]] static std::uint64_t bytes_max(std::uint64_t triangle_count) {
    return sizeof(VoxelMesh) + VoxelBvh::bytes_max(triangle_count);
  }

 private:
  MeshArrays arrays_;
  VoxelBvh bvh_;
};

// The merged triangles of many blocks, straddling triangles once. Grows block by block, so that a
// block can be dropped as soon as it is added.
class HotMesh {
 public:
  // Room for the given voxels of the directory; never reallocates.
  HotMesh(const SceneTables& tables, std::span<const VoxelId> voxels);
  void add(const VoxelBlockView& block);
  // Frees what only add() needs.
  void all_added() { seen_ = {}; }
  [[nodiscard]] MeshArrays arrays() const;
  [[nodiscard]] std::uint64_t bytes() const;

 private:
  std::vector<float> positions_;
  std::vector<std::uint32_t> normals_;
  std::vector<std::uint32_t> indices_;
  std::vector<std::uint16_t> materials_;
  std::vector<std::uint32_t> triangles_;
  std::vector<bool> seen_;  // [triangle_count of the scene]
  bool has_normals_ = false;
};

// The scene that rays are traced against. Immutable after construction but for the resident table.
class Residency {
 public:
  // `cold` are the voxels outside the hot mesh; `hot` may be empty. Both outlive this.
  Residency(TracingDevice& device, const HotMesh& hot, const SceneTables& tables,
            std::span<const VoxelId> cold, ResidentTable& resident);
  ~Residency();
  Residency(const Residency&) = delete;
  Residency& operator=(const Residency&) = delete;

  enum class Answer { kFinal, kWaiting };

  // Queries everything that is resident, and says in `uses` which cold voxels that was. A ray that
  // is none (NaN, infinite, an empty range) meets nothing. Requires: a Guard of this thread on the
  // resident table.
  Answer trace(RayQuery& query, VoxelUses& uses) const;

  // Goes on after missing[0] has become resident: tests it and whatever follows, never the whole
  // scene unless more than kMissingMax voxels were missing. kWaiting again if missing[0] is absent.
  Answer resume(RayQuery& query, VoxelUses& uses) const;

  // What shading needs of a query's hit. Requires: query.has_hit(), of a query to this.
  [[nodiscard]] SurfaceHit surface(const RayQuery& query) const;

  struct Impl;

 private:
  std::unique_ptr<Impl> impl_;
};

// Calls visit(index) for every leaf of a tree whose bounds the ray enters before t_end. Nodes lie
// as in SceneTables::voxel_nodes, whose leaves are the voxels, so that there it counts the ray's
// accesses; the index is VoxelNode::first of the leaf. A walk of its own, as the hot BVH has no
// callbacks.
template <class Visit>
void for_each_cell(std::span<const VoxelNode> nodes, const Ray& ray, float t_end, Visit&& visit) {
  if (nodes.empty()) { return; }
  const Ray bounded{ray.origin, ray.direction, ray.t_min, std::min(ray.t_max, t_end)};
  std::array<std::uint32_t, 8 * 22 + 1> pending;  // at most 7 siblings wait at each level
  std::size_t pending_count = 0;
  pending[pending_count++] = 0;
  while (pending_count > 0) {
    const VoxelNode& node = nodes[pending[--pending_count]];
    if (clip(bounded, node.bounds).is_empty()) { continue; }
    if (node.count == 0) {
      visit(node.first);
      continue;
    }
    for (std::uint32_t child = 0; child < node.count; ++child) {
      pending[pending_count++] = node.first + child;
    }
  }
}

}  // namespace preheat
