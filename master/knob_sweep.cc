#include "master/knob_sweep.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "cache/profile_model.h"

namespace preheat {
namespace {

// What is smaller cannot be told apart from it by a measurement.
constexpr double kSecondsLeast = 1e-6;
constexpr double kErrorLeast = 1e-6;

constexpr PaperOcclusion kOcclusions[] = {PaperOcclusion::kRatio, PaperOcclusion::kAsPrinted,
                                          PaperOcclusion::kArrival};

const char* name_of(PaperOcclusion occlusion) {
  switch (occlusion) {
    case PaperOcclusion::kRatio:
      return "ratio";
    case PaperOcclusion::kAsPrinted:
      return "as-printed";
    case PaperOcclusion::kArrival:
      return "arrival";
  }
  return "";
}

std::vector<PredictionKnobs> paper_settings() {
  std::vector<PredictionKnobs> settings(1);
  const PaperKnobs standard;
  const auto add = [&](auto change) {
    PredictionKnobs knobs;
    change(knobs.paper);
    settings.push_back(knobs);
  };
  for (const unsigned depth : {1U, 2U, 3U}) {
    for (const PaperOcclusion occlusion : kOcclusions) {
      if (depth == standard.depth && occlusion == standard.occlusion) { continue; }
      add([&](PaperKnobs& knobs) {
        knobs.depth = depth;
        knobs.occlusion = occlusion;
      });
    }
  }
  for (const unsigned polar : {3U, 12U, 24U}) {
    add([&](PaperKnobs& knobs) {
      knobs.bins_polar = polar;
      knobs.bins_azimuth = 2 * polar;
    });
  }
  for (const int bounces : {0, 1, 2}) {
    add([&](PaperKnobs& knobs) { knobs.bounces_exchanged = bounces; });
  }
  add([](PaperKnobs& knobs) { knobs.as_printed = true; });
  return settings;
}

std::vector<PredictionKnobs> settings_of(const std::string& model) {
  if (model == "paper") { return paper_settings(); }
  std::vector<PredictionKnobs> settings(1);
  if (model == "transport") {
    for (std::uint32_t paths = 256; paths <= 262144; paths *= 4) {
      settings.emplace_back().transport.paths = paths;
    }
  }
  if (model == "profile") {
    for (std::uint32_t pixels = 256; pixels <= 65536; pixels *= 4) {
      if (pixels != kProfilePixelsDefault) { settings.emplace_back().profile.pixels = pixels; }
    }
  }
  return settings;
}

bool beats(const SpeedAndError& a, const SpeedAndError& b) {
  return a.seconds <= b.seconds && a.error <= b.error &&
         (a.seconds < b.seconds || a.error < b.error);
}

}  // namespace

std::vector<KnobSetting> sweep_of(const std::string& model) {
  std::vector<KnobSetting> sweep;
  for (const PredictionKnobs& knobs : settings_of(model)) {
    sweep.push_back({model, knobs, sweep.empty()});
  }
  return sweep;
}

std::string describe_knobs(const std::string& model, const PredictionKnobs& knobs) {
  const auto count = [](const char* name, std::uint32_t value) {
    return value == 0 ? fmt::format("{}=default", name) : fmt::format("{}={}", name, value);
  };
  if (model == "transport") { return count("paths", knobs.transport.paths); }
  if (model == "profile") { return count("pixels", knobs.profile.pixels); }
  if (model != "paper") { return {}; }
  const PaperKnobs& paper = knobs.paper;
  const std::string bounces =
      paper.bounces_exchanged < 0 ? "all" : fmt::format("{}", paper.bounces_exchanged);
  return fmt::format("depth={} bins={}x{} bounces={} occlusion={}{}", paper.depth, paper.bins_polar,
                     paper.bins_azimuth, bounces, name_of(paper.occlusion),
                     paper.as_printed ? " as-printed" : "");
}

std::vector<bool> pareto_front(std::span<const SpeedAndError> settings) {
  std::vector<bool> is_on_front;
  for (const SpeedAndError& setting : settings) {
    is_on_front.push_back(
        std::none_of(settings.begin(), settings.end(),
                     [&](const SpeedAndError& other) { return beats(other, setting); }));
  }
  return is_on_front;
}

std::optional<std::size_t> knee_of(std::span<const SpeedAndError> settings) {
  if (settings.empty()) { return std::nullopt; }
  const std::vector<bool> is_on_front = pareto_front(settings);
  const auto x = [&](std::size_t i) {
    return std::log(std::max(kSecondsLeast, settings[i].seconds));
  };
  const auto y = [&](std::size_t i) { return std::log(std::max(kErrorLeast, settings[i].error)); };
  std::optional<std::size_t> fastest;
  std::optional<std::size_t> best;
  for (std::size_t i = 0; i < settings.size(); ++i) {
    if (!is_on_front[i]) { continue; }
    if (!fastest || x(i) < x(*fastest)) { fastest = i; }
    if (!best || y(i) < y(*best)) { best = i; }
  }
  const double width = x(*best) - x(*fastest);
  const double height = y(*fastest) - y(*best);
  if (!(width > 0.0) || !(height > 0.0)) { return best; }
  std::size_t knee = *best;
  double depth_most = 0.0;
  for (std::size_t i = 0; i < settings.size(); ++i) {
    if (!is_on_front[i]) { continue; }
    const double along = (x(i) - x(*fastest)) / width;
    const double below = 1.0 - along - (y(i) - y(*best)) / height;
    if (below > depth_most) {
      depth_most = below;
      knee = i;
    }
  }
  return knee;
}

}  // namespace preheat
