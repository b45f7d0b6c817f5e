// Which knob settings of the models are tried, and which of them are worth their time.
#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "cache/prediction.h"

namespace preheat {

struct KnobSetting {
  std::string model{};
  PredictionKnobs knobs{};
  bool is_default = false;
};

// The settings of one model, its default first: each knob over its useful range with the others at
// their defaults, and the paper's depth with each way of occlusion. A model without knobs has one.
[[nodiscard]] std::vector<KnobSetting> sweep_of(const std::string& model);

// "depth=2 bins=6x12 bounces=all occlusion=ratio", "paths=default"; empty for a model without
// knobs.
[[nodiscard]] std::string describe_knobs(const std::string& model, const PredictionKnobs& knobs);

// Both are costs: less is better.
struct SpeedAndError {
  double seconds = 0.0;
  double error = 0.0;
};

// True for the settings that no other one equals or beats in both while beating it in one.
[[nodiscard]] std::vector<bool> pareto_front(std::span<const SpeedAndError> settings);

// The setting where a front turns: with both axes logarithmic and scaled to the front's extent, the
// one farthest below the line from the fastest to the most accurate. Where none lies below it the
// front has no bend, and the most accurate is the knee. Absent without settings.
[[nodiscard]] std::optional<std::size_t> knee_of(std::span<const SpeedAndError> settings);

}  // namespace preheat
