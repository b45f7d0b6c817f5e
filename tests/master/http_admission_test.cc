#include "master/http_admission.h"

#include <arpa/inet.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstring>
#include <random>
#include <string>
#include <vector>

namespace preheat {
namespace {

using std::chrono::milliseconds;

ClientAddress address_of(const std::string& text) {
  sockaddr_storage peer{};
  sockaddr_in ipv4{};
  sockaddr_in6 ipv6{};
  if (::inet_pton(AF_INET, text.c_str(), &ipv4.sin_addr) == 1) {
    ipv4.sin_family = AF_INET;
    std::memcpy(&peer, &ipv4, sizeof ipv4);
  } else {
    EXPECT_EQ(::inet_pton(AF_INET6, text.c_str(), &ipv6.sin6_addr), 1) << text;
    ipv6.sin6_family = AF_INET6;
    std::memcpy(&peer, &ipv6, sizeof ipv6);
  }
  return client_address(peer);
}

Time at(int ms) { return Time{} + milliseconds(ms); }

HttpLimits limits() {
  HttpLimits limits;
  limits.connections_max = 4;
  limits.connections_per_address_max = 2;
  limits.patience = milliseconds(500);
  return limits;
}

TEST(ClientAddress, IsAnIPv4AddressHoweverItCame) {
  EXPECT_EQ(address_of("192.0.2.1"), address_of("::ffff:192.0.2.1"));
  EXPECT_NE(address_of("192.0.2.1"), address_of("192.0.2.2"));
  EXPECT_NE(address_of("::ffff:192.0.2.1"), address_of("::ffff:192.0.2.2"));
}

TEST(ClientAddress, IsTheNetworkOfAnIPv6Address) {
  EXPECT_EQ(address_of("2001:db8:1:2::1"), address_of("2001:db8:1:2:ffff:ffff:ffff:ffff"));
  EXPECT_NE(address_of("2001:db8:1:2::1"), address_of("2001:db8:1:3::1"));
  EXPECT_NE(address_of("::1"), address_of("127.0.0.1"));
}

TEST(HttpAdmission, LetsInWhileThereIsRoom) {
  const ClientAddress a = address_of("192.0.2.1");

  EXPECT_EQ(admit({}, a, at(0), limits()).what, Admission::kEnter);
  EXPECT_EQ(admit({{a, at(0)}}, a, at(0), limits()).what, Admission::kEnter);
}

TEST(HttpAdmission, RefusesAnAddressThatHasAllItsPlacesAndGivesUpNone) {
  const ClientAddress a = address_of("192.0.2.1");
  const ClientAddress b = address_of("192.0.2.2");
  const std::vector<HeldConnection> held{{a, at(0)}, {a, at(100)}};

  EXPECT_EQ(admit(held, a, at(499), limits()).what, Admission::kRefuse);
  EXPECT_EQ(admit(held, b, at(499), limits()).what, Admission::kEnter);
}

TEST(HttpAdmission, ReplacesTheAddressesOwnOldestThatHasHadItsTime) {
  const ClientAddress a = address_of("192.0.2.1");
  const ClientAddress b = address_of("192.0.2.2");
  const std::vector<HeldConnection> held{{b, at(0)}, {a, at(10)}, {a, at(20)}};

  const AdmissionDecision decision = admit(held, a, at(510), limits());

  EXPECT_EQ(decision.what, Admission::kReplace);
  EXPECT_EQ(decision.replaced, 1U);
}

TEST(HttpAdmission, WaitsWhenFullUntilTheOldestHasHadItsTime) {
  const ClientAddress a = address_of("192.0.2.1");
  const ClientAddress b = address_of("192.0.2.2");
  const std::vector<HeldConnection> held{{a, at(0)}, {a, at(1)}, {b, at(2)}, {b, at(3)}};

  EXPECT_TRUE(must_wait(held, at(499), limits()));
  ASSERT_FALSE(must_wait(held, at(500), limits()));
  const AdmissionDecision decision = admit(held, address_of("192.0.2.3"), at(500), limits());
  EXPECT_EQ(decision.what, Admission::kReplace);
  EXPECT_EQ(decision.replaced, 0U);
}

// Whatever comes when: the bounds hold, only who has had its time gives way, and an address that
// has fewer than its places is never refused.
TEST(HttpAdmission, KeepsItsBoundsWhateverComes) {
  constexpr unsigned kSeed = 20261122;
  SCOPED_TRACE(kSeed);
  std::mt19937 random(kSeed);
  HttpLimits bounds = limits();
  bounds.connections_max = 8;
  bounds.connections_per_address_max = 3;
  std::vector<HeldConnection> held;
  int refused = 0;
  int replaced = 0;
  int waited = 0;
  int now_ms = 0;
  for (int step = 0; step < 20'000; ++step) {
    now_ms += static_cast<int>(random() % 100);
    const Time now = at(now_ms);
    if (random() % 4 == 0 && !held.empty()) {
      held.erase(held.begin() + static_cast<std::ptrdiff_t>(random() % held.size()));
    }
    ClientAddress newcomer{};
    newcomer[0] = static_cast<std::uint8_t>(random() % 4);
    const auto is_neighbour = [&](const HeldConnection& one) { return one.address == newcomer; };
    const auto neighbours = std::count_if(held.begin(), held.end(), is_neighbour);
    if (must_wait(held, now, bounds)) {
      ++waited;
      continue;
    }
    const AdmissionDecision decision = admit(held, newcomer, now, bounds);
    if (decision.what == Admission::kRefuse) {
      ++refused;
      ASSERT_EQ(neighbours, 3);
      continue;
    }
    if (decision.what == Admission::kReplace) {
      ++replaced;
      ASSERT_GE(now - held.at(decision.replaced).begin, bounds.patience);
      held.erase(held.begin() + static_cast<std::ptrdiff_t>(decision.replaced));
    }
    held.push_back({newcomer, now});
    ASSERT_LE(held.size(), 8U);
    ASSERT_LE(std::count_if(held.begin(), held.end(), is_neighbour), 3);
  }
  EXPECT_GT(refused, 100);
  EXPECT_GT(replaced, 100);
  EXPECT_GT(waited, 100);
}

}  // namespace
}  // namespace preheat
