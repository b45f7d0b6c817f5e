#include "master/prediction_knobs.h"

#include <fmt/format.h>

#include <charconv>
#include <optional>
#include <string_view>

#include "cache/direction_bins.h"
#include "common/limits.h"
#include "common/octree_summary.h"
#include "master/command_line.h"

namespace preheat {
namespace {

constexpr std::uint32_t kTransportPathsMax = 1U << 28U;

std::optional<unsigned> count_within(std::string_view text, unsigned most) {
  unsigned value = 0;
  const char* const end = text.data() + text.size();
  const auto [rest, error] = std::from_chars(text.data(), end, value);
  if (error != std::errc{} || rest != end || value < 1 || value > most) { return std::nullopt; }
  return value;
}

}  // namespace

Result<BinCounts> parse_bin_counts(const std::string& text) {
  const auto sides = std::string_view(text);
  const std::size_t cross = sides.find('x');
  if (cross != std::string_view::npos) {
    const auto polar = count_within(sides.substr(0, cross), kBinsPolarMax);
    const auto azimuth = count_within(sides.substr(cross + 1), kBinsAzimuthMax);
    if (polar && azimuth) { return BinCounts{*polar, *azimuth}; }
  }
  return fail(ExitCode::kUsage,
              fmt::format("'{}' is not polar x azimuth bins such as 6x12, within 1x1..{}x{}", text,
                          kBinsPolarMax, kBinsAzimuthMax));
}

Result<PaperOcclusion> parse_paper_occlusion(const std::string& text) {
  if (text == "ratio") { return PaperOcclusion::kRatio; }
  if (text == "printed") { return PaperOcclusion::kAsPrinted; }
  if (text == "arrival") { return PaperOcclusion::kArrival; }
  return fail(ExitCode::kUsage, fmt::format("'{}' is not ratio, printed or arrival", text));
}

void add_prediction_knobs(CLI::App& app, PredictionKnobs& knobs) {
  constexpr const char* kGroup = "Knobs of the models";
  app.option_defaults()->multi_option_policy(CLI::MultiOptionPolicy::TakeLast);
  PaperKnobs& paper = knobs.paper;
  app.add_option("--paper-depth", paper.depth,
                 "paper: depth at which the octree is cut; what lies below is one cell, at most "
                 "8^N of them")
      ->type_name("N")
      ->check(in_range(0U, unsigned{kSummaryDepthMax}))
      ->capture_default_str()
      ->group(kGroup);
  const auto set_bins = [&paper](const std::string& text) {
    const Result<BinCounts> bins = parse_bin_counts(text);
    if (!bins) { throw CLI::ValidationError("--paper-bins", bins.error().message); }
    paper.bins_polar = bins->polar;
    paper.bins_azimuth = bins->azimuth;
  };
  app.add_option_function<std::string>("--paper-bins", set_bins,
                                       "paper: directions that a cell tells apart, polar x azimuth")
      ->type_name("PxA")
      ->default_str(fmt::format("{}x{}", paper.bins_polar, paper.bins_azimuth))
      ->group(kGroup);
  app.add_option("--paper-bounces", paper.bounces_exchanged,
                 "paper: times that cells exchange rays; 0 counts camera rays alone (default: "
                 "--bounces)")
      ->type_name("N")
      ->check(in_range(0, static_cast<int>(kBouncesMax)))
      ->group(kGroup);
  add_parsed_option(app, "--paper-occlusion", paper.occlusion, &parse_paper_occlusion,
                    "paper: rays that do not arrive; ratio: all are scaled by sent/received; "
                    "printed: by d p (1-p)^(d-1) of each pair; arrival: by (1-p)^(d-1)")
      ->type_name("WAY")
      ->default_str("ratio")
      ->group(kGroup);
  app.add_flag("--as-printed", paper.as_printed,
               "paper: a cell across the view plane counts as wholly visible, the fault that the "
               "paper's figure 7 shows")
      ->group(kGroup);
  app.add_option("--transport-paths", knobs.transport.paths,
                 "transport: light paths through the proxy (default: the model's choice)")
      ->type_name("N")
      ->check(in_range(1U, kTransportPathsMax))
      ->group(kGroup);
  app.add_option("--profile-pixels", knobs.profile.pixels,
                 "profile: pixels of the small render, one sample each (default: the model's "
                 "choice)")
      ->type_name("N")
      ->check(in_range(1U, static_cast<std::uint32_t>(kImagePixelsMax)))
      ->group(kGroup);
}

}  // namespace preheat
