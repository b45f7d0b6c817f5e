#include "master/knob_sweep.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <set>

namespace preheat {
namespace {

using Costs = std::vector<SpeedAndError>;

TEST(ParetoFront, KeepsWhatNothingBeatsInBoth) {
  const Costs costs{{1.0, 9.0}, {2.0, 5.0}, {3.0, 6.0}, {4.0, 5.0}, {5.0, 1.0}};

  EXPECT_EQ(pareto_front(costs), (std::vector<bool>{true, true, false, false, true}));
}

TEST(ParetoFront, KeepsBothOfTwoEqualSettings) {
  EXPECT_EQ(pareto_front(Costs{{1.0, 1.0}, {1.0, 1.0}}), (std::vector<bool>{true, true}));
}

// From (0.001, 1) each tenfold time brings a tenfold smaller error until 0.01, then next to
// nothing.
TEST(Knee, IsWhereMoreTimeBringsLittle) {
  const Costs costs{{0.001, 1.0}, {0.01, 0.1}, {0.1, 0.01}, {1.0, 0.009}, {10.0, 0.008}};

  EXPECT_EQ(knee_of(costs), 2U);
}

TEST(Knee, DoesNotDependOnTheUnitsOfEitherAxis) {
  Costs costs{{0.001, 1.0}, {0.01, 0.1}, {0.1, 0.01}, {1.0, 0.009}, {10.0, 0.008}};
  for (SpeedAndError& cost : costs) {
    cost.seconds *= 7.0;
    cost.error *= 3.0;
  }

  EXPECT_EQ(knee_of(costs), 2U);
}

TEST(Knee, OfAFrontWithoutABendIsItsMostAccurate) {
  EXPECT_FALSE(knee_of(Costs{}).has_value());
  EXPECT_EQ(knee_of(Costs{{1.0, 1.0}}), 0U);
  EXPECT_EQ(knee_of(Costs{{1.0, 1.0}, {2.0, 0.5}}), 1U);
  EXPECT_EQ(knee_of(Costs{{1.0, 0.5}, {2.0, 1.0}}), 0U);                 // the front is one setting
  EXPECT_EQ(knee_of(Costs{{1.0, 1.0}, {10.0, 0.9}, {100.0, 0.1}}), 2U);  // it bends the other way
}

TEST(Knee, AnErrorOfZeroIsAnError) {
  const auto knee = knee_of(Costs{{0.0, 1.0}, {0.1, 0.5}, {1.0, 0.0}});
  ASSERT_TRUE(knee.has_value());
  EXPECT_LT(*knee, 3U);
}

TEST(KnobSweep, BeginsWithTheDefaultAndRepeatsNothing) {
  for (const std::string& model : prediction_models()) {
    const std::vector<KnobSetting> sweep = sweep_of(model);
    ASSERT_FALSE(sweep.empty());
    EXPECT_TRUE(sweep[0].is_default);
    EXPECT_EQ(describe_knobs(model, sweep[0].knobs), describe_knobs(model, {}));
    std::set<std::string> names;
    for (const KnobSetting& setting : sweep) {
      EXPECT_EQ(setting.is_default, &setting == sweep.data());
      EXPECT_TRUE(names.insert(describe_knobs(model, setting.knobs)).second)
          << describe_knobs(model, setting.knobs);
    }
  }
  EXPECT_GT(sweep_of("transport").size(), 3U);
  EXPECT_GT(sweep_of("profile").size(), 3U);
  EXPECT_EQ(sweep_of("uniform").size(), 1U);
}

TEST(KnobSweep, NamesEveryKnob) {
  PredictionKnobs knobs;
  knobs.paper.depth = 3;
  knobs.paper.bounces_exchanged = 1;
  knobs.paper.as_printed = true;
  knobs.transport.paths = 77;

  EXPECT_EQ(describe_knobs("paper", knobs),
            "depth=3 bins=6x12 bounces=1 occlusion=ratio as-printed");
  EXPECT_EQ(describe_knobs("paper", {}), "depth=2 bins=6x12 bounces=all occlusion=ratio");
  EXPECT_EQ(describe_knobs("transport", knobs), "paths=77");
  EXPECT_EQ(describe_knobs("profile", knobs), "pixels=default");
  EXPECT_EQ(describe_knobs("random", knobs), "");
}

}  // namespace
}  // namespace preheat
