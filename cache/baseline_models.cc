#include "cache/baseline_models.h"

#include <cmath>
#include <random>

namespace preheat {
namespace {

// Zero rays in every voxel. Of the frame's rays only the camera's are known without a look at the
// scene.
Prediction empty_prediction(const PredictionInput& input) {
  const std::size_t voxel_count = input.tables.voxels.size();
  Prediction prediction;
  prediction.rays_camera.resize(voxel_count, 0.0);
  prediction.rays_scatter.resize(voxel_count, 0.0);
  prediction.rays_shadow.resize(voxel_count, 0.0);
  prediction.camera_total = sample_count(input.settings);
  return prediction;
}

// The power of two next below the camera rays per resident byte.
double rays_per_byte(const PredictionInput& input, const Prediction& prediction) {
  const auto bytes = static_cast<double>(input.tables.resident_bytes());
  return bytes > 0.0 ? std::ldexp(1.0, std::ilogb(prediction.camera_total / bytes)) : 0.0;
}

}  // namespace

Prediction predict_none(const PredictionInput& input) { return empty_prediction(input); }

Prediction predict_uniform(const PredictionInput& input) {
  Prediction prediction = empty_prediction(input);
  const double ratio = rays_per_byte(input, prediction);
  for (std::size_t voxel = 0; voxel < input.tables.voxels.size(); ++voxel) {
    prediction.rays_camera[voxel] =
        ratio * static_cast<double>(input.tables.voxels[voxel].resident_bytes);
  }
  return prediction;
}

Prediction predict_random(const PredictionInput& input) {
  Prediction prediction = empty_prediction(input);
  const double ratio = 2.0 * rays_per_byte(input, prediction);
  std::mt19937_64 engine(input.settings.seed);
  for (std::size_t voxel = 0; voxel < input.tables.voxels.size(); ++voxel) {
    const double share = static_cast<double>(engine() >> 11U) * 0x1p-53;
    prediction.rays_camera[voxel] =
        ratio * share * static_cast<double>(input.tables.voxels[voxel].resident_bytes);
  }
  return prediction;
}

}  // namespace preheat
