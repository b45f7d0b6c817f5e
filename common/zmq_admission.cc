#include "common/zmq_admission.h"

#include <pthread.h>
#include <spdlog/spdlog.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <array>
#include <csignal>
#include <exception>
#include <utility>

#include "common/check.h"

namespace preheat {
namespace {

constexpr std::size_t kKeyBytes = 32;
constexpr std::uint64_t kDenialsLogged = 20;  // then every hundredth: strangers may be many

// A request, RFC 27: version, request id, domain, address, identity, mechanism, credentials.
enum Part : std::size_t { kVersion, kRequest, kDomain, kAddress, kIdentity, kMechanism, kKey };
constexpr std::size_t kParts = kKey + 1;

// What came in so many parts; more than fit are counted and dropped.
std::size_t receive_parts(zmq::socket_t& socket, std::array<zmq::message_t, kParts>& parts) {
  std::size_t count = 0;
  for (bool more = true; more; ++count) {
    zmq::message_t surplus;
    zmq::message_t& part = count < kParts ? parts[count] : surplus;
    CHECK(socket.recv(part).has_value());
    more = part.more();
  }
  return count;
}

}  // namespace

ZmqAdmission::ZmqAdmission(zmq::context_t& context, Admit admit)
    : admit_(std::move(admit)),
      socket_(context, zmq::socket_type::rep),
      stop_fd_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
  CHECK(stop_fd_ >= 0);
  socket_.set(zmq::sockopt::linger, 0);
  socket_.bind("inproc://zeromq.zap.01");
  thread_ = std::thread([this] { serve(); });
}

ZmqAdmission::~ZmqAdmission() {
  const std::uint64_t one = 1;
  static_cast<void>(!::write(stop_fd_, &one, sizeof one));
  thread_.join();
  ::close(stop_fd_);
}

void ZmqAdmission::serve() noexcept {
  // Signals are for the program's own threads: here one would end a wait like an error.
  sigset_t all;
  sigfillset(&all);
  ::pthread_sigmask(SIG_BLOCK, &all, nullptr);
  try {
    for (;;) {
      std::array<zmq::pollitem_t, 2> items{
          {{socket_.handle(), 0, ZMQ_POLLIN, 0}, {nullptr, stop_fd_, ZMQ_POLLIN, 0}}};
      zmq::poll(items);
      if ((items[1].revents & ZMQ_POLLIN) != 0) { return; }
      if ((items[0].revents & ZMQ_POLLIN) != 0) { answer(); }
    }
  } catch (const std::exception& error) {
    spdlog::error("event=admission_ended reason=\"{}\" consequence=\"nobody enters any more\"",
                  error.what());
  } catch (...) { spdlog::error("event=admission_ended consequence=\"nobody enters any more\""); }
}

void ZmqAdmission::answer() {
  std::array<zmq::message_t, kParts> parts;
  const bool sound = receive_parts(socket_, parts) == kParts &&
                     parts[kMechanism].to_string_view() == "CURVE" &&
                     parts[kKey].size() == kKeyBytes;
  std::array<char, kKeyChars + 1> key{};
  if (sound) { ::zmq_z85_encode(key.data(), parts[kKey].data<std::uint8_t>(), kKeyBytes); }
  const bool enters = sound && admit_(std::string_view(key.data(), kKeyChars)).has_value();
  if (!enters && counting_.load()) {
    const std::uint64_t count = ++denied_;
    if (count <= kDenialsLogged || count % 100 == 0) {
      spdlog::warn("event=connection_denied address={} key=\"{}\" count={}",
                   parts[kAddress].to_string_view(), key.data(), count);
    }
  }
  const std::string_view user = enters ? std::string_view(key.data(), kKeyChars) : "";
  const std::array<std::string_view, 6> reply = {"1.0",
                                                 parts[kRequest].to_string_view(),
                                                 enters ? "200" : "400",
                                                 enters ? "OK" : "not listed",
                                                 user,
                                                 ""};
  for (std::size_t i = 0; i < reply.size(); ++i) {
    const auto flags = i + 1 < reply.size() ? zmq::send_flags::sndmore : zmq::send_flags::none;
    static_cast<void>(socket_.send(zmq::buffer(reply[i]), flags));
  }
}

}  // namespace preheat
