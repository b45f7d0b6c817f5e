#include "master/http_server.h"

#include <poll.h>
#include <sys/eventfd.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cerrno>
#include <cstddef>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "common/clock.h"
#include "master/tcp_socket.h"

namespace preheat {
namespace {

constexpr int kPollMs = 100;
constexpr int kNice = 5;
// Newcomers between two looks at those who are there.
constexpr int kAcceptedAtOnce = 64;

std::string refusal_bytes() {
  return response_bytes(
      text_response(503, "too many connections from your address: try again in a second\n"), false);
}

}  // namespace

class HttpServer::Impl {
 public:
  Impl(Descriptor listener, Endpoint endpoint, Handler handler, const HttpLimits& limits)
      : listener_(std::move(listener)),
        endpoint_(std::move(endpoint)),
        handler_(std::move(handler)),
        limits_(limits),
        stop_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
    endpoint_.port = port_of(listener_);
    thread_ = std::thread([this] { run(); });
  }
  ~Impl() {
    stopping_ = true;
    const std::uint64_t one = 1;
    // Should the event be lost, the thread still looks at the flag between two polls.
    [[maybe_unused]] const ssize_t written = ::write(stop_.number(), &one, sizeof one);
    thread_.join();
  }
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  [[nodiscard]] const Endpoint& endpoint() const { return endpoint_; }

 private:
  enum class Stage { kReading, kWriting, kLeaving };
  struct Connection {
    Descriptor socket{};
    HeldConnection held{};
    Stage stage = Stage::kReading;
    std::string in{};
    std::string out{};
    std::size_t written = 0;
    bool over = false;
  };

  void run() {
    // Of this thread alone, on Linux: the render comes first.
    ::setpriority(PRIO_PROCESS, 0, kNice);
    while (!stopping_) {
      const std::vector<pollfd> ready = wait();
      const Time now = Clock::now();
      for (std::size_t i = 0; i < connections_.size(); ++i) {
        Connection& connection = connections_[i];
        const short events = ready[i + 2].revents;
        if (events != 0) { serve(connection); }
        if (now - connection.held.begin >= limits_.connection_max) { connection.over = true; }
      }
      std::erase_if(connections_, [](const Connection& connection) { return connection.over; });
      if (ready[1].revents != 0) { accept_some(now); }
    }
  }

  // [0] is the end, [1] the listener, then the connections.
  std::vector<pollfd> wait() {
    std::vector<pollfd> sockets{{stop_.number(), POLLIN, 0}, {listener_.number(), POLLIN, 0}};
    if (must_wait(held(), Clock::now(), limits_)) { sockets[1].fd = -1; }
    for (const Connection& connection : connections_) {
      const short events = connection.stage == Stage::kWriting ? POLLOUT : POLLIN;
      sockets.push_back({connection.socket.number(), events, 0});
    }
    ::poll(sockets.data(), sockets.size(), kPollMs);
    return sockets;
  }

  [[nodiscard]] std::vector<HeldConnection> held() const {
    std::vector<HeldConnection> held;
    for (const Connection& connection : connections_) { held.push_back(connection.held); }
    return held;
  }

  void accept_some(Time now) {
    for (int i = 0; i < kAcceptedAtOnce && !must_wait(held(), now, limits_); ++i) {
      sockaddr_storage peer{};
      socklen_t length = sizeof peer;
      Descriptor socket(::accept4(listener_.number(), reinterpret_cast<sockaddr*>(&peer), &length,
                                  SOCK_NONBLOCK | SOCK_CLOEXEC));
      if (!socket.is_open()) { return; }
      const ClientAddress address = client_address(peer);
      const AdmissionDecision decision = admit(held(), address, now, limits_);
      if (decision.what == Admission::kRefuse) {
        refuse(socket);
        continue;
      }
      if (decision.what == Admission::kReplace) {
        connections_.erase(connections_.begin() + static_cast<std::ptrdiff_t>(decision.replaced));
      }
      connections_.push_back({});
      connections_.back().socket = std::move(socket);
      connections_.back().held = {address, now};
    }
  }

  // At once and without a place, so as well as it goes: what the client has sent by now is read,
  // what it sends later resets the connection.
  static void refuse(const Descriptor& socket) {
    std::array<char, 4096> buffer{};
    [[maybe_unused]] const ssize_t read = ::recv(socket.number(), buffer.data(), buffer.size(), 0);
    const std::string bytes = refusal_bytes();
    [[maybe_unused]] const ssize_t sent =
        ::send(socket.number(), bytes.data(), bytes.size(), MSG_NOSIGNAL);
    ::shutdown(socket.number(), SHUT_WR);
  }

  void serve(Connection& connection) {
    switch (connection.stage) {
      case Stage::kReading:
        read(connection);
        return;
      case Stage::kWriting:
        write(connection);
        return;
      case Stage::kLeaving:
        // What the client still sends is thrown away: closing with unread bytes would reset the
        // connection and could take the answer with it.
        connection.over = receive(connection) != Reception::kMore;
        return;
    }
  }

  enum class Reception { kMore, kEnd };
  Reception receive(Connection& connection) {
    std::array<char, 4096> buffer{};
    const ssize_t count = ::recv(connection.socket.number(), buffer.data(), buffer.size(), 0);
    if (count > 0) {
      if (connection.stage == Stage::kReading) {
        connection.in.append(buffer.data(), static_cast<std::size_t>(count));
      }
      return Reception::kMore;
    }
    const bool later = count < 0 && (errno == EAGAIN || errno == EINTR);
    return later ? Reception::kMore : Reception::kEnd;
  }

  void read(Connection& connection) {
    if (receive(connection) == Reception::kEnd) {
      connection.over = true;
      return;
    }
    ParsedRequest parsed = parse_request(connection.in);
    if (!parsed.request && !parsed.refusal) { return; }
    connection.out = parsed.request
                         ? response_bytes(answer(*parsed.request), parsed.request->head_only)
                         : response_bytes(*parsed.refusal, false);
    connection.in = {};
    connection.stage = Stage::kWriting;
    write(connection);
  }

  HttpResponse answer(const HttpRequest& request) const {
    // HTTP/1.0 has no Host, and no browser speaks it.
    if (!request.host.empty() && !is_own_host(request.host, endpoint_.host)) {
      return text_response(403, "this page answers to addresses and this machine's own names\n");
    }
    return handler_(request);
  }

  static void write(Connection& connection) {
    const ssize_t count =
        ::send(connection.socket.number(), connection.out.data() + connection.written,
               connection.out.size() - connection.written, MSG_NOSIGNAL);
    if (count < 0) {
      connection.over = errno != EAGAIN && errno != EINTR;
      return;
    }
    connection.written += static_cast<std::size_t>(count);
    if (connection.written < connection.out.size()) { return; }
    connection.out = {};
    ::shutdown(connection.socket.number(), SHUT_WR);
    connection.stage = Stage::kLeaving;
  }

  Descriptor listener_;
  Endpoint endpoint_;
  Handler handler_;
  HttpLimits limits_;
  Descriptor stop_;
  std::atomic<bool> stopping_{false};
  std::vector<Connection> connections_;  // in the order in which they came
  std::thread thread_;
};

HttpServer::HttpServer(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
HttpServer::~HttpServer() = default;

Result<std::unique_ptr<HttpServer>> HttpServer::start(const Endpoint& listen, Handler handler,
                                                      const HttpLimits& limits) {
  Result<Descriptor> listener = listen_at(listen);
  if (!listener) { return tl::unexpected(listener.error()); }
  return std::unique_ptr<HttpServer>(new HttpServer(
      std::make_unique<Impl>(*std::move(listener), listen, std::move(handler), limits)));
}

const Endpoint& HttpServer::endpoint() const { return impl_->endpoint(); }

}  // namespace preheat
