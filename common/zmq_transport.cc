#include "common/zmq_transport.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <random>
#include <utility>
#include <vector>
#include <zmq.hpp>

#include "common/clock.h"

namespace preheat {
namespace {

constexpr int kLingerMs = 1000;
constexpr int kReconnectMs = 100;
constexpr int kReconnectMsMax = 5000;
constexpr int kHandshakeMs = 2000;
constexpr int kBacklog = 1024;
constexpr int kMessagesQueuedMax = 64;  // per peer, each way
constexpr int kUnsoundPerCall = 32;
constexpr std::size_t kRoutingIdBytes = 17;  // kind, then the session

using RoutingId = std::array<std::byte, kRoutingIdBytes>;

RoutingId routing_id(ChannelKind kind, const SessionId& session) {
  RoutingId id{};
  // ZeroMQ keeps ids that begin with a zero byte for itself.
  constexpr std::array<std::byte, 3> kNames{std::byte{'C'}, std::byte{'B'}, std::byte{'P'}};
  id[0] = kNames[static_cast<std::size_t>(kind)];
  std::memcpy(&id[1], &session.low, 8);
  std::memcpy(&id[9], &session.high, 8);
  return id;
}

std::optional<SessionId> session_of(ChannelKind kind, const zmq::message_t& id) {
  if (id.size() != kRoutingIdBytes) { return std::nullopt; }
  SessionId session;
  std::memcpy(&session.low, id.data<std::byte>() + 1, 8);
  std::memcpy(&session.high, id.data<std::byte>() + 9, 8);
  if (routing_id(kind, session)[0] != *id.data<std::byte>()) { return std::nullopt; }
  return session;
}

// Called on ZeroMQ's own thread when the bytes have left.
void drop_owner(void* /*bytes*/, void* hint) {
  delete static_cast<std::shared_ptr<const void>*>(hint);
}

zmq::message_t message_of(const Payload& data) {
  // ZeroMQ only reads what it sends.
  void* bytes = const_cast<std::byte*>(data.bytes.data());
  auto* owner = new std::shared_ptr<const void>(data.owner);
  return {bytes, data.bytes.size(), drop_owner, owner};
}

Payload payload_of(zmq::message_t&& message) {
  auto kept = std::make_shared<zmq::message_t>(std::move(message));
  const std::span<const std::byte> bytes{kept->data<std::byte>(), kept->size()};
  return {bytes, std::move(kept)};
}

void set_options(zmq::socket_t& socket, const std::string& endpoint, ChannelKind kind) {
  const bool control = kind == ChannelKind::kControl;
  const auto frame_bytes_max = static_cast<std::int64_t>(
      control ? kControlFrameBytesMax : std::max(kChunkBytesMax, kControlFrameBytesMax));
  socket.set(zmq::sockopt::maxmsgsize, frame_bytes_max);
  socket.set(zmq::sockopt::sndhwm, kMessagesQueuedMax);
  socket.set(zmq::sockopt::rcvhwm, kMessagesQueuedMax);
  socket.set(zmq::sockopt::linger, kLingerMs);
  socket.set(zmq::sockopt::handshake_ivl, kHandshakeMs);
  socket.set(zmq::sockopt::reconnect_ivl, kReconnectMs);
  socket.set(zmq::sockopt::reconnect_ivl_max, kReconnectMsMax);
  // Only where it is asked for: with it, IPv4 addresses are reported as mapped IPv6 ones.
  socket.set(zmq::sockopt::ipv6, endpoint.find('[') != std::string::npos);
  socket.set(zmq::sockopt::tcp_keepalive, 1);
  socket.set(zmq::sockopt::tcp_keepalive_idle, 10);
  socket.set(zmq::sockopt::tcp_keepalive_intvl, 5);
  socket.set(zmq::sockopt::tcp_keepalive_cnt, 3);
}

class ZmqChannel : public Channel {
 public:
  // `self` is the session of a connecting channel; a listening one has none.
  ZmqChannel(std::shared_ptr<zmq::context_t> context, zmq::socket_t socket, ChannelKind kind,
             std::optional<SessionId> self)
      : context_(std::move(context)), socket_(std::move(socket)), kind_(kind), self_(self) {}

  SendOutcome send(const SessionId& to, std::span<const std::byte> head,
                   const Payload& data) override {
    const bool has_data = !data.bytes.empty();
    try {
      if (!self_) {
        const RoutingId id = routing_id(kind_, to);
        if (!socket_.send(zmq::const_buffer(id.data(), id.size()), more(true))) {
          return SendOutcome::kFull;
        }
      }
      // After the first part ZeroMQ takes the rest of a message whatever its queue holds.
      if (!socket_.send(zmq::const_buffer(head.data(), head.size()), more(has_data))) {
        return SendOutcome::kFull;
      }
      if (has_data) {
        zmq::message_t message = message_of(data);
        static_cast<void>(socket_.send(message, more(false)));
      }
      return SendOutcome::kSent;
    } catch (const zmq::error_t& error) {
      if (error.num() == EINTR) { return SendOutcome::kFull; }
      return SendOutcome::kGone;
    }
  }

  std::optional<Received> receive() override {
    try {
      for (int tries = 0; tries < kUnsoundPerCall; ++tries) {
        bool any = false;
        std::optional<Received> received = receive_one(any);
        if (received || !any) { return received; }
        ++dropped_;
      }
    } catch (const zmq::error_t& error) {
      if (error.num() != EINTR) {
        spdlog::warn("event=receive_failed reason=\"{}\"", error.what());
      }
    }
    return std::nullopt;
  }

  std::string endpoint() const override { return socket_.get(zmq::sockopt::last_endpoint); }
  std::uint64_t dropped() const override { return dropped_; }
  void* handle() { return socket_.handle(); }

 private:
  static zmq::send_flags more(bool yes) {
    return yes ? zmq::send_flags::dontwait | zmq::send_flags::sndmore : zmq::send_flags::dontwait;
  }

  // Takes one whole message; `any` says that there was one. Not of our shape: nullopt.
  std::optional<Received> receive_one(bool& any) {
    std::array<zmq::message_t, 3> parts;
    const std::size_t parts_min = self_ ? 1 : 2;
    const std::size_t parts_max = parts_min + 1;
    std::size_t count = 0;
    bool more = true;
    while (more) {
      zmq::message_t surplus;
      zmq::message_t& part = count < parts_max ? parts[count] : surplus;
      if (!socket_.recv(part, zmq::recv_flags::dontwait)) { return std::nullopt; }
      any = true;
      more = part.more();
      ++count;
    }
    if (count < parts_min || count > parts_max) { return std::nullopt; }
    Received received;
    std::size_t next = 0;
    if (self_) {
      received.session = *self_;
    } else {
      const std::optional<SessionId> from = session_of(kind_, parts[next++]);
      if (!from) { return std::nullopt; }
      received.session = *from;
    }
    received.head = payload_of(std::move(parts[next++]));
    if (next < count) { received.data = payload_of(std::move(parts[next])); }
    return received;
  }

  std::shared_ptr<zmq::context_t>
      context_;  // ends after the last of its sockets, or waits for ever
  zmq::socket_t socket_;
  ChannelKind kind_;
  std::optional<SessionId> self_;
  std::uint64_t dropped_ = 0;
};

class ZmqTransport : public Transport {
 public:
  Result<std::unique_ptr<Channel>> listen(const std::string& endpoint, ChannelKind kind) override {
    try {
      zmq::socket_t socket{*context_, zmq::socket_type::router};
      set_options(socket, endpoint, kind);
      socket.set(zmq::sockopt::backlog, kBacklog);
      socket.set(zmq::sockopt::router_mandatory, true);
      // A worker whose connection died silently comes back under its own name.
      socket.set(zmq::sockopt::router_handover, true);
      socket.bind(endpoint);
      return std::make_unique<ZmqChannel>(context_, std::move(socket), kind, std::nullopt);
    } catch (const zmq::error_t& error) {
      return fail(ExitCode::kUsage, fmt::format("cannot listen on {}: {}", endpoint, error.what()));
    }
  }

  Result<std::unique_ptr<Channel>> connect(const std::string& endpoint, ChannelKind kind,
                                           const SessionId& session) override {
    try {
      zmq::socket_t socket{*context_, zmq::socket_type::dealer};
      set_options(socket, endpoint, kind);
      const RoutingId id = routing_id(kind, session);
      socket.set(zmq::sockopt::routing_id, zmq::const_buffer(id.data(), id.size()));
      // Only what a living connection can take is queued: nothing of this job waits for the next.
      socket.set(zmq::sockopt::immediate, true);
      socket.connect(endpoint);
      return std::make_unique<ZmqChannel>(context_, std::move(socket), kind, session);
    } catch (const zmq::error_t& error) {
      return fail(ExitCode::kUsage,
                  fmt::format("cannot connect to {}: {}", endpoint, error.what()));
    }
  }

  void wait(std::span<Channel* const> channels, int event_fd,
            std::chrono::milliseconds timeout) override {
    std::vector<zmq::pollitem_t> items;
    for (Channel* channel : channels) {
      // Every channel of this transport is one of ours.
      items.push_back({static_cast<ZmqChannel*>(channel)->handle(), 0, ZMQ_POLLIN, 0});
    }
    if (event_fd >= 0) { items.push_back({nullptr, event_fd, ZMQ_POLLIN, 0}); }
    try {
      zmq::poll(items, timeout);
    } catch (const zmq::error_t& error) {
      if (error.num() != EINTR) { throw; }
    }
  }

 private:
  std::shared_ptr<zmq::context_t> context_ = std::make_shared<zmq::context_t>(1);
};

}  // namespace

std::unique_ptr<Transport> make_zmq_transport() { return std::make_unique<ZmqTransport>(); }

std::uint64_t random_bits() {
  std::random_device device;
  return (std::uint64_t{device()} << 32) | device();
}

SessionId random_session() { return {random_bits(), random_bits()}; }

}  // namespace preheat
