// Expected transport through the proxy.
//
// A few thousand light paths, spread evenly over the image, the lights and all directions, are
// traced with the renderer's own shading against the proxy's leaves instead of triangles; each ray
// credits the voxels that it is expected to enter, and the sums are scaled to the whole image. So
// every rule of the renderer, which light a vertex samples, when Russian roulette ends a path,
// which rays exist at all, is the same code. Time is linear in the paths and logarithmic in the
// scene; no triangle is touched.
#pragma once

#include <cstdint>

#include "cache/prediction.h"

namespace preheat {

inline constexpr std::uint32_t kTransportPathsMax = 1U << 26U;

// TransportKnobs::paths is rounded up to a multiple of 32. An error where it exceeds
// kTransportPathsMax, or where the proxy does not belong to the tables. Same result on any number
// of threads.
[[nodiscard]] Result<Prediction> predict_transport(const PredictionInput& input);

}  // namespace preheat
