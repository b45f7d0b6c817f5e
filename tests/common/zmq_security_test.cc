// Who gets a byte through to a transport with keys: only those on its list.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/time.h>

#include <array>
#include <atomic>
#include <chrono>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>
#include <zmq.hpp>

#include "common/clock.h"
#include "common/codec.h"
#include "common/zmq_transport.h"
#include "tests/common/raw_connection.h"

namespace preheat {
namespace {

using std::chrono::milliseconds;
using ::testing::HasSubstr;

constexpr std::chrono::seconds kPatience{20};

KeyPair copy_of(const KeyPair& pair) {
  return {pair.public_key, SecretKey{std::string_view(pair.secret.c_str(), kKeyChars)}};
}

bool until(const std::function<bool()>& done) {
  const Time end = Clock::now() + kPatience;
  while (Clock::now() < end) {
    if (done()) { return true; }
    ::usleep(1000);
  }
  return false;
}

// A master that lists one worker.
class Gate : public ::testing::Test {
 protected:
  void SetUp() override { open({}); }

  void open(std::function<std::optional<KeyRole>(std::string_view)> admit) {
    Keys keys{KeyRole::kMaster, copy_of(master_), master_.public_key, {worker_.public_key}};
    allowed_ = std::make_shared<AllowList>(keys);
    TransportSecurity security = secure_with(std::move(keys), allowed_);
    if (admit) { security.admit = std::move(admit); }
    server_transport_ = make_zmq_transport(std::move(security));
    auto server = server_transport_->listen("tcp://127.0.0.1:*", ChannelKind::kControl);
    ASSERT_TRUE(server.has_value()) << server.error().message;
    server_ = std::move(*server);
  }

  // What connects: its transport lives as long as its channel.
  struct Peer {
    std::unique_ptr<Transport> transport{};
    std::unique_ptr<Channel> channel{};
    SessionId session{};

    [[nodiscard]] bool send() {
      return channel->send({}, encode_frame({}, Unknown{}), {}) == SendOutcome::kSent;
    }
    [[nodiscard]] bool refused() { return !channel->handshakes().refused.empty(); }
    [[nodiscard]] bool broken() { return channel->handshakes().broken > 0; }
  };

  Peer connect(std::optional<TransportSecurity> security) {
    Peer peer{make_zmq_transport(std::move(security)), {}, random_session()};
    peer.channel =
        *peer.transport->connect(server_->endpoint(), ChannelKind::kControl, peer.session);
    return peer;
  }
  Peer connect_with(const KeyPair& own, const PublicKey& master) {
    Keys keys{KeyRole::kWorker, copy_of(own), master, {}};
    auto allowed = std::make_shared<AllowList>(keys);
    return connect(secure_with(std::move(keys), allowed));
  }
  Peer connect_worker() { return connect_with(worker_, master_.public_key); }

  // One that is listed gets through, and what it sends is the first thing that the server hears.
  void expect_heard_first(Peer& good, KeyRole role) {
    ASSERT_TRUE(until([&] { return good.send(); }));
    std::optional<Received> received;
    ASSERT_TRUE(until([&] { return (received = server_->receive()).has_value(); }));
    EXPECT_EQ(received->session, good.session);
    EXPECT_EQ(received->role, role);
    EXPECT_FALSE(server_->receive().has_value());
    EXPECT_EQ(server_->dropped(), 0U);
  }

  KeyPair master_ = make_key_pair();
  KeyPair worker_ = make_key_pair();
  std::shared_ptr<AllowList> allowed_{};
  std::unique_ptr<Transport> server_transport_{};
  std::unique_ptr<Channel> server_{};
};

TEST_F(Gate, OpensForAListedWorker) {
  Peer worker = connect_worker();

  expect_heard_first(worker, KeyRole::kWorker);
  EXPECT_EQ(server_transport_->denied(), 0U);
}

TEST_F(Gate, TellsTheMastersOwnKeyFromAWorkers) {
  Peer status = connect_with(master_, master_.public_key);

  expect_heard_first(status, KeyRole::kMaster);
}

TEST_F(Gate, StaysClosedForAnUnlistedKeyAndSaysSo) {
  Peer stranger = connect_with(make_key_pair(), master_.public_key);

  ASSERT_TRUE(until([&] { return stranger.refused(); }));
  EXPECT_FALSE(stranger.send());
  EXPECT_THAT(stranger.channel->handshakes().refused, HasSubstr("does not list"));
  EXPECT_GE(server_transport_->denied(), 1U);
  Peer worker = connect_worker();
  expect_heard_first(worker, KeyRole::kWorker);
}

TEST_F(Gate, StaysClosedWhenNobodyIsListed) {
  allowed_->set_workers({});
  Peer worker = connect_worker();

  ASSERT_TRUE(until([&] { return worker.refused(); }));
  EXPECT_FALSE(worker.send());
  EXPECT_GE(server_transport_->denied(), 1U);
}

TEST_F(Gate, StaysClosedForOneWithoutAKeyWhichLearnsWhy) {
  Peer stranger = connect(std::nullopt);

  ASSERT_TRUE(until([&] { return stranger.refused(); }));
  EXPECT_FALSE(stranger.send());
  EXPECT_THAT(stranger.channel->handshakes().refused, HasSubstr("only one of both sides"));
  Peer worker = connect_worker();
  expect_heard_first(worker, KeyRole::kWorker);
}

TEST_F(Gate, AWorkerDoesNotTalkToAMasterThatIsNotItsOwn) {
  Peer worker = connect_with(worker_, make_key_pair().public_key);

  ASSERT_TRUE(until([&] { return worker.broken(); }));
  EXPECT_FALSE(worker.send());
  EXPECT_FALSE(server_->receive().has_value());
}

TEST_F(Gate, AWorkerWithKeysDoesNotTalkToAMasterWithout) {
  server_.reset();
  server_transport_ = make_zmq_transport();
  server_ = *server_transport_->listen("tcp://127.0.0.1:*", ChannelKind::kControl);
  Peer worker = connect_worker();

  ASSERT_TRUE(until([&] { return worker.refused(); }));
  EXPECT_FALSE(worker.send());
  EXPECT_FALSE(server_->receive().has_value());
}

TEST_F(Gate, StaysClosedForAPassword) {
  zmq::context_t context{1};
  zmq::socket_t socket{context, zmq::socket_type::dealer};
  socket.set(zmq::sockopt::linger, 0);
  socket.set(zmq::sockopt::immediate, true);
  socket.set(zmq::sockopt::plain_username, "worker");
  socket.set(zmq::sockopt::plain_password, worker_.public_key);
  socket.connect(server_->endpoint());

  // Nothing tells this socket what became of it: it has as long as the good one needs.
  Peer worker = connect_worker();
  expect_heard_first(worker, KeyRole::kWorker);
  EXPECT_FALSE(socket.send(zmq::str_buffer("hello"), zmq::send_flags::dontwait).has_value());
}

// What other programs, and older ZeroMQ, say first.
std::string greeting_of_version(char version) {
  std::string greeting = {'\xff', 0, 0, 0, 0, 0, 0, 0, 1, '\x7f', version, 0};
  greeting.resize(64, '\0');
  return greeting;
}

TEST_F(Gate, StaysClosedForOlderProtocolsAndForOtherOnes) {
  const std::string id(17, 'C');
  const std::vector<std::string> first_words = {
      // ZMTP 1.0: length, flags, identity; then a message.
      std::string{'\x12', '\0'} + id + std::string{'\x03', '\0', 'h', 'i'},
      // ZMTP 2.0: signature, revision, socket type DEALER, identity, message.
      std::string{'\xff', 0, 0, 0, 0, 0, 0, 0, 1, '\x7f', 1, 5, 0, 17} + id +
          std::string{0, 2, 'h', 'i'},
      greeting_of_version(3),  // with mechanism ""
      "GET / HTTP/1.1\r\nHost: localhost\r\n\r\n", std::string(64, '\xff')};
  const Endpoint endpoint = *parse_endpoint(server_->endpoint());
  for (const std::string& words : first_words) {
    const int fd = connect_raw(endpoint.port);
    ASSERT_GE(fd, 0);
    ASSERT_EQ(::send(fd, words.data(), words.size(), MSG_NOSIGNAL),
              static_cast<ssize_t>(words.size()));
    const timeval patience{20, 0};
    ::setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
    std::array<char, 256> answer{};
    ssize_t got = 0;
    while ((got = ::recv(fd, answer.data(), answer.size(), 0)) > 0) {}
    // Closed by the server, by word or by force.
    EXPECT_TRUE(got == 0 || errno == ECONNRESET) << "first byte " << int{words[0]};
    ::close(fd);
  }

  Peer worker = connect_worker();
  expect_heard_first(worker, KeyRole::kWorker);
}

TEST_F(Gate, NobodyEntersWhileItsKeeperHangs) {
  std::atomic<bool> hangs{false};
  std::atomic<bool> asked{false};
  open([&](std::string_view key) {
    if (hangs) { asked = true; }
    while (hangs) { std::this_thread::sleep_for(milliseconds(1)); }
    return allowed_->role_of(key);
  });
  hangs = true;
  Peer worker = connect_worker();

  ASSERT_TRUE(until([&] { return asked.load(); }));
  ASSERT_TRUE(
      until([&] { return worker.broken(); }));  // given up after the handshake's two seconds
  EXPECT_FALSE(worker.send());
  EXPECT_FALSE(server_->receive().has_value());

  hangs = false;
  expect_heard_first(worker, KeyRole::kWorker);
}

TEST_F(Gate, NobodyEntersWhenItsKeeperHasDied) {
  std::atomic<bool> dies{false};
  std::atomic<bool> died{false};
  open([&](std::string_view key) {
    if (dies) {
      died = true;
      throw std::runtime_error("killed by the test");
    }
    return allowed_->role_of(key);
  });
  dies = true;
  Peer first = connect_worker();
  ASSERT_TRUE(until([&] { return died.load(); }));
  dies = false;
  Peer second = connect_worker();

  ASSERT_TRUE(until([&] { return second.broken(); }));
  EXPECT_FALSE(first.send());
  EXPECT_FALSE(second.send());
  EXPECT_FALSE(server_->receive().has_value());
}

TEST_F(Gate, DoesNotOpenAtAllWhenItLetsStrangersIn) {
  Keys keys{KeyRole::kMaster, copy_of(master_), master_.public_key, {}};
  const auto transport = make_zmq_transport(
      TransportSecurity{std::move(keys), [](std::string_view) { return KeyRole::kWorker; }});

  const auto server = transport->listen("tcp://127.0.0.1:*", ChannelKind::kControl);

  ASSERT_FALSE(server.has_value());
  EXPECT_THAT(server.error().message, HasSubstr("self-test"));
  // Nor for one who asks again.
  EXPECT_FALSE(transport->listen("tcp://127.0.0.1:*", ChannelKind::kPeer).has_value());
}

TEST_F(Gate, OfAWorkerOpensForItsPeersOnly) {
  const auto keys_of = [](const KeyPair& own) {
    return Keys{KeyRole::kWorker, copy_of(own), make_key_pair().public_key, {own.public_key}};
  };
  const auto transport_of = [&keys_of](const KeyPair& own) {
    Keys keys = keys_of(own);
    auto allowed = std::make_shared<AllowList>(keys);
    return make_zmq_transport(secure_with(std::move(keys), allowed));
  };
  const auto serving = transport_of(worker_);
  const auto server = *serving->listen("tcp://127.0.0.1:*", ChannelKind::kPeer);
  const auto asking = transport_of(worker_);
  const auto peer = *asking->connect(server->endpoint(), ChannelKind::kPeer, random_session());
  const auto elsewhere = transport_of(make_key_pair());
  const auto stranger =
      *elsewhere->connect(server->endpoint(), ChannelKind::kPeer, random_session());

  const std::vector<std::byte> frame = encode_frame({}, Unknown{});
  ASSERT_TRUE(until([&] { return peer->send({}, frame, {}) == SendOutcome::kSent; }));
  std::optional<Received> received;
  ASSERT_TRUE(until([&] { return (received = server->receive()).has_value(); }));
  EXPECT_EQ(received->role, KeyRole::kWorker);
  ASSERT_TRUE(until([&] { return stranger->handshakes().broken > 0; }));
  EXPECT_EQ(stranger->send({}, frame, {}), SendOutcome::kFull);
}

TEST_F(Gate, AKeyThatIsStruckOffIsNotHeardAnyMore) {
  Peer worker = connect_worker();
  expect_heard_first(worker, KeyRole::kWorker);

  allowed_->set_workers({});
  ASSERT_TRUE(until([&] { return worker.send(); }));

  ASSERT_TRUE(until([&] {
    EXPECT_FALSE(server_->receive().has_value());
    return server_->dropped() == 1U;
  }));
}

}  // namespace
}  // namespace preheat
