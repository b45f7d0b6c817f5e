// What the transport model is judged against: predictions that look at no geometry.
#pragma once

#include "cache/prediction.h"

namespace preheat {

// Zero rays everywhere: nothing is worth preloading.
[[nodiscard]] Prediction predict_none(const PredictionInput& input);

// As many rays per byte in every voxel: preloading takes voxels by their ids. The exact ratio is
// a power of two, so that no rounding makes one voxel hotter than another.
[[nodiscard]] Prediction predict_uniform(const PredictionInput& input);

// Rays per byte drawn evenly from [0,1) by RenderSettings::seed, so that every order of voxels is
// equally likely, whatever their sizes.
[[nodiscard]] Prediction predict_random(const PredictionInput& input);

}  // namespace preheat
