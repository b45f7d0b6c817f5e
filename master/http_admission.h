// Which connections an HTTP server holds when more come than it has room for.
//
// Two bounds, one on all connections and one on those of an address, so that nobody takes every
// place. At a bound a newcomer takes the place of the oldest connection within it that has had its
// time; where none has, it is refused at its address's bound and waits at the bound of all. Pure.
#pragma once

#include <netinet/in.h>
#include <sys/socket.h>

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/clock.h"

namespace preheat {

struct HttpLimits {
  std::size_t connections_max = 64;
  std::size_t connections_per_address_max = 32;     // generous: proxies share one address
  std::chrono::milliseconds connection_max{10000};  // from accepted to closed
  std::chrono::milliseconds patience{500};          // after which a connection may lose its place
};

// An IPv4 address, mapped or not, or the /64 of an IPv6 address: one customer has a /64 at least,
// and could come from each of its addresses.
using ClientAddress = std::array<std::uint8_t, 16>;
[[nodiscard]] ClientAddress client_address(const sockaddr_storage& peer);

struct HeldConnection {
  ClientAddress address{};
  Time begin{};
};

// True while a newcomer would have to wait wherever it comes from: leave it to the system's queue.
// `held` is in the order in which they came.
[[nodiscard]] bool must_wait(const std::vector<HeldConnection>& held, Time now,
                             const HttpLimits& limits);

enum class Admission { kEnter, kReplace, kRefuse };
struct AdmissionDecision {
  Admission what = Admission::kEnter;
  std::size_t replaced = 0;  // of kReplace: index of who gives way
};
// Requires: !must_wait(held, now, limits).
[[nodiscard]] AdmissionDecision admit(const std::vector<HeldConnection>& held,
                                      const ClientAddress& newcomer, Time now,
                                      const HttpLimits& limits);

}  // namespace preheat
