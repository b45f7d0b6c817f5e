#include "cache/prediction.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <utility>

#include "cache/baseline_models.h"
#include "cache/paper_model.h"
#include "cache/transport_model.h"

namespace preheat {
namespace {

struct Model {
  const char* name;
  Result<Prediction> (*predict)(const PredictionInput& input);
};

constexpr std::array kModels = {
    Model{"none",
          [](const PredictionInput& input) -> Result<Prediction> { return predict_none(input); }},
    Model{"paper", predict_paper},
    Model{"random",
          [](const PredictionInput& input) -> Result<Prediction> { return predict_random(input); }},
    Model{"transport", predict_transport},
    Model{
        "uniform",
        [](const PredictionInput& input) -> Result<Prediction> { return predict_uniform(input); }},
};

}  // namespace

const std::vector<std::string>& prediction_models() {
  static const std::vector<std::string> names = [] {
    std::vector<std::string> list;
    for (const Model& model : kModels) { list.emplace_back(model.name); }
    return list;
  }();
  return names;
}

Result<Prediction> predict(const std::string& model, const PredictionInput& input) {
  const auto found = std::find_if(kModels.begin(), kModels.end(),
                                  [&](const Model& known) { return known.name == model; });
  if (found == kModels.end()) {
    std::string names;
    for (const std::string& name : prediction_models()) {
      names += (names.empty() ? "" : ", ") + name;
    }
    return fail(ExitCode::kUsage, "no prediction model '" + model + "'; there are " + names);
  }
  const auto begin = std::chrono::steady_clock::now();
  Result<Prediction> prediction = found->predict(input);
  if (prediction) {
    prediction->model = model;
    prediction->seconds =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  }
  return prediction;
}

}  // namespace preheat
