#include "common/zmq_transport.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <string.h>  // explicit_bzero

#include <algorithm>
#include <array>
#include <atomic>
#include <cstring>
#include <random>
#include <utility>
#include <vector>
#include <zmq.hpp>

#include "common/check.h"
#include "common/clock.h"
#include "common/zmq_admission.h"

namespace preheat {
namespace {

constexpr int kLingerMs = 1000;
constexpr int kReconnectMs = 100;
constexpr int kReconnectMsMax = 5000;
constexpr int kHandshakeMs = 2000;
constexpr int kUnacknowledgedMsMax = 15000;
constexpr int kBacklog = 1024;
constexpr int kMessagesQueuedMax = 64;  // per peer, each way
constexpr int kUnsoundPerCall = 32;
constexpr std::chrono::seconds kSelfTest{10};
constexpr const char* kZapDomain = "preheat";
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
  // Keep-alive does not probe while something is on its way: a peer that comes back under another
  // address would be waited for until TCP itself gives up, after a quarter of an hour.
  socket.set(zmq::sockopt::tcp_maxrt, kUnacknowledgedMsMax);
}

// What all sockets of a transport share and must not outlive. Without keys there is no admission.
struct Shared {
  zmq::context_t context;
  std::optional<TransportSecurity> security{};
  std::unique_ptr<ZmqAdmission> admission{};  // before the context ends

  explicit Shared(std::optional<TransportSecurity> given)
      : context(given ? 2 : 1), security(std::move(given)) {}
};

// The one place where a socket gets its security: called for each before it binds or connects.
void secure_listening(zmq::socket_t& socket, const Shared& shared) {
  if (!shared.security) { return; }
  CHECK(shared.admission != nullptr);
  socket.set(zmq::sockopt::curve_server, true);
  socket.set(zmq::sockopt::curve_secretkey, shared.security->keys.own.secret.c_str());
  socket.set(zmq::sockopt::zap_domain, kZapDomain);
}

void secure_connecting(zmq::socket_t& socket, const KeyPair& own, const PublicKey& other) {
  socket.set(zmq::sockopt::curve_serverkey, other);
  socket.set(zmq::sockopt::curve_publickey, own.public_key);
  socket.set(zmq::sockopt::curve_secretkey, own.secret.c_str());
}

// Reads what ZeroMQ tells of a connecting socket's handshakes. The socket must be told to stop
// (`release`) before it is closed.
class HandshakeWatch {
 public:
  HandshakeWatch(zmq::context_t& context, zmq::socket_t& watched)
      : socket_(context, zmq::socket_type::pair) {
    static std::atomic<std::uint64_t> count{0};
    const std::string address = fmt::format("inproc://handshakes.{}", ++count);
    constexpr int kEvents = ZMQ_EVENT_HANDSHAKE_SUCCEEDED | ZMQ_EVENT_HANDSHAKE_FAILED_NO_DETAIL |
                            ZMQ_EVENT_HANDSHAKE_FAILED_PROTOCOL | ZMQ_EVENT_HANDSHAKE_FAILED_AUTH;
    if (::zmq_socket_monitor(watched.handle(), address.c_str(), kEvents) != 0) {
      throw zmq::error_t();
    }
    socket_.set(zmq::sockopt::linger, 0);
    socket_.connect(address);
  }

  static void release(zmq::socket_t& watched) {
    ::zmq_socket_monitor(watched.handle(), nullptr, 0);
  }

  const Handshakes& state() const { return state_; }

  void read() {
    zmq::message_t event;
    while (socket_.recv(event, zmq::recv_flags::dontwait)) {
      zmq::message_t address;
      if (event.more()) { static_cast<void>(socket_.recv(address)); }
      // Event u16, value u32, in this machine's order.
      std::uint16_t what = 0;
      std::uint32_t value = 0;
      if (event.size() != sizeof what + sizeof value) { continue; }
      std::memcpy(&what, event.data(), sizeof what);
      std::memcpy(&value, event.data<std::byte>() + sizeof what, sizeof value);
      take(what, value);
    }
  }

 private:
  void take(std::uint16_t event, std::uint32_t value) {
    switch (event) {
      case ZMQ_EVENT_HANDSHAKE_SUCCEEDED:
        state_ = {};
        break;
      case ZMQ_EVENT_HANDSHAKE_FAILED_AUTH:
        state_.refused = "it does not list this key";
        break;
      case ZMQ_EVENT_HANDSHAKE_FAILED_PROTOCOL:
        if (value == ZMQ_PROTOCOL_ERROR_ZMTP_MECHANISM_MISMATCH) {
          state_.refused = "only one of both sides has keys";
        }
        ++state_.broken;
        break;
      default:
        ++state_.broken;
    }
  }

  zmq::socket_t socket_;
  Handshakes state_{};
};

class ZmqChannel : public Channel {
 public:
  // `self` is the session of a connecting channel; a listening one has none.
  ZmqChannel(std::shared_ptr<Shared> shared, zmq::socket_t socket, ChannelKind kind,
             std::optional<SessionId> self, std::unique_ptr<HandshakeWatch> watch)
      : shared_(std::move(shared)),
        socket_(std::move(socket)),
        kind_(kind),
        self_(self),
        watch_(std::move(watch)) {}
  ~ZmqChannel() override {
    if (watch_) { HandshakeWatch::release(socket_); }
  }
  ZmqChannel(const ZmqChannel&) = delete;
  ZmqChannel& operator=(const ZmqChannel&) = delete;

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
      // Read while it is little: ZeroMQ's own threads wait where it is not.
      if (watch_) { watch_->read(); }
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
  const Handshakes& handshakes() override {
    CHECK(watch_ != nullptr);
    watch_->read();
    return watch_->state();
  }
  void* handle() { return socket_.handle(); }
  void connect(const std::string& endpoint) { socket_.connect(endpoint); }

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
      if (shared_->admission) {
        // The handshake has asked already; this holds even if it were passed unasked, and when
        // the key has been struck off the list since.
        received.role = role_of(parts[next]);
        if (!received.role) { return std::nullopt; }
      }
    }
    received.head = payload_of(std::move(parts[next++]));
    if (next < count) { received.data = payload_of(std::move(parts[next])); }
    return received;
  }

  // Whose key the sender proved to hold in the handshake.
  std::optional<KeyRole> role_of(const zmq::message_t& part) const {
    const char* const key = ::zmq_msg_gets(part.handle(), "User-Id");
    return key == nullptr ? std::nullopt : shared_->admission->role_of(key);
  }

  std::shared_ptr<Shared> shared_;  // ends after the last of its sockets, or waits for ever
  zmq::socket_t socket_;
  ChannelKind kind_;
  std::optional<SessionId> self_;
  std::unique_ptr<HandshakeWatch> watch_;
  std::uint64_t dropped_ = 0;
};

class ZmqTransport : public Transport {
 public:
  explicit ZmqTransport(std::optional<TransportSecurity> security)
      : shared_(std::make_shared<Shared>(std::move(security))) {}

  Result<std::unique_ptr<Channel>> listen(const std::string& endpoint, ChannelKind kind) override {
    if (auto closed = close_gate(); !closed) { return tl::unexpected(closed.error()); }
    return bind(endpoint, kind);
  }

  Result<std::unique_ptr<Channel>> connect(const std::string& endpoint, ChannelKind kind,
                                           const SessionId& session) override {
    if (!shared_->security) { return connect_as(endpoint, kind, session, nullptr, {}); }
    const Keys& keys = shared_->security->keys;
    // Workers that talk to each other hold the same key.
    const PublicKey& other = kind == ChannelKind::kPeer ? keys.own.public_key : keys.master;
    return connect_as(endpoint, kind, session, &keys.own, other);
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

  std::uint64_t denied() const override {
    return shared_->admission ? shared_->admission->denied() : 0;
  }

 private:
  Result<std::unique_ptr<Channel>> bind(const std::string& endpoint, ChannelKind kind) {
    try {
      zmq::socket_t socket{shared_->context, zmq::socket_type::router};
      set_options(socket, endpoint, kind);
      secure_listening(socket, *shared_);
      socket.set(zmq::sockopt::backlog, kBacklog);
      socket.set(zmq::sockopt::router_mandatory, true);
      // A worker whose connection died silently comes back under its own name.
      socket.set(zmq::sockopt::router_handover, true);
      socket.bind(endpoint);
      return std::make_unique<ZmqChannel>(shared_, std::move(socket), kind, std::nullopt, nullptr);
    } catch (const zmq::error_t& error) {
      return fail(ExitCode::kUsage, fmt::format("cannot listen on {}: {}", endpoint, error.what()));
    }
  }

  // With `own` the other side has to hold the secret of `other`.
  Result<std::unique_ptr<Channel>> connect_as(const std::string& endpoint, ChannelKind kind,
                                              const SessionId& session, const KeyPair* own,
                                              const PublicKey& other) {
    try {
      zmq::socket_t socket{shared_->context, zmq::socket_type::dealer};
      set_options(socket, endpoint, kind);
      if (own != nullptr) { secure_connecting(socket, *own, other); }
      const RoutingId id = routing_id(kind, session);
      socket.set(zmq::sockopt::routing_id, zmq::const_buffer(id.data(), id.size()));
      // Only what a living connection can take is queued: nothing of this job waits for the next.
      socket.set(zmq::sockopt::immediate, true);
      auto watch = std::make_unique<HandshakeWatch>(shared_->context, socket);
      auto channel =
          std::make_unique<ZmqChannel>(shared_, std::move(socket), kind, session, std::move(watch));
      channel->connect(endpoint);
      return channel;
    } catch (const zmq::error_t& error) {
      return fail(ExitCode::kUsage,
                  fmt::format("cannot connect to {}: {}", endpoint, error.what()));
    }
  }

  // Before the first socket listens: the gate is there, and a key that nobody listed does not pass
  // it.
  Result<void> close_gate() {
    if (!shared_->security || gate_closed_) { return {}; }
    if (::zmq_has("curve") == 0) {
      return fail(ExitCode::kUsage, "this build of ZeroMQ cannot use keys: it is without CURVE");
    }
    try {
      if (!shared_->admission) {
        shared_->admission =
            std::make_unique<ZmqAdmission>(shared_->context, shared_->security->admit);
      }
    } catch (const zmq::error_t& error) {
      return fail(ExitCode::kFailed, fmt::format("cannot guard the sockets: {}", error.what()));
    }
    // Who fails to listen may try again, and is tested again.
    if (auto tested = test_gate(); !tested) { return tested; }
    shared_->admission->start_counting();
    gate_closed_ = true;
    return {};
  }

  Result<void> test_gate() {
    const auto gate = bind("tcp://127.0.0.1:*", ChannelKind::kControl);
    if (!gate) { return tl::unexpected(gate.error()); }
    const KeyPair stranger = make_key_pair();
    const auto client = connect_as((*gate)->endpoint(), ChannelKind::kControl, random_session(),
                                   &stranger, shared_->security->keys.own.public_key);
    if (!client) { return tl::unexpected(client.error()); }
    const Time end = Clock::now() + kSelfTest;
    while ((*client)->handshakes().refused.empty()) {
      // Only a channel that stands takes a message.
      const bool entered = (*client)->send({}, std::array{std::byte{0}}, {}) == SendOutcome::kSent;
      if (entered || Clock::now() >= end) {
        return fail(ExitCode::kFailed, entered ? "the self-test of the keys failed: a stranger's "
                                                 "key was let in"
                                               : "the self-test of the keys failed: no answer");
      }
      const std::array<Channel*, 1> channels{client->get()};
      wait(channels, -1, std::chrono::milliseconds(1));
    }
    return {};
  }

  std::shared_ptr<Shared> shared_;
  bool gate_closed_ = false;  // and found to hold
};

}  // namespace

TransportSecurity secure_with(Keys keys, std::shared_ptr<AllowList> allowed) {
  return {std::move(keys), [allowed = std::move(allowed)](std::string_view public_key) {
            return allowed->role_of(public_key);
          }};
}

std::unique_ptr<Transport> make_zmq_transport(std::optional<TransportSecurity> security) {
  return std::make_unique<ZmqTransport>(std::move(security));
}

KeyPair make_key_pair() {
  std::array<char, kKeyChars + 1> public_key{};
  std::array<char, kKeyChars + 1> secret{};
  CHECK(::zmq_curve_keypair(public_key.data(), secret.data()) == 0);
  KeyPair pair{public_key.data(), SecretKey{std::string_view(secret.data(), kKeyChars)}};
  ::explicit_bzero(secret.data(), secret.size());
  return pair;
}

std::optional<PublicKey> public_key_of(const SecretKey& secret) {
  if (!is_key(secret.c_str())) { return std::nullopt; }
  std::array<char, kKeyChars + 1> public_key{};
  if (::zmq_curve_public(public_key.data(), secret.c_str()) != 0) { return std::nullopt; }
  return PublicKey(public_key.data());
}

bool is_key(std::string_view text) {
  if (text.size() != kKeyChars) { return false; }
  std::array<char, kKeyChars + 1> ended{};
  std::copy(text.begin(), text.end(), ended.begin());
  std::array<std::uint8_t, 32> bytes{};
  const bool good = ::zmq_z85_decode(bytes.data(), ended.data()) != nullptr;
  // It may be a secret.
  ::explicit_bzero(ended.data(), ended.size());
  ::explicit_bzero(bytes.data(), bytes.size());
  return good;
}

std::uint64_t random_bits() {
  std::random_device device;
  return (std::uint64_t{device()} << 32) | device();
}

SessionId random_session() { return {random_bits(), random_bits()}; }

}  // namespace preheat
