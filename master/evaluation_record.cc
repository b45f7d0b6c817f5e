#include "master/evaluation_record.h"

#include <fmt/format.h>

#include <algorithm>

#include "common/compensated_sum.h"
#include "master/knob_sweep.h"

namespace preheat {
namespace {

using Json = nlohmann::ordered_json;

Json json_of(const std::optional<double>& value) { return value ? Json(*value) : Json(nullptr); }

std::string text_of(const std::optional<double>& value, int digits) {
  return value ? fmt::format("{:.{}g}", *value, digits) : std::string("-");
}

Json fit_json(const Evaluation& fit) {
  return {{"alpha", json_of(fit.alpha)},
          {"beta", json_of(fit.beta)},
          {"sigma", json_of(fit.sigma)},
          {"sigma_over_mean", json_of(fit.sigma_over_mean)},
          {"slope_variance", json_of(fit.slope_variance)},
          {"r2", json_of(fit.r2)},
          {"pearson", json_of(fit.pearson)},
          {"spearman", json_of(fit.spearman)},
          {"total_ratio", json_of(fit.total_ratio)}};
}

Json capture_json(const std::optional<Captured>& captured) {
  if (!captured) { return nullptr; }
  Json json;
  for (std::size_t i = 0; i < kCaptureShares.size(); ++i) {
    json[fmt::format("{}", kCaptureShares[i])] = captured->shares[i];
  }
  return json;
}

Json model_json(const ModelResult& model) {
  Json json = {{"name", model.name},
               {"knobs", model.knobs},
               {"unit", model.unit},
               {"seconds", model.judgement.seconds}};
  json.update(fit_json(model.judgement.all));
  json["capture"] = capture_json(model.judgement.captured);
  json["rays_expected"] = model.judgement.rays_expected;
  json["primary"] = fit_json(model.judgement.camera);
  return json;
}

Json sweep_json(const std::vector<SweepResult>& sweep) {
  Json json = Json::array();
  for (const SweepResult& setting : sweep) {
    Json entry = {{"name", setting.model},
                  {"knobs", setting.knobs},
                  {"default", setting.is_default},
                  {"seconds", setting.judgement.seconds}};
    entry.update(fit_json(setting.judgement.all));
    entry["capture"] = capture_json(setting.judgement.captured);
    entry["front"] = setting.is_on_front;
    entry["front_of_model"] = setting.is_on_front_of_own;
    entry["knee_of_model"] = setting.is_knee;
    json.push_back(entry);
  }
  return json;
}

Json ablation_json(const std::vector<AblationResult>& ablation) {
  Json json = Json::array();
  for (const AblationResult& result : ablation) {
    Json entry = {
        {"name", result.model}, {"without", result.term}, {"seconds", result.judgement.seconds}};
    entry.update(fit_json(result.judgement.all));
    entry["capture"] = capture_json(result.judgement.captured);
    json.push_back(entry);
  }
  return json;
}

std::string percent(const std::optional<Captured>& captured, std::size_t share) {
  return captured ? fmt::format("{:.2f}", 100.0 * captured->shares[share]) : std::string("-");
}

std::string judgement_row(const Judgement& judgement) {
  const Evaluation& fit = judgement.all;
  return fmt::format(
      "{:>9.4f} {:>10} {:>7} {:>8} {:>7} {:>7} {:>7} {:>7} {:>6} {:>6} {:>6} {:>6}\n",
      judgement.seconds, text_of(fit.alpha, 4), text_of(fit.beta, 3),
      text_of(fit.sigma_over_mean, 3), text_of(fit.r2, 4), text_of(fit.pearson, 4),
      text_of(fit.spearman, 4), text_of(fit.total_ratio, 4), percent(judgement.captured, 0),
      percent(judgement.captured, 1), percent(judgement.captured, 2),
      percent(judgement.captured, 3));
}

std::string heading(const char* first, int width) {
  return fmt::format(
      "\n{:<{}} {:>9} {:>10} {:>7} {:>8} {:>7} {:>7} {:>7} {:>7} {:>6} {:>6} {:>6} {:>6}\n", first,
      width, "seconds", "alpha", "beta", "sigma/r", "R2", "Pearson", "Spearm.", "total", "1 %",
      "10 %", "25 %", "50 %");
}

std::string sweep_table(const std::vector<SweepResult>& sweep) {
  constexpr int kWidth = 64;
  std::string table = heading("setting (* default, f front, k knee)", kWidth);
  for (const SweepResult& setting : sweep) {
    const std::string name =
        fmt::format("{}{}{} {} {}", setting.is_default ? '*' : ' ', setting.is_on_front ? 'f' : ' ',
                    setting.is_knee ? 'k' : ' ', setting.model, setting.knobs);
    table += fmt::format("{:<{}} {}", name, kWidth, judgement_row(setting.judgement));
  }
  for (const SweepResult& setting : sweep) {
    if (!setting.is_knee) { continue; }
    table += fmt::format("the knee of {} is {}, which is {}its default\n", setting.model,
                         setting.knobs.empty() ? "its only setting" : setting.knobs,
                         setting.is_default ? "" : "not ");
  }
  return table;
}

std::string ablation_table(const std::vector<AblationResult>& ablation) {
  constexpr int kWidth = 40;
  std::string table = heading("model without", kWidth);
  for (const AblationResult& result : ablation) {
    table += fmt::format("{:<{}} {}", result.model + " without " + result.term, kWidth,
                         judgement_row(result.judgement));
  }
  return table;
}

double sum_of(const std::vector<double>& values) {
  CompensatedSum sum;
  for (const double value : values) { sum.add(value); }
  return sum.value();
}

}  // namespace

double unexplained(const Evaluation& evaluation) {
  return evaluation.pearson ? 1.0 - *evaluation.pearson * *evaluation.pearson : 1.0;
}

CellRays rays_of(const Prediction& prediction) {
  CellRays rays;
  rays.camera = prediction.rays_camera;
  for (std::size_t voxel = 0; voxel < prediction.rays_camera.size(); ++voxel) {
    rays.all.push_back(prediction.rays(voxel));
  }
  return rays;
}

Judgement judge(const EvaluationRecord& record, const CellRays& estimated) {
  Judgement judgement;
  judgement.camera = evaluate(estimated.camera, record.counted.camera);
  judgement.all = evaluate(estimated.all, record.counted.all);
  if (!record.bytes.empty()) {
    Captured captured;
    const std::vector<std::size_t> order = hottest_first(estimated.all, record.bytes);
    for (std::size_t i = 0; i < kCaptureShares.size(); ++i) {
      captured.shares[i] = capture(order, record.counted.all, record.bytes, kCaptureShares[i]);
    }
    captured.curve = capture_curve(order, record.counted.all, record.bytes);
    judgement.captured = captured;
  }
  return judgement;
}

void mark_fronts(std::vector<SweepResult>& sweep) {
  const auto cost_of = [](const SweepResult& setting) {
    return SpeedAndError{setting.judgement.seconds, unexplained(setting.judgement.all)};
  };
  std::vector<SpeedAndError> costs;
  for (const SweepResult& setting : sweep) { costs.push_back(cost_of(setting)); }
  const std::vector<bool> front = pareto_front(costs);
  for (std::size_t begin = 0; begin < sweep.size();) {
    std::size_t end = begin;
    while (end < sweep.size() && sweep[end].model == sweep[begin].model) { ++end; }
    const auto own = std::span(costs).subspan(begin, end - begin);
    const std::vector<bool> own_front = pareto_front(own);
    const std::size_t knee = knee_of(own).value_or(0);
    for (std::size_t i = begin; i < end; ++i) {
      sweep[i].is_on_front = front[i];
      sweep[i].is_on_front_of_own = own_front[i - begin];
      sweep[i].is_knee = i - begin == knee;
    }
    begin = end;
  }
}

nlohmann::ordered_json make_evaluation_json(const EvaluationRecord& record) {
  Json json = {{"scene", record.scene},
               {"camera", record.camera},
               {"image",
                {{"width", record.width},
                 {"height", record.height},
                 {"spp", record.spp},
                 {"bounces", record.bounces}}},
               {"threads", record.threads},
               {"triangles", record.triangles},
               {"unit", record.unit},
               {"voxels", record.counted.all.size()},
               {"rays_counted", record.rays.total()},
               {"rays",
                {{"camera", record.rays.camera},
                 {"scatter", record.rays.scatter},
                 {"shadow", record.rays.shadow}}},
               {"accesses_counted", sum_of(record.counted.all)},
               {"one_spp_seconds", record.one_spp_seconds}};
  json["models"] = Json::array();
  Json profile = nullptr;
  for (const ModelResult& model : record.models) {
    json["models"].push_back(model_json(model));
    if (model.name == "profile") { profile = json["models"].back(); }
  }
  json["oracle"] = {{"capture", capture_json(record.oracle)}, {"seconds", record.truth_seconds}};
  json["profile"] = profile;
  if (!record.sweep.empty()) { json["sweep"] = sweep_json(record.sweep); }
  if (!record.ablation.empty()) { json["ablation"] = ablation_json(record.ablation); }
  return json;
}

std::string make_evaluation_csv(const EvaluationRecord& record) {
  std::string csv = "model,voxel,primary_estimated,primary_rendered,all_estimated,all_rendered\n";
  for (const ModelResult& model : record.models) {
    for (std::size_t cell = 0; cell < record.counted.all.size(); ++cell) {
      csv += fmt::format("{},{},{},{},{},{}\n", model.name, cell, model.estimated.camera[cell],
                         record.counted.camera[cell], model.estimated.all[cell],
                         record.counted.all[cell]);
    }
  }
  return csv;
}

std::string make_evaluation_table(const EvaluationRecord& record) {
  std::string table = fmt::format(
      "scene            {} ({} triangles), {}\n"
      "image            {}x{}, {} samples, {} bounces, {} thread(s)\n"
      "unit             {}, {} of them, entered {:.6g} times\n"
      "rays counted     {} = camera {} + scatter {} + shadow {}\n"
      "seconds          {:.3f} to render and count, {:.3f} to trace one sample a pixel\n",
      record.scene, record.triangles, record.camera, record.width, record.height, record.spp,
      record.bounces, record.threads, record.unit, record.counted.all.size(),
      sum_of(record.counted.all), record.rays.total(), record.rays.camera, record.rays.scatter,
      record.rays.shadow, record.truth_seconds, record.one_spp_seconds);
  constexpr int kWidth = 20;
  table += heading("all rays", kWidth);
  for (const ModelResult& model : record.models) {
    table += fmt::format("{:<{}} {}", model.name, kWidth, judgement_row(model.judgement));
  }
  if (record.oracle) {
    table += fmt::format("{:<{}} {:>9.4f} {:>68} {:>6} {:>6} {:>6}\n", "best possible", kWidth,
                         record.truth_seconds, percent(record.oracle, 0), percent(record.oracle, 1),
                         percent(record.oracle, 2), percent(record.oracle, 3));
  }
  table += fmt::format("\n{:<{}} {:>10} {:>7} {:>8} {:>7} {:>7} {:>7}\n", "primary rays", kWidth,
                       "alpha", "beta", "sigma/r", "R2", "Pearson", "total");
  for (const ModelResult& model : record.models) {
    const Evaluation& fit = model.judgement.camera;
    table +=
        fmt::format("{:<{}} {:>10} {:>7} {:>8} {:>7} {:>7} {:>7}\n", model.name, kWidth,
                    text_of(fit.alpha, 4), text_of(fit.beta, 3), text_of(fit.sigma_over_mean, 3),
                    text_of(fit.r2, 4), text_of(fit.pearson, 4), text_of(fit.total_ratio, 4));
  }
  if (!record.sweep.empty()) { table += sweep_table(record.sweep); }
  if (!record.ablation.empty()) { table += ablation_table(record.ablation); }
  return table;
}

}  // namespace preheat
