// What profiling predicts: a render of few pixels, counted and scaled up (as Jaros et al., ACM TOG
// 2021, choose what every device holds), and the whole render itself, which no model can beat.
//
// Both read every triangle of the scene and build its BVH first, which a prediction is meant to
// spare; the seconds say so.
#pragma once

#include "cache/prediction.h"

namespace preheat {

// As many pixels as the transport model traces paths in its default.
inline constexpr std::uint32_t kProfilePixelsDefault = 4096;

// The same view in about ProfileKnobs::pixels pixels, never more than the image has, one sample
// each, with the image's proportions; counts times the ratio of the samples. A usage error without
// PredictionInput::store.
[[nodiscard]] Result<Prediction> predict_profile(const PredictionInput& input);

// The counts of the render itself. A usage error without PredictionInput::store.
[[nodiscard]] Result<Prediction> predict_oracle(const PredictionInput& input);

}  // namespace preheat
