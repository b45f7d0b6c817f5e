// What predictions are judged by: a scene compiled in memory, and the accesses that a plain path
// tracer counts in it, ray by ray, with real triangles.
#pragma once

#include <cstdint>
#include <vector>

#include "cache/prediction.h"
#include "common/octree.h"
#include "common/proxy.h"
#include "common/render_settings.h"
#include "common/scene.h"
#include "common/scene_tables.h"

namespace preheat::test {

struct CompiledScene {
  Scene scene{};
  Octree octree{};
  std::vector<std::uint32_t> voxel_roots{};
  SceneTables tables{};
  Proxy proxy{};
};

// Voxels of at most so many triangle references.
[[nodiscard]] CompiledScene compile_in_memory(Scene scene, std::uint32_t voxel_references_max);

// A furnished room with clutter on its tables: diffuse, metal and glass things, a lamp in the
// ceiling. About 1000 * clutter triangles.
[[nodiscard]] Scene make_room(std::uint32_t clutter, std::uint32_t seed);

// A view from a corner of that room.
[[nodiscard]] RenderSettings room_settings(std::uint32_t size, std::uint32_t spp);

// Every ray of the render, traced by Embree; shading by common/path.h. Counted per voxel by a scan
// of the voxel's bounds.
[[nodiscard]] Prediction count_accesses(const CompiledScene& compiled,
                                        const RenderSettings& settings);

struct Agreement {
  double pearson = 0.0;
  double slope = 0.0;                  // of the least squares line through (counted, predicted)
  double total = 0.0;                  // predicted / counted
  std::vector<double> capture{};       // at kCaptureShares of the bytes
  std::vector<double> capture_best{};  // the same for the counts themselves
};
inline constexpr double kCaptureShares[] = {0.01, 0.1, 0.25, 0.5};

[[nodiscard]] Agreement compare(const SceneTables& tables, const Prediction& predicted,
                                const Prediction& counted);

}  // namespace preheat::test
