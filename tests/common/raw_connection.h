// Plain TCP on this machine, for tests that play the stranger.
#pragma once

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cstdint>

namespace preheat {

inline sockaddr_in loopback(unsigned port) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<std::uint16_t>(port));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  return address;
}

// A socket that is connected to the port; -1 if nobody listens there. `from` is the last byte of
// its own address, 127.0.0.x, all of which are this machine's on Linux.
inline int connect_raw(unsigned port, unsigned from = 1) {
  const int fd = ::socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in own = loopback(0);
  own.sin_addr.s_addr = htonl((INADDR_LOOPBACK & ~0xffU) | from);
  if (::bind(fd, reinterpret_cast<const sockaddr*>(&own), sizeof own) != 0) {
    ::close(fd);
    return -1;
  }
  const sockaddr_in address = loopback(port);
  if (::connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0) {
    return fd;
  }
  ::close(fd);
  return -1;
}

}  // namespace preheat
