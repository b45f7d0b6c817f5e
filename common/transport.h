// Sockets as the rest of the program sees them: frames to and from sessions, never blocking.
//
// A message is a head (an encoded frame, codec.h) and optional data behind it, at most two parts.
// Anything else that arrives is dropped and counted before anyone looks at it.
// Threads: one owner calls every member of a transport and its channels.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>

#include "common/keys.h"
#include "common/messages.h"
#include "common/result.h"

namespace preheat {

enum class ChannelKind : std::uint8_t {
  kControl = 0,
  kBulk = 1,
  kPeer = 2  // as bulk, between workers
};

// Bytes and what keeps them alive. Without an owner they outlive the transport (the mapped store).
struct Payload {
  std::span<const std::byte> bytes{};
  std::shared_ptr<const void> owner{};
};

struct Received {
  SessionId session{};  // who sent it; at a worker always the worker's own
  // Whose key the sender holds, on a listening channel of a transport with keys.
  std::optional<KeyRole> role{};
  Payload head{};
  Payload data{};
};

enum class SendOutcome : std::uint8_t {
  kSent,
  kFull,  // back-pressure: try again later
  kGone   // no such peer (any more)
};

// How connecting went so far, as far as the other side lets us know.
struct Handshakes {
  // Not empty: the other side will not have us, and trying again does not help.
  std::string refused{};
  // Connections that ended before both sides had proven themselves, since the last that stood.
  std::uint64_t broken = 0;
};

class Channel {
 public:
  virtual ~Channel() = default;
  // `head` is copied, `data` is not: its owner is dropped when the bytes have left.
  [[nodiscard]] virtual SendOutcome send(const SessionId& to, std::span<const std::byte> head,
                                         const Payload& data) = 0;
  // Nothing there: nullopt. At most 32 unsound messages are dropped in one call.
  [[nodiscard]] virtual std::optional<Received> receive() = 0;
  // The address others connect to, with the port that the system chose.
  [[nodiscard]] virtual std::string endpoint() const = 0;
  [[nodiscard]] virtual std::uint64_t dropped() const = 0;
  // Of a connecting channel.
  [[nodiscard]] virtual const Handshakes& handshakes() = 0;
};

class Transport {
 public:
  virtual ~Transport() = default;
  // The address is in use or bad: kUsage, naming the address and the system's reason.
  [[nodiscard]] virtual Result<std::unique_ptr<Channel>> listen(const std::string& endpoint,
                                                                ChannelKind kind) = 0;
  // Connects in the background and again after every loss.
  [[nodiscard]] virtual Result<std::unique_ptr<Channel>> connect(const std::string& endpoint,
                                                                 ChannelKind kind,
                                                                 const SessionId& session) = 0;
  // Until a channel has something to receive, `event_fd` (-1 = none) is readable, a signal came or
  // the time is over.
  virtual void wait(std::span<Channel* const> channels, int event_fd,
                    std::chrono::milliseconds timeout) = 0;
  // Connections that were turned away for their key, or for having none.
  [[nodiscard]] virtual std::uint64_t denied() const = 0;
};

// tcp://HOST:PORT, taken apart. HOST may be a name, an IPv4 address or [an IPv6 address].
struct Endpoint {
  std::string host{};      // with its brackets
  std::uint16_t port = 0;  // 0 = any, also written *
  [[nodiscard]] std::string text() const;
};

// kUsage with the reason if it is not an endpoint.
[[nodiscard]] Result<Endpoint> parse_endpoint(const std::string& text);

// Reached from this machine only. Everything else wants keys or `--insecure-no-auth`.
[[nodiscard]] bool is_loopback(const Endpoint& endpoint);

// kUsage unless the endpoint is well formed and loopback, or `reach_settled`: there are keys, or
// `--insecure-no-auth` was spelled out.
[[nodiscard]] Result<Endpoint> check_endpoint(const std::string& text, bool reach_settled);

}  // namespace preheat
