#include "common/self_test.h"

#include <gtest/gtest.h>

#include <cfenv>

namespace preheat {
namespace {

TEST(NumericSelfTest, IsTheSameEveryTimeAndNotWithAnotherRounding) {
  const std::uint64_t expected = numeric_self_test();
  EXPECT_EQ(numeric_self_test(), expected);

  ASSERT_EQ(std::fesetround(FE_UPWARD), 0);
  const std::uint64_t upward = numeric_self_test();
  std::fesetround(FE_TONEAREST);

  EXPECT_NE(upward, expected);
}

}  // namespace
}  // namespace preheat
