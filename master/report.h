// What a render cost, as JSON and as a table. The keys are a contract: tools read them.
#pragma once

#include <nlohmann/json.hpp>
#include <string>

#include "cache/prediction.h"
#include "common/store.h"
#include "master/master.h"
#include "master/view.h"

namespace preheat {

// Disjoint, so that their sum is the total.
struct PhaseSeconds {
  double compile = 0.0;
  double predict = 0.0;
  double preload = 0.0;
  double render = 0.0;
  [[nodiscard]] double total() const { return compile + predict + preload + render; }
};

// Everything that is known when a render has ended. The pointers are never null.
struct RenderRecord {
  const Store* store;
  const ResolvedView* view;
  const Prediction* prediction;
  const MasterResult* result;
  PhaseSeconds seconds{};
  std::string pixels_sha256{};
  // Settings that are not the view's, in the order of the report: {"cache", "25%"}.
  nlohmann::ordered_json settings{};
};

[[nodiscard]] nlohmann::ordered_json make_report(const RenderRecord& record);

// A few lines for a person, ending with a newline.
[[nodiscard]] std::string make_summary(const RenderRecord& record);

}  // namespace preheat
