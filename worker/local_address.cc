#include "worker/local_address.h"

#include <arpa/inet.h>
#include <fmt/format.h>
#include <netdb.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <memory>

namespace preheat {
namespace {

struct Closer {
  int fd = -1;
  ~Closer() {
    if (fd >= 0) { ::close(fd); }
  }
};

Result<std::string> failure(const Endpoint& remote, const char* reason) {
  return fail(ExitCode::kUsage, fmt::format("no way from here to {}: {}", remote.text(), reason));
}

}  // namespace

Result<std::string> local_address_towards(const Endpoint& remote) {
  std::string host = remote.host;
  if (host.size() >= 2 && host.front() == '[') { host = host.substr(1, host.size() - 2); }
  addrinfo hints{};
  hints.ai_family = remote.host.front() == '[' ? AF_INET6 : AF_INET;
  hints.ai_socktype = SOCK_DGRAM;
  addrinfo* found = nullptr;
  const int error =
      ::getaddrinfo(host.c_str(), std::to_string(remote.port).c_str(), &hints, &found);
  if (error != 0) { return failure(remote, ::gai_strerror(error)); }
  const std::unique_ptr<addrinfo, decltype(&::freeaddrinfo)> owner{found, &::freeaddrinfo};
  // A datagram socket that is connected has the address that its packets would leave from.
  const Closer socket{::socket(found->ai_family, SOCK_DGRAM | SOCK_CLOEXEC, 0)};
  sockaddr_storage own{};
  socklen_t length = sizeof own;
  std::array<char, NI_MAXHOST> text{};
  if (socket.fd < 0 || ::connect(socket.fd, found->ai_addr, found->ai_addrlen) != 0 ||
      ::getsockname(socket.fd, reinterpret_cast<sockaddr*>(&own), &length) != 0 ||
      ::getnameinfo(reinterpret_cast<const sockaddr*>(&own), length, text.data(), text.size(),
                    nullptr, 0, NI_NUMERICHOST) != 0) {
    return failure(remote, std::strerror(errno));
  }
  const std::string address{text.data()};
  return own.ss_family == AF_INET6 ? "[" + address + "]" : address;
}

}  // namespace preheat
