// The same voxels in different layouts of hot and cold, for tests that trace rays through them.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <vector>

#include "cache/tracing.h"
#include "tests/scenes/grid_store.h"
#include "tests/scenes/soups.h"

namespace preheat::test {

inline Vec3 unit_direction(SoupRandom& random) {
  for (;;) {
    const Vec3 direction = random.in_cube(-1.0F, 1.0F);
    const float squared = glm::dot(direction, direction);
    if (squared > 0.01F && squared < 1.0F) { return direction / std::sqrt(squared); }
  }
}

// Everything that reaches shading, bit by bit.
struct Outcome {
  bool any_hit = false;
  float t = 0.0F;
  std::uint32_t triangle = kNoTriangle;
  SurfaceHit surface{};
};

inline bool same_bits(const Outcome& a, const Outcome& b) {
  if (a.any_hit != b.any_hit || a.triangle != b.triangle) { return false; }
  return a.triangle == kNoTriangle || (std::memcmp(&a.t, &b.t, sizeof a.t) == 0 &&
                                       std::memcmp(&a.surface, &b.surface, sizeof a.surface) == 0);
}

// A residency over some hot voxels, with at most `resident_max` cold ones published, first in first
// out.
class Layout {
 public:
  Layout(const GridStore& store, const std::vector<VoxelId>& hot, std::size_t resident_max)
      : store_(store),
        resident_max_(resident_max),
        table_(store.blocks.size(), 1),
        uses_(store.blocks.size()),
        hot_mesh_(store.tables, hot) {
    std::set<VoxelId> hot_ids(hot.begin(), hot.end());
    for (const VoxelId voxel : hot) { hot_mesh_.add(store.view(voxel)); }
    for (std::uint32_t id = 0; id < store.blocks.size(); ++id) {
      if (!hot_ids.contains(VoxelId{id})) { cold_.push_back(VoxelId{id}); }
    }
    residency_.emplace(device_, hot_mesh_, store.tables, cold_, table_);
  }

  Outcome trace(const Ray& ray) {
    Outcome outcome;
    RayQuery closest;
    closest.ray = ray;
    answer(closest);
    outcome.t = closest.t_best;
    outcome.triangle = closest.triangle_best;
    if (closest.has_hit()) { outcome.surface = residency_->surface(closest); }
    RayQuery any;
    any.ray = ray;
    any.any_hit = true;
    answer(any);
    outcome.any_hit = any.blocked;
    return outcome;
  }

  [[nodiscard]] std::size_t parked_count() const { return parked_count_; }
  [[nodiscard]] std::size_t parked_longest() const { return parked_longest_; }

 private:
  void answer(RayQuery& query) {
    const ResidentTable::Guard guard(table_, 0);
    Residency::Answer answer = residency_->trace(query, uses_);
    std::size_t parked = 0;
    while (answer == Residency::Answer::kWaiting) {
      ++parked;
      ASSERT_LE(parked, store_.blocks.size()) << "a voxel was asked for twice";
      make_resident(query.missing[0].voxel);
      answer = residency_->resume(query, uses_);
    }
    parked_count_ += parked;
    parked_longest_ = std::max(parked_longest_, parked);
  }

  void make_resident(VoxelId voxel) {
    if (published_.size() == resident_max_) {
      static_cast<void>(table_.withdraw(published_.front()));
      published_.erase(published_.begin());
    }
    std::unique_ptr<VoxelMesh>& mesh = meshes_[voxel];
    if (mesh == nullptr) { mesh = std::make_unique<VoxelMesh>(store_.view(voxel)); }
    table_.publish(voxel, mesh.get());
    published_.push_back(voxel);
  }

  const GridStore& store_;
  std::size_t resident_max_;
  TracingDevice device_{1};
  ResidentTable table_;
  VoxelUses uses_;
  HotMesh hot_mesh_;
  std::vector<VoxelId> cold_;
  std::optional<Residency> residency_;
  std::map<VoxelId, std::unique_ptr<VoxelMesh>> meshes_;
  std::vector<VoxelId> published_;
  std::size_t parked_count_ = 0;
  std::size_t parked_longest_ = 0;
};

inline std::vector<VoxelId> every_voxel(const GridStore& store, std::uint32_t stride) {
  std::vector<VoxelId> voxels;
  for (std::uint32_t id = 0; id < store.blocks.size(); id += stride) {
    voxels.push_back(VoxelId{id});
  }
  return voxels;
}

}  // namespace preheat::test
