// Expected rays per voxel, before a ray is traced. One file per model behind one function type.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "common/proxy.h"
#include "common/render_settings.h"
#include "common/result.h"
#include "common/scene_tables.h"

namespace preheat {

// What a render would count: rays that enter each voxel's bounds before their nearest hit.
struct Prediction {
  std::string model{};
  std::vector<double> rays_camera{};   // [voxel_count]
  std::vector<double> rays_scatter{};  // [voxel_count]
  std::vector<double> rays_shadow{};   // [voxel_count]
  // Rays that the frame traces, of each type, whichever voxels they cross.
  double camera_total = 0.0;
  double scatter_total = 0.0;
  double shadow_total = 0.0;
  double seconds = 0.0;

  [[nodiscard]] double rays(std::size_t voxel) const {
    return rays_camera[voxel] + rays_scatter[voxel] + rays_shadow[voxel];
  }
  [[nodiscard]] double rays_total() const { return camera_total + scatter_total + shadow_total; }
};

struct PredictionInput {
  const SceneTables& tables;
  const Proxy& proxy;
  const RenderSettings& settings;
  unsigned threads = 1;
};

// Model names: none, random, uniform, transport. Unknown names are a usage error that lists them.
// `none` predicts zero for every voxel, so that nothing is preloaded.
[[nodiscard]] Result<Prediction> predict(const std::string& model, const PredictionInput& input);

[[nodiscard]] const std::vector<std::string>& prediction_models();

}  // namespace preheat
