// Expected rays per voxel, before a ray is traced. One file per model behind one function type.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "common/proxy.h"
#include "common/render_settings.h"
#include "common/result.h"
#include "common/scene_tables.h"
#include "common/store.h"

namespace preheat {

// What several voxels' worth of a truncated octree would see: [P] section 7 stops at a depth, and
// counts leaf traversals where the rest of preheat counts rays per voxel.
struct NodePrediction {
  unsigned depth = 0;                 // where the octree was cut
  std::vector<double> rays_camera{};  // [nodes of the cut], in the order of the octree summary
  std::vector<double> rays_scatter{};
  std::vector<double> rays_shadow{};
};

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
  // Standard errors of a model that samples, from independent parts of its samples; what the model
  // gets wrong however many it takes is not in them. 0 and empty where a model does not sample.
  double rays_total_error = 0.0;     // of rays_total()
  std::vector<double> rays_error{};  // [voxel_count] of rays()
  double seconds = 0.0;
  NodePrediction nodes{};  // of the model `paper`; empty for the others

  [[nodiscard]] double rays(std::size_t voxel) const {
    return rays_camera[voxel] + rays_scatter[voxel] + rays_shadow[voxel];
  }
  [[nodiscard]] double rays_total() const { return camera_total + scatter_total + shadow_total; }
};

// How [P] section 6 accounts for rays that do not arrive.
enum class PaperOcclusion : std::uint8_t {
  kRatio,      // all received rays are scaled by sent / received (n/m): what the paper implements
  kAsPrinted,  // d p (1-p)^(d-1), the paper's untested alternative
  kArrival,    // (1-p)^(d-1), which is what a probability of arriving must be
};

struct PaperKnobs {
  unsigned depth = 2;       // of the truncated octree
  unsigned bins_polar = 6;  // of the array of outgoing directions
  unsigned bins_azimuth = 12;
  int bounces_exchanged = -1;  // rounds of section 5; negative = the render's bounces
  PaperOcclusion occlusion = PaperOcclusion::kRatio;
  bool as_printed = false;  // a voxel across the view plane counts as wholly visible (figure 7)
};

struct TransportKnobs {
  std::uint32_t paths = 0;  // of light, all over the image; 0 = the default
};

struct ProfileKnobs {
  std::uint32_t pixels = 0;  // rendered with one sample each; 0 = the default
};

// Each model reads its own.
struct PredictionKnobs {
  PaperKnobs paper{};
  TransportKnobs transport{};
  ProfileKnobs profile{};
};

struct PredictionInput {
  const SceneTables& tables;
  const Proxy& proxy;
  const RenderSettings& settings;
  unsigned threads = 1;
  const Store* store = nullptr;  // for the models that read triangles; never of `transport`
  PredictionKnobs knobs{};
};

// Unknown names are a usage error that lists the known. `none` predicts zero for every voxel, so
// that nothing is preloaded.
[[nodiscard]] Result<Prediction> predict(const std::string& model, const PredictionInput& input);

[[nodiscard]] const std::vector<std::string>& prediction_models();

}  // namespace preheat
