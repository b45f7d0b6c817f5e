#include "master/http_admission.h"

#include <algorithm>
#include <cstring>

#include "common/check.h"

namespace preheat {

ClientAddress client_address(const sockaddr_storage& peer) {
  constexpr std::size_t kMappedPrefix = 12;  // ::ffff:0:0/96
  constexpr std::size_t kNetworkBytes = 8;   // a /64
  ClientAddress address{};
  if (peer.ss_family == AF_INET) {
    sockaddr_in ipv4{};
    std::memcpy(&ipv4, &peer, sizeof ipv4);
    address[10] = address[11] = 0xff;
    std::memcpy(address.data() + kMappedPrefix, &ipv4.sin_addr, sizeof ipv4.sin_addr);
  } else if (peer.ss_family == AF_INET6) {
    sockaddr_in6 ipv6{};
    std::memcpy(&ipv6, &peer, sizeof ipv6);
    const bool is_mapped = IN6_IS_ADDR_V4MAPPED(&ipv6.sin6_addr);
    std::memcpy(address.data(), &ipv6.sin6_addr, is_mapped ? address.size() : kNetworkBytes);
  }
  return address;
}

bool must_wait(const std::vector<HeldConnection>& held, Time now, const HttpLimits& limits) {
  return held.size() >= limits.connections_max && now - held.front().begin < limits.patience;
}

AdmissionDecision admit(const std::vector<HeldConnection>& held, const ClientAddress& newcomer,
                        Time now, const HttpLimits& limits) {
  const auto is_neighbour = [&](const HeldConnection& one) { return one.address == newcomer; };
  const auto neighbours =
      static_cast<std::size_t>(std::count_if(held.begin(), held.end(), is_neighbour));
  if (neighbours >= limits.connections_per_address_max) {
    const auto oldest = std::find_if(held.begin(), held.end(), is_neighbour);
    if (oldest == held.end() || now - oldest->begin < limits.patience) {
      return {Admission::kRefuse, 0};
    }
    return {Admission::kReplace, static_cast<std::size_t>(oldest - held.begin())};
  }
  if (held.size() < limits.connections_max) { return {Admission::kEnter, 0}; }
  CHECK(!must_wait(held, now, limits));
  return {Admission::kReplace, 0};
}

}  // namespace preheat
