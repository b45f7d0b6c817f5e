#include "common/zmq_transport.h"

#include <gtest/gtest.h>

#include <array>
#include <atomic>
#include <vector>

#include "common/clock.h"
#include "common/codec.h"
#include "tests/common/raw_connection.h"

namespace preheat {
namespace {

using std::chrono::milliseconds;

// The next message within ten seconds.
std::optional<Received> receive(Transport& transport, Channel& channel) {
  const Time end = Clock::now() + std::chrono::seconds(10);
  while (Clock::now() < end) {
    if (auto received = channel.receive()) { return received; }
    const std::array<Channel*, 1> channels{&channel};
    transport.wait(channels, -1, milliseconds(100));
  }
  return std::nullopt;
}

// A connecting channel takes nothing before its connection stands.
SendOutcome send_when_connected(Channel& channel, const std::vector<std::byte>& head) {
  const Time end = Clock::now() + std::chrono::seconds(10);
  SendOutcome outcome = SendOutcome::kFull;
  while (outcome == SendOutcome::kFull && Clock::now() < end) {
    outcome = channel.send({}, head, {});
    ::usleep(1000);
  }
  return outcome;
}

TEST(ZmqTransport, TakesNothingForAMasterThatIsNotThere) {
  const auto transport = make_zmq_transport();
  const auto client =
      transport->connect("tcp://127.0.0.1:1", ChannelKind::kControl, random_session());
  ASSERT_TRUE(client.has_value());

  EXPECT_EQ((*client)->send({}, encode_frame({}, Unknown{}), {}), SendOutcome::kFull);
}

TEST(ZmqTransport, CarriesHeadAndDataBothWays) {
  const auto transport = make_zmq_transport();
  const auto server = transport->listen("tcp://127.0.0.1:*", ChannelKind::kBulk);
  ASSERT_TRUE(server.has_value());
  const SessionId session = random_session();
  const auto client = transport->connect((*server)->endpoint(), ChannelKind::kBulk, session);
  ASSERT_TRUE(client.has_value());
  const std::vector<std::byte> head = encode_frame({}, Unknown{});
  auto data = std::make_shared<std::vector<std::byte>>(kChunkBytesMax, std::byte{7});
  std::atomic<bool> released = false;
  const std::shared_ptr<const void> owner(data.get(),
                                          [data, &released](const void*) { released = true; });

  ASSERT_EQ(send_when_connected(**client, head), SendOutcome::kSent);
  const auto there = receive(*transport, **server);
  ASSERT_TRUE(there.has_value());
  ASSERT_EQ((*server)->send(there->session, head, Payload{*data, owner}), SendOutcome::kSent);
  const auto back = receive(*transport, **client);

  EXPECT_EQ(there->session, session);
  EXPECT_TRUE(there->data.bytes.empty());
  ASSERT_TRUE(back.has_value());
  EXPECT_TRUE(
      std::equal(head.begin(), head.end(), back->head.bytes.begin(), back->head.bytes.end()));
  EXPECT_TRUE(
      std::equal(data->begin(), data->end(), back->data.bytes.begin(), back->data.bytes.end()));
}

TEST(ZmqTransport, SaysThatAPeerIsGone) {
  const auto transport = make_zmq_transport();
  const auto server = transport->listen("tcp://127.0.0.1:*", ChannelKind::kControl);
  ASSERT_TRUE(server.has_value());

  EXPECT_EQ((*server)->send(random_session(), encode_frame({}, Unknown{}), {}), SendOutcome::kGone);
}

TEST(ZmqTransport, AUsedPortIsAUsageErrorThatNamesIt) {
  const auto transport = make_zmq_transport();
  const auto first = transport->listen("tcp://127.0.0.1:*", ChannelKind::kControl);
  ASSERT_TRUE(first.has_value());

  const auto second = make_zmq_transport()->listen((*first)->endpoint(), ChannelKind::kControl);

  ASSERT_FALSE(second.has_value());
  EXPECT_EQ(second.error().code, ExitCode::kUsage);
  EXPECT_NE(second.error().message.find((*first)->endpoint()), std::string::npos);
  EXPECT_NE(second.error().message.find("Address already in use"), std::string::npos);
}

TEST(ZmqTransport, NamesAnIpv4EndpointAsItWasGiven) {
  const auto server = make_zmq_transport()->listen("tcp://127.0.0.1:*", ChannelKind::kControl);

  ASSERT_TRUE(server.has_value());
  EXPECT_TRUE((*server)->endpoint().starts_with("tcp://127.0.0.1:")) << (*server)->endpoint();
}

// Containers often come without.
bool has_ipv6_loopback() {
  const int fd = ::socket(AF_INET6, SOCK_STREAM, 0);
  if (fd < 0) { return false; }
  sockaddr_in6 address{};
  address.sin6_family = AF_INET6;
  address.sin6_addr = in6addr_loopback;
  const bool bound = ::bind(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0;
  ::close(fd);
  return bound;
}

TEST(ZmqTransport, ListensOnIpv6Loopback) {
  if (!has_ipv6_loopback()) { GTEST_SKIP() << "this machine has no [::1]"; }
  const auto server = make_zmq_transport()->listen("tcp://[::1]:*", ChannelKind::kControl);

  ASSERT_TRUE(server.has_value()) << server.error().message;
  EXPECT_TRUE((*server)->endpoint().starts_with("tcp://[::1]:"));
}

TEST(ZmqTransport, AStrangersBytesDoNotDisturbAGoodPeer) {
  const auto transport = make_zmq_transport();
  const auto server = transport->listen("tcp://127.0.0.1:*", ChannelKind::kControl);
  ASSERT_TRUE(server.has_value());
  const Endpoint endpoint = *parse_endpoint((*server)->endpoint());
  std::vector<int> strangers;
  for (int i = 0; i < 20; ++i) {
    const int fd = connect_raw(endpoint.port);
    ASSERT_GE(fd, 0);
    const std::string garbage(1000, static_cast<char>(i * 13));
    EXPECT_EQ(::send(fd, garbage.data(), garbage.size(), MSG_NOSIGNAL), 1000);
    strangers.push_back(fd);
  }

  // One that speaks ZeroMQ but sends under no session of ours, and one that is good.
  const SessionId session = random_session();
  const auto wrong_kind =
      transport->connect((*server)->endpoint(), ChannelKind::kBulk, random_session());
  const auto good = transport->connect((*server)->endpoint(), ChannelKind::kControl, session);
  const std::vector<std::byte> head = encode_frame({}, Unknown{});
  ASSERT_EQ(send_when_connected(**wrong_kind, head), SendOutcome::kSent);
  ASSERT_EQ(send_when_connected(**good, head), SendOutcome::kSent);
  const auto received = receive(*transport, **server);

  ASSERT_TRUE(received.has_value());
  EXPECT_EQ(received->session, session);
  for (const int fd : strangers) { ::close(fd); }
}

}  // namespace
}  // namespace preheat
