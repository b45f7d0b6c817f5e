#include "cache/area_models.h"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <cmath>

#include "common/path_rules.h"

namespace preheat {
namespace {

double surface(const Aabb& box) {
  if (box.is_empty()) { return 0.0; }
  const Vec3d extent(box.extent());
  return 2.0 * (extent.x * extent.y + extent.y * extent.z + extent.z * extent.x);
}

// A line that meets the outer box meets the inner one. Where there is nothing to miss it does so
// surely.
double chance_to_meet(double surface_inner, double surface_outer) {
  return surface_outer > 0.0 ? std::min(1.0, surface_inner / surface_outer) : 1.0;
}

Aabb union_of_bounds(const SceneTables& tables) {
  Aabb all;
  for (const VoxelEntry& voxel : tables.voxels) { all.extend(voxel.bounds); }
  return all;
}

Aabb union_of_cells(const Proxy& proxy) {
  Aabb all;
  for (const Aabb& cell : proxy.cells) { all.extend(cell); }
  return all;
}

Result<void> check_proxy(const PredictionInput& input) {
  if (input.proxy.cells.size() == input.tables.voxels.size()) { return {}; }
  return fail(ExitCode::kStoreDamaged,
              fmt::format("store damaged: the proxy has {} voxels, the tables have {}",
                          input.proxy.cells.size(), input.tables.voxels.size()));
}

// The rays of the frame and, for each voxel, their share in it.
Prediction spread(const PredictionInput& input, const std::vector<double>& chances) {
  const RenderSettings& settings = input.settings;
  const SceneTables& tables = input.tables;
  const bool has_sky = settings.sky != Vec3(0.0F);
  const bool emission_can_be_met = has_sky || !tables.emissive_triangles.empty();
  const bool has_lights = emission_can_be_met || !tables.lights.empty();
  Prediction prediction;
  prediction.camera_total = sample_count(settings);
  double scatterings = 0.0;
  double lit_vertices = 0.0;
  for (std::uint32_t bounce = 0; may_scatter(bounce, settings.bounces); ++bounce) {
    lit_vertices += has_lights ? 1.0 : 0.0;
    scatterings += may_continue(bounce, settings.bounces, emission_can_be_met) ? 1.0 : 0.0;
  }
  prediction.scatter_total = prediction.camera_total * scatterings;
  prediction.shadow_total =
      prediction.camera_total * lit_vertices * static_cast<double>(kLightSamplesPerVertex);
  for (const double chance : chances) {
    prediction.rays_camera.push_back(prediction.camera_total * chance);
    prediction.rays_scatter.push_back(prediction.scatter_total * chance);
    prediction.rays_shadow.push_back(prediction.shadow_total * chance);
  }
  return prediction;
}

std::vector<double> chances_to_meet_bounds(const SceneTables& tables) {
  const double scene = surface(union_of_bounds(tables));
  std::vector<double> chances;
  for (const VoxelEntry& voxel : tables.voxels) {
    chances.push_back(chance_to_meet(surface(voxel.bounds), scene));
  }
  return chances;
}

void scale(std::vector<double>& chances, double factor) {
  for (double& chance : chances) { chance *= factor; }
}

// The share of a leaf's bounds that geometry fills as a ray sees it: a flat leaf's piece of a plane
// is crossed by whatever crosses the bounds.
double filled_share(const ProxyRecord& record) {
  constexpr double kFull = 255.0;
  const double occupied = static_cast<double>(std::popcount(record_mask(record))) / 64.0;
  if ((record.shape & kShapeFlat) != 0) { return occupied * record.coverage[0] / kFull; }
  const double coverage = record.coverage[0] + record.coverage[1] + record.coverage[2];
  return occupied * coverage / (3.0 * kFull);
}

// Surfaces that a line through the scene meets on its whole way.
double surfaces_met(const PredictionInput& input) {
  const double scene = surface(union_of_bounds(input.tables));
  double met = 0.0;
  for (const ProxyNode& node : input.proxy.nodes) {
    if (node.child_mask != 0) { continue; }
    met +=
        chance_to_meet(surface(node.bounds), scene) * filled_share(input.proxy.records[node.first]);
  }
  return met;
}

}  // namespace

Result<Prediction> predict_surface_area(const PredictionInput& input) {
  return spread(input, chances_to_meet_bounds(input.tables));
}

Result<Prediction> predict_macdonald_booth(const PredictionInput& input) {
  if (auto fine = check_proxy(input); !fine) { return tl::unexpected(fine.error()); }
  std::vector<double> chances = chances_to_meet_bounds(input.tables);
  const double met = surfaces_met(input);
  if (met > 0.0) { scale(chances, -std::expm1(-met) / met); }
  return spread(input, chances);
}

Result<Prediction> predict_cleary_wyvill(const PredictionInput& input) {
  if (auto fine = check_proxy(input); !fine) { return tl::unexpected(fine.error()); }
  const double scene = surface(union_of_cells(input.proxy));
  std::vector<double> chances;
  for (const Aabb& cell : input.proxy.cells) {
    chances.push_back(chance_to_meet(surface(cell), scene));
  }
  return spread(input, chances);
}

Result<Prediction> predict_subramanian_fussell(const PredictionInput& input) {
  if (auto fine = check_proxy(input); !fine) { return tl::unexpected(fine.error()); }
  const double scene = surface(union_of_cells(input.proxy));
  double cells_crossed = 0.0;  // n
  double cells_hit = 0.0;      // n p
  std::vector<double> chances;
  for (std::size_t voxel = 0; voxel < input.tables.voxels.size(); ++voxel) {
    const double cell = surface(input.proxy.cells[voxel]);
    const double box = std::min(cell, surface(input.tables.voxels[voxel].bounds));
    cells_crossed += chance_to_meet(cell, scene);
    cells_hit += chance_to_meet(box, scene);
    chances.push_back(chance_to_meet(box, scene));
  }
  if (cells_hit > 0.0) {
    const double ends_in_cell = cells_hit / cells_crossed;  // p
    const double visited =
        ends_in_cell < 1.0 ? -std::expm1(cells_crossed * std::log1p(-ends_in_cell)) / ends_in_cell
                           : 1.0;
    scale(chances, std::min(1.0, visited / cells_crossed));
  }
  return spread(input, chances);
}

}  // namespace preheat
