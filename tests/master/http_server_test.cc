#include "master/http_server.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <thread>
#include <vector>

#include "tests/master/raw_client.h"

namespace preheat {
namespace {

using std::chrono::milliseconds;
using ::testing::HasSubstr;
using ::testing::StartsWith;

class Sockets {
 public:
  ~Sockets() {
    for (const int socket : list_) { ::close(socket); }
  }
  int add(unsigned port, unsigned from = 1) {
    list_.push_back(connect_raw(port, from));
    return list_.back();
  }

 private:
  std::vector<int> list_;
};

class HttpServerTest : public ::testing::Test {
 protected:
  // No time limit but where one is tested: the machine may be busy.
  static HttpLimits patient() {
    HttpLimits limits;
    limits.connection_max = std::chrono::hours(1);
    return limits;
  }
  void start(const HttpLimits& limits = patient()) {
    auto server = HttpServer::start(
        {"127.0.0.1", 0},
        [this](const HttpRequest& request) {
          ++answered_;
          return request.path == "/large" ? HttpResponse{200, "text/plain", large_}
                                          : text_response(200, "at " + request.path + "\n");
        },
        limits);
    ASSERT_TRUE(server.has_value()) << server.error().message;
    server_ = *std::move(server);
  }
  [[nodiscard]] unsigned port() const { return server_->endpoint().port; }

  std::atomic<int> answered_{0};
  std::shared_ptr<const std::string> large_ =
      std::make_shared<const std::string>(std::size_t{4} << 20, 'x');
  std::unique_ptr<HttpServer> server_{};
};

TEST_F(HttpServerTest, AnswersOneRequestAConnection) {
  start();

  const std::string answer = test::get(port(), "/a?b");

  EXPECT_THAT(answer, StartsWith("HTTP/1.1 200 OK\r\n"));
  EXPECT_EQ(test::body_of(answer), "at /a\n");
}

TEST_F(HttpServerTest, ReadsARequestThatComesInPieces) {
  start();
  Sockets sockets;
  const int socket = sockets.add(port());
  for (const char* piece : {"GE", "T /slow HTTP/1.1\r", "\nHost: 127.0.0.1\r\n\r", "\n"}) {
    ASSERT_TRUE(test::send_all(socket, piece));
    std::this_thread::sleep_for(milliseconds(20));
  }

  EXPECT_EQ(test::body_of(test::read_all(socket)), "at /slow\n");
}

TEST_F(HttpServerTest, SendsALargeAnswerWholeToWhoSentTooMuch) {
  start();
  Sockets sockets;
  const int socket = sockets.add(port());
  ASSERT_TRUE(test::send_all(socket, "GET /large HTTP/1.0\r\n\r\n" + std::string(3000, 'y')));

  EXPECT_EQ(test::body_of(test::read_all(socket)).size(), large_->size());
}

TEST_F(HttpServerTest, AnswersNoOtherHost) {
  start();

  EXPECT_THAT(test::get(port(), "/", "evil.example"), StartsWith("HTTP/1.1 403 "));
  EXPECT_EQ(answered_, 0);
}

TEST_F(HttpServerTest, RefusesWhatIsNoRequest) {
  start();
  Sockets sockets;
  const int socket = sockets.add(port());
  test::send_all(socket, std::string(20'000, 'a'));

  EXPECT_THAT(test::read_all(socket), StartsWith("HTTP/1.1 431 "));
  EXPECT_EQ(answered_, 0);
}

TEST_F(HttpServerTest, SilentClientsKeepNobodyOut) {
  HttpLimits limits = patient();
  limits.connections_max = 4;
  limits.patience = milliseconds(50);
  start(limits);
  Sockets silent;
  for (int i = 0; i < 40; ++i) { silent.add(port()); }

  for (int i = 0; i < 10; ++i) { EXPECT_EQ(test::body_of(test::get(port(), "/")), "at /\n") << i; }
}

TEST_F(HttpServerTest, ClientsThatDoNotReadKeepNobodyOut) {
  HttpLimits limits = patient();
  limits.connections_max = 4;
  limits.patience = milliseconds(50);
  start(limits);
  Sockets deaf;
  for (int i = 0; i < 12; ++i) {
    test::send_all(deaf.add(port()), "GET /large HTTP/1.1\r\nHost: localhost\r\n\r\n");
  }

  for (int i = 0; i < 5; ++i) { EXPECT_EQ(test::body_of(test::get(port(), "/")), "at /\n") << i; }
}

TEST_F(HttpServerTest, AnAddressWithAllItsPlacesIsToldSoAndOthersAreServed) {
  HttpLimits limits = patient();
  limits.connections_max = 8;
  limits.connections_per_address_max = 3;
  limits.patience = std::chrono::hours(1);
  start(limits);
  Sockets greedy;
  for (int i = 0; i < 3; ++i) { greedy.add(port(), /*from=*/2); }

  EXPECT_THAT(test::read_all(greedy.add(port(), 2)), StartsWith("HTTP/1.1 503 "));
  EXPECT_THAT(test::read_all(greedy.add(port(), 2)), HasSubstr("from your address"));
  EXPECT_EQ(test::body_of(test::get(port(), "/")), "at /\n");
  EXPECT_EQ(answered_, 1);
}

TEST_F(HttpServerTest, AnAddressGivesUpItsOwnSilentConnections) {
  HttpLimits limits = patient();
  limits.connections_max = 8;
  limits.connections_per_address_max = 2;
  limits.patience = milliseconds(0);
  start(limits);
  Sockets sockets;
  const int neighbour = sockets.add(port(), /*from=*/3);
  for (int i = 0; i < 5; ++i) { sockets.add(port(), 2); }
  const int last = sockets.add(port(), 2);
  test::send_all(last, "GET /last HTTP/1.0\r\n\r\n");
  test::send_all(neighbour, "GET /neighbour HTTP/1.0\r\n\r\n");

  EXPECT_EQ(test::body_of(test::read_all(last)), "at /last\n");
  EXPECT_EQ(test::body_of(test::read_all(neighbour)), "at /neighbour\n");
}

TEST_F(HttpServerTest, ConnectionsHaveAnEnd) {
  HttpLimits limits;
  limits.connection_max = milliseconds(200);
  start(limits);
  Sockets sockets;
  const int socket = sockets.add(port());
  // A byte now and then does not buy more time.
  bool ended = false;
  for (int i = 0; i < 200 && !ended; ++i) {
    ended = !test::send_all(socket, "G");
    std::this_thread::sleep_for(milliseconds(50));
  }

  EXPECT_TRUE(ended);
  EXPECT_EQ(answered_, 0);
}

TEST_F(HttpServerTest, ManyClientsAtOnceAreAllAnswered) {
  start();
  std::atomic<int> good{0};
  std::vector<std::thread> clients;
  for (int client = 0; client < 8; ++client) {
    clients.emplace_back([&] {
      for (int i = 0; i < 25; ++i) {
        good += test::body_of(test::get(port(), "/x")) == "at /x\n" ? 1 : 0;
      }
    });
  }
  for (std::thread& client : clients) { client.join(); }

  EXPECT_EQ(good, 200);
}

TEST_F(HttpServerTest, APortThatIsTakenIsAnErrorThatNamesIt) {
  start();

  const auto second =
      HttpServer::start(server_->endpoint(), [](const HttpRequest&) { return HttpResponse{}; });

  ASSERT_FALSE(second.has_value());
  EXPECT_EQ(second.error().code, ExitCode::kUsage);
  EXPECT_THAT(second.error().message, HasSubstr("127.0.0.1:" + std::to_string(port())));
}

}  // namespace
}  // namespace preheat
