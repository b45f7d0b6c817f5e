#include "cache/prediction.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <utility>

#include "cache/area_models.h"
#include "cache/baseline_models.h"
#include "cache/paper_model.h"
#include "cache/profile_model.h"
#include "cache/transport_model.h"

namespace preheat {
namespace {

struct Model {
  const char* name;
  Result<Prediction> (*predict)(const PredictionInput& input);
};

// A model that cannot fail as one that could.
template <Prediction (*kPredict)(const PredictionInput&)>
Result<Prediction> always(const PredictionInput& input) {
  return kPredict(input);
}

constexpr std::array kModels = {
    Model{"cleary-wyvill", predict_cleary_wyvill},
    Model{"macdonald-booth", predict_macdonald_booth},
    Model{"none", always<predict_none>},
    Model{"oracle", predict_oracle},
    Model{"paper", predict_paper},
    Model{"profile", predict_profile},
    Model{"random", always<predict_random>},
    Model{"subramanian-fussell", predict_subramanian_fussell},
    Model{"surface-area", predict_surface_area},
    Model{"transport", predict_transport},
    Model{"uniform", always<predict_uniform>},
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
