// Who gets past the handshake: answers ZeroMQ's question for every connection to a socket with keys
// (ZAP, RFC 27), from one thread of its own. For zmq_transport.cc only.
//
// CURVE without such an answer lets every key in. Hence this is bound before any socket listens,
// and its own socket lives until the last listening one is closed: a thread that hangs or has died
// leaves questions unanswered, and unanswered means that nobody enters.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <thread>
#include <zmq.hpp>

#include "common/keys.h"

namespace preheat {

// Nothing for a key that may not enter. Called from two threads.
using Admit = std::function<std::optional<KeyRole>(std::string_view public_key)>;

class ZmqAdmission {
 public:
  // Throws zmq::error_t. The context outlives it.
  ZmqAdmission(zmq::context_t& context, Admit admit);
  ~ZmqAdmission();
  ZmqAdmission(const ZmqAdmission&) = delete;
  ZmqAdmission& operator=(const ZmqAdmission&) = delete;

  [[nodiscard]] std::optional<KeyRole> role_of(std::string_view public_key) const {
    return admit_(public_key);
  }
  // Until this is called, what is turned away is the self-test's.
  void start_counting() { counting_.store(true); }
  // Connections turned away so far.
  [[nodiscard]] std::uint64_t denied() const { return denied_.load(); }

 private:
  void serve() noexcept;
  void answer();

  Admit admit_;
  zmq::socket_t socket_;
  int stop_fd_;
  std::atomic<bool> counting_{false};
  std::atomic<std::uint64_t> denied_{0};
  std::thread thread_;  // last: it uses all of the above
};

}  // namespace preheat
