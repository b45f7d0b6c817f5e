#include "cache/seen_sides.h"

#include <gtest/gtest.h>

#include <vector>

namespace preheat {
namespace {

using Flags = std::vector<std::uint8_t>;

TEST(SeenSides, KnowsNothingOfWhatWasNotSeen) {
  EXPECT_EQ(SeenSides(0).one_sided(), Flags{});
  EXPECT_EQ(SeenSides(2).one_sided(), (Flags{0, 0}));
}

TEST(SeenSides, FindsTheMaterialsThatShowTheirFrontsOnly) {
  SeenSides sides(4);
  for (int i = 0; i < 100; ++i) {
    sides.add(0, 0.7F);                         // fronts only
    sides.add(1, i % 2 == 0 ? 0.7F : -0.7F);    // both
    sides.add(2, -0.7F);                        // backs only: fronts may be where no path looked
    sides.add(3, i % 10 == 0 ? -0.05F : 0.6F);  // fronts, and an outline
  }

  EXPECT_EQ(sides.one_sided(), (Flags{1, 0, 0, 1}));
}

TEST(SeenSides, WantsMoreThanOneSight) {
  SeenSides sides(1);

  sides.add(0, 1.0F);
  EXPECT_EQ(sides.one_sided(), Flags{0});

  for (int i = 0; i < 3; ++i) { sides.add(0, 1.0F); }
  EXPECT_EQ(sides.one_sided(), Flags{1});
}

TEST(SeenSides, AddsUpWhatSeveralHaveSeen) {
  SeenSides fronts(2);
  SeenSides backs(2);
  for (int i = 0; i < 8; ++i) {
    fronts.add(0, 0.5F);
    fronts.add(1, 0.5F);
    backs.add(1, -0.5F);
  }

  fronts.add(backs);

  EXPECT_EQ(fronts.one_sided(), (Flags{1, 0}));
}

}  // namespace
}  // namespace preheat
