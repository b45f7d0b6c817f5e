#include <fmt/format.h>

#include <algorithm>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <thread>
#include <vector>

#include "cache/counted_render.h"
#include "cache/prediction.h"
#include "master/ablation.h"
#include "master/command_line.h"
#include "master/commands.h"
#include "master/evaluate_page.h"
#include "master/evaluation_record.h"
#include "master/fine_octree.h"
#include "master/knob_sweep.h"
#include "master/prediction_knobs.h"
#include "master/scene_source.h"
#include "master/view.h"

namespace preheat {
namespace {

// What is quick enough to be measured several times is, and the least time counts.
constexpr double kQuickSeconds = 0.2;
constexpr int kQuickRuns = 3;

struct EvaluateOptions {
  SceneOptions scene{};
  ViewOptions view{};
  std::vector<std::string> models{};
  PredictionKnobs knobs{};
  CountingUnit unit{};
  std::optional<unsigned> threads{};
  std::string json{};
  std::string csv{};
  std::string html{};
  bool sweep = false;
  bool ablate = false;
};

// `none` says nothing that could be right or wrong, and `oracle` is what the others are judged by.
std::vector<std::string> models_by_default() {
  std::vector<std::string> models = prediction_models();
  std::erase(models, "none");
  std::erase(models, "oracle");
  return models;
}

CellRays counts_of(std::span<const CellAccesses> accesses) {
  CellRays rays;
  for (const CellAccesses& cell : accesses) {
    rays.camera.push_back(static_cast<double>(cell.camera));
    rays.all.push_back(static_cast<double>(cell.total()));
  }
  return rays;
}

std::string unit_of(const Prediction& prediction) {
  if (prediction.nodes.rays_camera.empty()) { return "voxel"; }
  return name_of(CountingUnit{CountingUnit::Kind::kNode, prediction.nodes.depth});
}

// One evaluation: the scene, its counted rays, and what has been judged by them so far.
class Evaluator {
 public:
  Evaluator(const Store& store, const ResolvedView& view, const EvaluateOptions& options)
      : store_(store), view_(view), options_(options) {
    record_.scene = store.info().source_file;
    record_.camera = view.camera_source;
    record_.width = view.settings.width;
    record_.height = view.settings.height;
    record_.spp = view.settings.spp;
    record_.bounces = view.settings.bounces;
    record_.threads = options.threads.value_or(std::max(1U, std::thread::hardware_concurrency()));
    record_.triangles = store.tables().triangle_count;
    record_.unit = name_of(options.unit);
  }

  Result<EvaluationRecord> run() {
    return find_cells()
        .and_then([&] { return count(); })
        .and_then([&] { return judge_models(); })
        .and_then([&] { return options_.sweep ? sweep() : Result<void>(); })
        .and_then([&] { return options_.ablate ? ablate() : Result<void>(); })
        .map([&] { return std::move(record_); });
  }

 private:
  // Leaves and nodes need the octree, voxels are in the store.
  Result<void> find_cells() {
    if (options_.unit.kind == CountingUnit::Kind::kVoxel) {
      for (const VoxelEntry& voxel : store_.tables().voxels) {
        record_.bytes.push_back(static_cast<double>(voxel.resident_bytes));
      }
      return {};
    }
    fmt::print(stderr, "rebuilding the octree of {}\n", record_.scene);
    Result<FineOctree> octree = FineOctree::rebuild(store_, record_.threads);
    if (!octree) { return tl::unexpected(octree.error()); }
    octree_ = *std::move(octree);
    cells_ = octree_->cells_of(options_.unit);
    return {};
  }

  Result<void> count() {
    RenderSettings one_sample = view_.settings;
    one_sample.spp = 1;
    fmt::print(stderr, "rendering and counting {}\n", record_.scene);
    const auto uncounted =
        render_counted(store_, one_sample, {record_.threads, AccessCounting::kNone});
    if (!uncounted) { return tl::unexpected(uncounted.error()); }
    record_.one_spp_seconds = uncounted->trace_seconds;
    CountedRenderOptions counting{record_.threads};
    if (octree_) { counting.counting_tree = octree_->counting_tree(); }
    const auto counted = render_counted(store_, view_.settings, counting);
    if (!counted) { return tl::unexpected(counted.error()); }
    record_.truth_seconds = counted->build_seconds + counted->trace_seconds;
    record_.rays = counted->rays;
    record_.counted =
        octree_ ? octree_->counted(counted->accesses, cells_) : counts_of(counted->accesses);
    record_.oracle = judge(record_, record_.counted).captured;
    return {};
  }

  // The counts are at hand: rendering them again would tell nothing new.
  [[nodiscard]] Prediction oracle() const {
    Prediction prediction;
    prediction.model = "oracle";
    prediction.seconds = record_.truth_seconds;
    prediction.camera_total = static_cast<double>(record_.rays.camera);
    prediction.scatter_total = static_cast<double>(record_.rays.scatter);
    prediction.shadow_total = static_cast<double>(record_.rays.shadow);
    return prediction;
  }

  struct Judged {
    std::string unit{};  // the model's own
    CellRays estimated{};
    Judgement judgement{};
  };

  [[nodiscard]] CellRays estimated(const Prediction& prediction) const {
    if (prediction.model == "oracle") { return record_.counted; }
    return octree_ ? octree_->estimated(prediction, options_.unit, cells_) : rays_of(prediction);
  }

  [[nodiscard]] Result<Judged> judged(const std::string& model,
                                      const PredictionInput& input) const {
    Result<Prediction> prediction = model == "oracle" ? oracle() : predict(model, input);
    if (!prediction) { return tl::unexpected(prediction.error()); }
    double seconds = prediction->seconds;
    const int runs = model == "oracle" ? 1 : kQuickRuns;
    for (int run = 1; run < runs && seconds < kQuickSeconds; ++run) {
      const Result<Prediction> again = predict(model, input);
      if (!again) { return tl::unexpected(again.error()); }
      seconds = std::min(seconds, again->seconds);
    }
    Judged result;
    result.unit = unit_of(*prediction);
    result.estimated = estimated(*prediction);
    result.judgement = judge(record_, result.estimated);
    result.judgement.rays_expected = prediction->rays_total();
    result.judgement.seconds = seconds;
    return result;
  }

  [[nodiscard]] PredictionInput input(const PredictionKnobs& knobs) const {
    return {store_.tables(), store_.proxy(), view_.settings, record_.threads, &store_, knobs};
  }

  Result<void> judge_models() {
    for (const std::string& model : options_.models) {
      Result<Judged> result = judged(model, input(options_.knobs));
      if (!result) { return tl::unexpected(result.error()); }
      record_.models.push_back({model, describe_knobs(model, options_.knobs),
                                std::move(result->unit), std::move(result->judgement),
                                std::move(result->estimated)});
    }
    return {};
  }

  Result<void> sweep() {
    for (const std::string& model : options_.models) {
      for (const KnobSetting& setting : sweep_of(model)) {
        const std::string knobs = describe_knobs(model, setting.knobs);
        fmt::print(stderr, "trying {} {}\n", model, knobs);
        Result<Judged> result = judged(model, input(setting.knobs));
        if (!result) { return tl::unexpected(result.error()); }
        record_.sweep.push_back(
            {model, knobs, setting.is_default, std::move(result->judgement), false, false, false});
      }
    }
    mark_fronts(record_.sweep);
    return {};
  }

  // Of the models that look at lights and materials at all.
  Result<void> ablate() {
    for (const std::string& model : options_.models) {
      if (model != "paper" && model != "transport") { continue; }
      const auto add = [&](const char* term, const PredictionInput& without) -> Result<void> {
        Result<Judged> result = judged(model, without);
        if (!result) { return tl::unexpected(result.error()); }
        record_.ablation.push_back({model, term, std::move(result->judgement)});
        return {};
      };
      if (auto whole = add("none", input(options_.knobs)); !whole) { return whole; }
      for (const SceneTerm term : terms_of(store_.tables(), view_.settings)) {
        const AblatedScene scene = without(term, store_.tables(), view_.settings);
        if (auto added = add(name_of(term), {scene.tables, store_.proxy(), scene.settings,
                                             record_.threads, &store_, options_.knobs});
            !added) {
          return added;
        }
      }
    }
    return {};
  }

  const Store& store_;
  const ResolvedView& view_;
  const EvaluateOptions& options_;
  std::optional<FineOctree> octree_{};  // unless voxels are counted in
  std::vector<std::uint32_t> cells_{};  // of the octree
  EvaluationRecord record_{};
};

Result<void> run_evaluate(const EvaluateOptions& options) {
  for (const std::string& file : {options.json, options.csv, options.html}) {
    if (auto writable = check_text_output(file); !writable) { return writable; }
  }
  const auto opened = open_scene(options.scene);
  if (!opened) { return tl::unexpected(opened.error()); }
  const Store& store = opened->store;
  const auto view = resolve_view(store.tables(), store.cameras(), options.view);
  if (!view) { return tl::unexpected(view.error()); }
  const auto record = Evaluator(store, *view, options).run();
  if (!record) { return tl::unexpected(record.error()); }

  const bool has_stdout = options.json == "-" || options.csv == "-" || options.html == "-";
  const auto write = [](const std::string& file, const std::string& text) {
    return write_text_output(file, text);
  };
  return write(has_stdout ? "" : "-", make_evaluation_table(*record))
      .and_then([&] { return write(options.json, make_evaluation_json(*record).dump(2) + "\n"); })
      .and_then([&] { return write(options.csv, make_evaluation_csv(*record)); })
      .and_then([&] { return write(options.html, make_evaluation_page(*record)); });
}

}  // namespace

void add_evaluate_command(CLI::App& app, Command& chosen) {
  const auto options = std::make_shared<EvaluateOptions>();
  options->models = models_by_default();
  CLI::App* const command = app.add_subcommand(
      "evaluate", "Render, count the rays in each voxel, and judge predictions by them");
  add_scene_options(*command, options->scene);
  command->add_option("--models", options->models, "Which models, separated by commas")
      ->type_name("MODEL,...")
      ->delimiter(',')
      ->check(CLI::IsMember(prediction_models()))
      ->multi_option_policy(CLI::MultiOptionPolicy::TakeAll)
      ->default_str("all but none and oracle");
  add_view_options(*command, options->view);
  add_parsed_option(*command, "--unit", options->unit, &parse_counting_unit,
                    "What rays are counted in: voxels once each, leaves of the fine octree, or the "
                    "leaves below each node of the octree cut at a depth")
      ->type_name("voxel|leaf|node:D")
      ->default_str("voxel");
  command
      ->add_option("--threads", options->threads,
                   "Threads of renders and predictions alike (default: all cores)")
      ->type_name("N")
      ->check(in_range(1U, kThreadsMax));
  add_prediction_knobs(*command, options->knobs);
  command->add_flag("--sweep", options->sweep,
                    "Try each setting of the models' knobs: seconds against error");
  command->add_flag("--ablate", options->ablate,
                    "Say what each term that the scene has is worth: lights, specular and so on");
  command->add_option("--json", options->json, "Write everything here; - for stdout")
      ->type_name("FILE");
  command->add_option("--csv", options->csv, "Write a line per model and voxel here; - for stdout")
      ->type_name("FILE");
  command->add_option("--html", options->html, "Write a page with charts here; - for stdout")
      ->type_name("FILE");
  command->footer(
      "Example: preheat evaluate demo --spp 4 --models transport,profile --html out.html");
  command->callback([&chosen, options] { chosen = [options] { return run_evaluate(*options); }; });
}

}  // namespace preheat
