// A TCP socket as a value, and the two ways to come by one.
#pragma once

#include <memory>
#include <string>

#include "common/result.h"
#include "common/transport.h"

struct addrinfo;

namespace preheat {

// Owns a file descriptor.
class Descriptor {
 public:
  Descriptor() = default;
  explicit Descriptor(int number) : number_(number) {}
  Descriptor(Descriptor&& other) noexcept : number_(other.release()) {}
  Descriptor& operator=(Descriptor&& other) noexcept {
    reset(other.release());
    return *this;
  }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  ~Descriptor() { reset(); }

  [[nodiscard]] bool is_open() const { return number_ >= 0; }
  [[nodiscard]] int number() const { return number_; }
  void reset(int number = -1);

 private:
  int release() {
    const int number = number_;
    number_ = -1;
    return number;
  }
  int number_ = -1;
};

using AddressList = std::unique_ptr<addrinfo, void (*)(addrinfo*)>;

// Of a TCP socket; nullptr if there are none. May ask a name server. `to_listen`: for a socket that
// is bound here.
[[nodiscard]] AddressList addresses_of(const Endpoint& endpoint, bool to_listen);

// Not blocking, closed on exec. kUsage with the system's reason.
[[nodiscard]] Result<Descriptor> listen_at(const Endpoint& endpoint);

// The port that a socket is bound to.
[[nodiscard]] std::uint16_t port_of(const Descriptor& socket);

}  // namespace preheat
