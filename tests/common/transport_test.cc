#include "common/transport.h"

#include <gtest/gtest.h>

namespace preheat {
namespace {

TEST(Endpoint, IsTakenApart) {
  const auto any = parse_endpoint("tcp://127.0.0.1:*");
  const auto six = parse_endpoint("tcp://[::1]:4000");

  ASSERT_TRUE(any.has_value());
  EXPECT_EQ(any->host, "127.0.0.1");
  EXPECT_EQ(any->port, 0);
  ASSERT_TRUE(six.has_value());
  EXPECT_EQ(six->host, "[::1]");
  EXPECT_EQ(six->port, 4000);
  EXPECT_EQ(six->text(), "tcp://[::1]:4000");
}

TEST(Endpoint, RefusesWhatIsNone) {
  for (const char* text :
       {"", "127.0.0.1:80", "tcp://", "tcp://host", "tcp://:80", "tcp://host:", "tcp://host:65536",
        "tcp://host:8x", "tcp://::1:80", "ipc:///tmp/x", "tcp://host:-1"}) {
    const auto endpoint = parse_endpoint(text);
    ASSERT_FALSE(endpoint.has_value()) << text;
    EXPECT_EQ(endpoint.error().code, ExitCode::kUsage);
  }
}

TEST(Endpoint, OnlyLoopbackIsUsedWithoutBeingAsked) {
  struct Case {
    const char* text;
    bool loopback;
  };
  for (const Case& c : {Case{"tcp://127.0.0.1:1", true}, Case{"tcp://127.9.8.7:1", true},
                        Case{"tcp://localhost:1", true}, Case{"tcp://[::1]:1", true},
                        Case{"tcp://0.0.0.0:1", false}, Case{"tcp://*:1", false},
                        Case{"tcp://[::]:1", false}, Case{"tcp://10.0.0.1:1", false},
                        Case{"tcp://127.evil.example:1", false}, Case{"tcp://render1:1", false}}) {
    EXPECT_EQ(check_endpoint(c.text, /*reach_settled=*/false).has_value(), c.loopback) << c.text;
    EXPECT_TRUE(check_endpoint(c.text, /*reach_settled=*/true).has_value()) << c.text;
  }
}

}  // namespace
}  // namespace preheat
