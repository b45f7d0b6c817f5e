#include "worker/local_address.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace preheat {
namespace {

TEST(LocalAddress, OfTheWayToThisMachineIsLoopback) {
  EXPECT_EQ(local_address_towards({"127.0.0.1", 4000}).value(), "127.0.0.1");
  EXPECT_EQ(local_address_towards({"localhost", 4000}).value(), "127.0.0.1");
}

TEST(LocalAddress, OfNowhereIsAnErrorThatNamesIt) {
  const auto address = local_address_towards({"no.such.host.invalid", 4000});
  ASSERT_FALSE(address.has_value());
  EXPECT_THAT(address.error().message, ::testing::HasSubstr("no.such.host.invalid"));
}

}  // namespace
}  // namespace preheat
