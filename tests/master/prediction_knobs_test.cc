#include "master/prediction_knobs.h"

#include <gtest/gtest.h>

#include <CLI/CLI.hpp>

namespace preheat {
namespace {

PredictionKnobs parsed(const std::string& arguments) {
  PredictionKnobs knobs;
  CLI::App app;
  add_prediction_knobs(app, knobs);
  app.parse(arguments);
  return knobs;
}

TEST(PredictionKnobs, AreTheModelsDefaultsUntilSet) {
  const PredictionKnobs knobs = parsed("");
  EXPECT_EQ(knobs.paper.depth, 2U);
  EXPECT_EQ(knobs.paper.bins_polar, 6U);
  EXPECT_EQ(knobs.paper.bins_azimuth, 12U);
  EXPECT_LT(knobs.paper.bounces_exchanged, 0);
  EXPECT_EQ(knobs.paper.occlusion, PaperOcclusion::kRatio);
  EXPECT_FALSE(knobs.paper.as_printed);
  EXPECT_EQ(knobs.transport.paths, 0U);
  EXPECT_EQ(knobs.profile.pixels, 0U);
}

TEST(PredictionKnobs, AreSetByTheirOptions) {
  const PredictionKnobs knobs = parsed(
      "--paper-depth 4 --paper-bins 10x20 --paper-bounces 0 --paper-occlusion arrival --as-printed "
      "--transport-paths 9000 --profile-pixels 300");
  EXPECT_EQ(knobs.paper.depth, 4U);
  EXPECT_EQ(knobs.paper.bins_polar, 10U);
  EXPECT_EQ(knobs.paper.bins_azimuth, 20U);
  EXPECT_EQ(knobs.paper.bounces_exchanged, 0);
  EXPECT_EQ(knobs.paper.occlusion, PaperOcclusion::kArrival);
  EXPECT_TRUE(knobs.paper.as_printed);
  EXPECT_EQ(knobs.transport.paths, 9000U);
  EXPECT_EQ(knobs.profile.pixels, 300U);
  EXPECT_EQ(parsed("--paper-depth 4 --paper-depth 1").paper.depth, 1U);
  EXPECT_EQ(parsed("--paper-occlusion printed").paper.occlusion, PaperOcclusion::kAsPrinted);
}

TEST(PredictionKnobs, RefuseWhatIsOutOfRange) {
  for (const char* arguments :
       {"--paper-depth 6", "--paper-depth -1", "--paper-bins 6", "--paper-bins 0x12",
        "--paper-bins 6x0", "--paper-bins 65x12", "--paper-bins 6x129", "--paper-bins 6x12x1",
        "--paper-bounces -1", "--paper-bounces 65", "--paper-occlusion none", "--transport-paths 0",
        "--profile-pixels 0"}) {
    EXPECT_THROW(parsed(arguments), CLI::ParseError) << arguments;
  }
}

TEST(ParseBinCounts, NamesTheLimitAndTheText) {
  const auto bins = parse_bin_counts("7x900");
  ASSERT_FALSE(bins);
  EXPECT_EQ(bins.error().code, ExitCode::kUsage);
  EXPECT_NE(bins.error().message.find("'7x900'"), std::string::npos);
  EXPECT_NE(bins.error().message.find("64x128"), std::string::npos);
}

}  // namespace
}  // namespace preheat
