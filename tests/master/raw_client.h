// What a simple client of a TCP server on this machine does, for tests.
#pragma once

#include <poll.h>

#include <array>
#include <chrono>
#include <string>
#include <string_view>

#include "tests/common/raw_connection.h"

namespace preheat::test {

// Until the other side ends the connection or is silent for so long.
inline std::string read_all(int socket,
                            std::chrono::milliseconds silence = std::chrono::seconds(30)) {
  std::string bytes;
  std::array<char, 65536> buffer{};
  for (;;) {
    pollfd ready{socket, POLLIN, 0};
    if (::poll(&ready, 1, static_cast<int>(silence.count())) <= 0) { return bytes; }
    const ssize_t count = ::recv(socket, buffer.data(), buffer.size(), 0);
    if (count <= 0) { return bytes; }
    bytes.append(buffer.data(), static_cast<std::size_t>(count));
  }
}

inline bool send_all(int socket, std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t count = ::send(socket, bytes.data(), bytes.size(), MSG_NOSIGNAL);
    if (count <= 0) { return false; }
    bytes.remove_prefix(static_cast<std::size_t>(count));
  }
  return true;
}

// The answer to one request.
inline std::string get(unsigned port, std::string_view path, std::string_view host = "localhost") {
  const int socket = connect_raw(port);
  if (socket < 0) { return {}; }
  send_all(socket, std::string("GET ") + std::string(path) +
                       " HTTP/1.1\r\nHost: " + std::string(host) + "\r\n\r\n");
  std::string answer = read_all(socket);
  ::close(socket);
  return answer;
}

inline std::string body_of(const std::string& answer) {
  const std::size_t end = answer.find("\r\n\r\n");
  return end == std::string::npos ? std::string() : answer.substr(end + 4);
}

}  // namespace preheat::test
