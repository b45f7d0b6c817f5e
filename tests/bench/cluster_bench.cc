// Whole renders, measured as a user would start them: `./dev bench` runs this program, which writes
// its rows as JSON and its curves as a page. One letter names each section, see --help.
#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <filesystem>
#include <fstream>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "master/file_output.h"
#include "tests/bench/cluster_page.h"
#include "tests/bench/cluster_sections.h"
#include "tests/scenes/scratch_folder.h"

namespace preheat {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

using Measure = BenchRows (*)(const BenchSettings&);

const std::vector<std::pair<std::string, Measure>>& sections() {
  static const std::vector<std::pair<std::string, Measure>> all{
      {"a", &measure_tracing},    {"b", &measure_distribution},   {"c", &measure_cache_curve},
      {"d", &measure_wire_bytes}, {"e", &measure_hits_over_time}, {"f", &measure_limited_links},
      {"h", &measure_error},      {"i", &measure_scaling}};
  return all;
}

std::string processor_name() {
  std::ifstream stream("/proc/cpuinfo");
  for (std::string line; std::getline(stream, line);) {
    if (line.rfind("model name", 0) == 0) { return line.substr(line.find(':') + 2); }
  }
  return "unknown processor";
}

// NAME=SCENE or NAME=SCENE#CAMERA
BenchView parse_view(const std::string& text) {
  const std::size_t equals = text.find('=');
  if (equals == std::string::npos) { return {text, text, ""}; }
  const std::size_t hash = text.find('#', equals);
  BenchView view{text.substr(0, equals), text.substr(equals + 1, hash - equals - 1), ""};
  if (hash != std::string::npos) { view.camera = text.substr(hash + 1); }
  return view;
}

struct Output {
  std::string json = "out/bench.json";
  std::string html = "out/bench.html";
};

// After every section, so that what was measured outlives an end by hand.
Result<void> write_outputs(const ordered_json& measured, const Output& output) {
  if (auto written = write_output(output.json, measured.dump(2) + "\n"); !written) {
    return written;
  }
  return write_output(output.html, make_bench_page(measured));
}

int run(const BenchSettings& settings, const std::vector<std::string>& chosen,
        const Output& output) {
  ordered_json measured{
      {"version", PREHEAT_VERSION},
      {"machine",
       {{"processor", processor_name()}, {"cores", std::thread::hardware_concurrency()}}},
      {"size", settings.size},
      {"sections", ordered_json::object()}};
  int failures = 0;
  for (const auto& [letter, measure] : sections()) {
    if (std::find(chosen.begin(), chosen.end(), letter) == chosen.end()) { continue; }
    const BenchRows rows = measure(settings);
    if (!rows) {
      spdlog::error("({}) {}", letter, rows.error().message);
      ++failures;
      continue;
    }
    measured["sections"][letter] = *rows;
    if (const Result<void> written = write_outputs(measured, output); !written) {
      spdlog::error("{}", written.error().message);
      return static_cast<int>(written.error().code);
    }
  }
  return failures == 0 ? 0 : 1;
}

int main_of(int argument_count, char** arguments) {
  CLI::App app(
      "Measures whole renders: a master, its workers, their caches.\n"
      "(a) tracing beside Embree alone  (b) two workers beside --local  (c) the size of the "
      "cache  (d) bytes over the network  (e) hit rate over time  (f) links held to a rate  (h) "
      "error against time  "
      "(i) many triangles");
  BenchSettings settings;
  settings.folder = fs::read_symlink("/proc/self/exe").parent_path().string();
  std::vector<std::string> chosen;
  for (const auto& [letter, measure] : sections()) { chosen.push_back(letter); }
  std::vector<std::string> views{"demo"};
  Output output;
  app.add_option("sections", chosen, "Which to run, in one word each: a b c ... (all)");
  app.add_option("--view", views, "NAME=SCENE#CAMERA, any number of them")->capture_default_str();
  app.add_option("--size", settings.size, "Of the images")->capture_default_str();
  app.add_option("--spp", settings.spp, "Samples per pixel of (c); others take the last")
      ->capture_default_str();
  app.add_option("--cache", settings.cache_percents, "Sizes of (c), in % of the scene")
      ->capture_default_str();
  app.add_option("--preload", settings.preloads, "Models of (c)")->capture_default_str();
  app.add_option("--repeats", settings.repeats, "Of (a) and (b), whose median counts")
      ->check(CLI::Range(1U, 1000U))
      ->capture_default_str();
  app.add_option("--triangles-max", settings.triangles_max, "Of (i)")->capture_default_str();
  app.add_option("--json", output.json)->capture_default_str();
  app.add_option("--html", output.html)->capture_default_str();
  CLI11_PARSE(app, argument_count, arguments);
  for (const std::string& letter : chosen) {
    const auto is_it = [&](const auto& section) { return section.first == letter; };
    if (std::none_of(sections().begin(), sections().end(), is_it)) {
      spdlog::error("no section '{}': there are a, b, c, d, e, f, h and i", letter);
      return 2;
    }
  }
  for (const std::string& view : views) { settings.views.push_back(parse_view(view)); }
  const test::ScratchFolder scratch;
  settings.scratch = scratch.path().string();
  return run(settings, chosen, output);
}

}  // namespace
}  // namespace preheat

int main(int argument_count, char** arguments) {
  return preheat::main_of(argument_count, arguments);
}
