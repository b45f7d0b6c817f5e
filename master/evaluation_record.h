// What `preheat evaluate` found: models against counted rays, as values and as text for machines.
#pragma once

#include <array>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "cache/evaluation.h"
#include "cache/prediction.h"
#include "common/stats.h"

namespace preheat {

// The shares of the scene's bytes that capture is given for.
inline constexpr std::array<double, 4> kCaptureShares{0.01, 0.1, 0.25, 0.5};
inline constexpr std::size_t kQuarter = 2;  // the one that a single number is given for

// Counted or estimated rays in each cell: a voxel, leaf or node, by the unit.
struct CellRays {
  std::vector<double> camera{};  // [cell_count]
  std::vector<double> all{};     // [cell_count]
};

struct Captured {
  std::array<double, kCaptureShares.size()> shares{};
  std::vector<CapturePoint> curve{};
};

// How one prediction fares.
struct Judgement {
  Evaluation camera{};
  Evaluation all{};
  std::optional<Captured> captured{};  // absent where cells have no bytes: leaves and nodes
  double rays_expected = 0.0;          // of the frame, whichever cells they cross
  double seconds = 0.0;
};

struct ModelResult {
  std::string name{};
  std::string knobs{};
  // What the model itself estimates: "voxel" or "node:D". Where that is not the record's unit its
  // estimates were spread by surfaces.
  std::string unit{};
  Judgement judgement{};
  CellRays estimated{};
};

struct SweepResult {
  std::string model{};
  std::string knobs{};
  bool is_default = false;
  Judgement judgement{};
  bool is_on_front = false;         // of all settings of all models, in seconds and error
  bool is_on_front_of_own = false;  // of the model's own settings
  bool is_knee = false;             // of the model's own front
};

// A model that was handed the scene without one of its terms, against the rays of the whole scene.
struct AblationResult {
  std::string model{};
  std::string term{};  // "none" for the scene as it is
  Judgement judgement{};
};

struct EvaluationRecord {
  std::string scene{};
  std::string camera{};
  std::uint32_t width = 0;
  std::uint32_t height = 0;
  std::uint32_t spp = 0;
  std::uint32_t bounces = 0;
  unsigned threads = 1;
  std::uint64_t triangles = 0;
  std::string unit = "voxel";
  RayStats rays{};
  double truth_seconds = 0.0;    // building, tracing and counting
  double one_spp_seconds = 0.0;  // tracing one sample of every pixel, uncounted
  CellRays counted{};
  std::vector<double> bytes{};  // [cell_count] resident; empty for leaves and nodes
  std::optional<Captured> oracle{};
  std::vector<ModelResult> models{};
  std::vector<SweepResult> sweep{};
  std::vector<AblationResult> ablation{};
};

// The error that fronts and knees are made of: the variance that the fit leaves unexplained.
// 1 where there is no correlation.
[[nodiscard]] double unexplained(const Evaluation& evaluation);

[[nodiscard]] CellRays rays_of(const Prediction& prediction);

// Judges an estimate by the record's counts. Requires: as many cells.
[[nodiscard]] Judgement judge(const EvaluationRecord& record, const CellRays& estimated);

// Marks fronts and knees, once all settings are there.
void mark_fronts(std::vector<SweepResult>& sweep);

// "--json". Tools read the keys: they stay.
[[nodiscard]] nlohmann::ordered_json make_evaluation_json(const EvaluationRecord& record);

// "--csv": the columns of [P] Table 4, for each model.
[[nodiscard]] std::string make_evaluation_csv(const EvaluationRecord& record);

// For a person, ending with a newline.
[[nodiscard]] std::string make_evaluation_table(const EvaluationRecord& record);

}  // namespace preheat
