#include "master/tcp_socket.h"

#include <fmt/format.h>
#include <netdb.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <system_error>
#include <utility>

namespace preheat {

void Descriptor::reset(int number) {
  if (number_ >= 0) { ::close(number_); }
  number_ = number;
}

AddressList addresses_of(const Endpoint& endpoint, bool to_listen) {
  std::string host = endpoint.host;
  if (host.front() == '[') { host = host.substr(1, host.size() - 2); }
  addrinfo hints{};
  hints.ai_family = AF_UNSPEC;
  hints.ai_socktype = SOCK_STREAM;
  hints.ai_flags = AI_NUMERICSERV | (to_listen ? AI_PASSIVE : 0);
  addrinfo* found = nullptr;
  const bool any = host == "*";
  if (::getaddrinfo(any ? nullptr : host.c_str(), std::to_string(endpoint.port).c_str(), &hints,
                    &found) != 0) {
    found = nullptr;
  }
  return {found, [](addrinfo* list) {
            if (list != nullptr) { ::freeaddrinfo(list); }
          }};
}

Result<Descriptor> listen_at(const Endpoint& endpoint) {
  constexpr int kBacklog = 64;
  int error = 0;
  const AddressList list = addresses_of(endpoint, /*to_listen=*/true);
  for (const addrinfo* one = list.get(); one != nullptr; one = one->ai_next) {
    Descriptor socket(::socket(one->ai_family, one->ai_socktype | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
    const int yes = 1;
    if (socket.is_open() &&
        ::setsockopt(socket.number(), SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes) == 0 &&
        ::bind(socket.number(), one->ai_addr, one->ai_addrlen) == 0 &&
        ::listen(socket.number(), kBacklog) == 0) {
      return socket;
    }
    error = errno;
  }
  return fail(ExitCode::kUsage,
              fmt::format("cannot listen at {}:{}: {}", endpoint.host, endpoint.port,
                          list ? std::generic_category().message(error)
                               : std::string("the host is not known")));
}

std::uint16_t port_of(const Descriptor& socket) {
  sockaddr_storage address{};
  socklen_t length = sizeof address;
  if (::getsockname(socket.number(), reinterpret_cast<sockaddr*>(&address), &length) != 0) {
    return 0;
  }
  return ntohs(address.ss_family == AF_INET6
                   ? reinterpret_cast<const sockaddr_in6*>(&address)->sin6_port
                   : reinterpret_cast<const sockaddr_in*>(&address)->sin_port);
}

}  // namespace preheat
