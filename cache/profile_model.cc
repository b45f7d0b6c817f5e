#include "cache/profile_model.h"

#include <algorithm>
#include <cmath>

#include "cache/counted_render.h"

namespace preheat {
namespace {

RenderSettings low_resolution(const RenderSettings& settings, std::uint32_t pixels) {
  const auto wanted = static_cast<double>(pixels);
  const double aspect = static_cast<double>(settings.width) / static_cast<double>(settings.height);
  const auto side = [](double length, std::uint32_t most) {
    return static_cast<std::uint32_t>(
        std::clamp(std::round(length), 1.0, static_cast<double>(most)));
  };
  RenderSettings low = settings;
  low.width = side(std::sqrt(wanted * aspect), settings.width);
  low.height = side(wanted / static_cast<double>(low.width), settings.height);
  low.spp = 1;
  return low;
}

Result<Prediction> counts_of(const PredictionInput& input, const RenderSettings& settings) {
  if (input.store == nullptr) {
    return fail(ExitCode::kUsage, "this model renders: it needs the scene's triangles");
  }
  const Result<CountedRender> counted =
      render_counted(*input.store, settings, {std::max(1U, input.threads)});
  if (!counted) { return tl::unexpected(counted.error()); }
  const double scale = sample_count(input.settings) / sample_count(settings);
  Prediction prediction;
  for (const CellAccesses& voxel : counted->accesses) {
    prediction.rays_camera.push_back(static_cast<double>(voxel.camera) * scale);
    prediction.rays_scatter.push_back(static_cast<double>(voxel.scatter) * scale);
    prediction.rays_shadow.push_back(static_cast<double>(voxel.shadow) * scale);
  }
  prediction.camera_total = static_cast<double>(counted->rays.camera) * scale;
  prediction.scatter_total = static_cast<double>(counted->rays.scatter) * scale;
  prediction.shadow_total = static_cast<double>(counted->rays.shadow) * scale;
  return prediction;
}

}  // namespace

Result<Prediction> predict_profile(const PredictionInput& input) {
  const std::uint32_t pixels = input.knobs.profile.pixels;
  return counts_of(input,
                   low_resolution(input.settings, pixels == 0 ? kProfilePixelsDefault : pixels));
}

Result<Prediction> predict_oracle(const PredictionInput& input) {
  return counts_of(input, input.settings);
}

}  // namespace preheat
