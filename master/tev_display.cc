#include "master/tev_display.h"

#include <fmt/format.h>
#include <netdb.h>
#include <poll.h>
#include <spdlog/spdlog.h>
#include <sys/resource.h>
#include <sys/socket.h>

#include <array>
#include <bit>
#include <cerrno>
#include <condition_variable>
#include <cstring>
#include <deque>
#include <mutex>
#include <optional>
#include <thread>
#include <utility>

#include "common/clock.h"
#include "master/tcp_socket.h"

namespace preheat {
namespace {

static_assert(std::endian::native == std::endian::little, "packets are little-endian");

constexpr std::uint8_t kCreateImage = 4;
constexpr std::uint8_t kUpdateImage = 6;  // the third version of it
constexpr std::array<const char*, 3> kChannels{"R", "G", "B"};
constexpr std::uint16_t kUsualPort = 14158;
constexpr int kNice = 5;

class Packet {
 public:
  explicit Packet(std::uint8_t type) {
    put(std::uint32_t{0});
    put(type);
  }
  template <class Value>
  void put(const Value& value) {
    bytes_.append(reinterpret_cast<const char*>(&value), sizeof value);
  }
  void put_text(const std::string& text) { bytes_.append(text.c_str(), text.size() + 1); }
  void put_channels() {
    put(static_cast<std::int32_t>(kChannels.size()));
    for (const char* const channel : kChannels) { put_text(channel); }
  }
  void put_values(const std::vector<float>& values) {
    bytes_.append(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(float));
  }
  [[nodiscard]] std::string finish() {
    const auto length = static_cast<std::uint32_t>(bytes_.size());
    std::memcpy(bytes_.data(), &length, sizeof length);
    return std::move(bytes_);
  }

 private:
  std::string bytes_;
};

}  // namespace

std::string create_image_packet(const std::string& name, std::uint32_t width,
                                std::uint32_t height) {
  Packet packet(kCreateImage);
  packet.put(std::uint8_t{1});
  packet.put_text(name);
  packet.put(static_cast<std::int32_t>(width));
  packet.put(static_cast<std::int32_t>(height));
  packet.put_channels();
  return packet.finish();
}

std::string update_image_packet(const std::string& name, const TileRect& rect,
                                const std::vector<float>& rgb) {
  Packet packet(kUpdateImage);
  packet.put(std::uint8_t{0});
  packet.put_text(name);
  packet.put_channels();
  for (const std::uint32_t value : {rect.x, rect.y, rect.width, rect.height}) {
    packet.put(static_cast<std::int32_t>(value));
  }
  for (std::int64_t offset = 0; offset < 3; ++offset) { packet.put(offset); }
  for (int channel = 0; channel < 3; ++channel) { packet.put(std::int64_t{3}); }
  packet.put_values(rgb);
  return packet.finish();
}

class TevDisplay::Impl {
 public:
  Impl(const Endpoint& viewer, std::string name, std::uint32_t width, std::uint32_t height,
       const DisplayLimits& limits)
      : viewer_(viewer),
        addresses_(addresses_of(viewer, /*to_listen=*/false)),
        name_(std::move(name)),
        width_(width),
        height_(height),
        limits_(limits),
        thread_([this] { run(); }) {}
  ~Impl() {
    {
      const std::lock_guard lock(mutex_);
      end_ = Clock::now() + limits_.flush_max;
    }
    news_.notify_one();
    thread_.join();
  }
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  void add(const TileRect& rect, const std::vector<float>& rgb) {
    auto tile = std::make_shared<const Tile>(Tile{rect, rgb});
    const std::size_t bytes = rgb.size() * sizeof(float);
    {
      const std::lock_guard lock(mutex_);
      kept_bytes_ += bytes;
      tiles_.push_back(std::move(tile));
      // The oldest go first: those that were sent are kept only for a viewer that comes later.
      while (kept_bytes_ > limits_.kept_bytes_max) {
        kept_bytes_ -= tiles_.front()->rgb.size() * sizeof(float);
        tiles_.pop_front();
        if (next_ > 0) {
          --next_;
        } else {
          ++counts_.dropped;
        }
      }
    }
    news_.notify_one();
  }

  [[nodiscard]] Counts counts() const {
    const std::lock_guard lock(mutex_);
    return counts_;
  }

 private:
  struct Tile {
    TileRect rect{};
    std::vector<float> rgb{};
  };

  void run() {
    ::setpriority(PRIO_PROCESS, 0, kNice);
    while (!is_time_up()) {
      const Descriptor socket = connect();
      if (socket.is_open() && send(socket, create_image_packet(name_, width_, height_))) {
        {
          const std::lock_guard lock(mutex_);
          ++counts_.connections;
          next_ = 0;
        }
        spdlog::info("event=display_connected address={}:{}", viewer_.host, viewer_.port);
        send_tiles(socket);
      }
      // Nobody is there, or not any more; once the render has ended nobody is waited for.
      std::unique_lock lock(mutex_);
      if (news_.wait_for(lock, limits_.connect_again, [this] { return end_.has_value(); })) {
        return;
      }
    }
  }

  // Until the connection breaks, or all is sent and the render has ended.
  void send_tiles(const Descriptor& socket) {
    for (;;) {
      const std::shared_ptr<const Tile> tile = wait_for_tile();
      if (!tile || !send(socket, update_image_packet(name_, tile->rect, tile->rgb))) { return; }
      const std::lock_guard lock(mutex_);
      ++counts_.sent;
    }
  }

  // nullptr when the render has ended and nothing is left.
  std::shared_ptr<const Tile> wait_for_tile() {
    std::unique_lock lock(mutex_);
    news_.wait(lock, [this] { return next_ < tiles_.size() || end_; });
    if (next_ >= tiles_.size()) { return nullptr; }
    return tiles_[next_++];
  }

  [[nodiscard]] bool is_time_up() const {
    const std::lock_guard lock(mutex_);
    return end_ && Clock::now() >= *end_;
  }

  // False when the viewer is gone, takes nothing for send_max, or the time is up.
  bool send(const Descriptor& socket, const std::string& packet) const {
    std::size_t sent = 0;
    Time moved = Clock::now();
    while (sent < packet.size()) {
      if (is_time_up() || Clock::now() - moved >= limits_.send_max) { return false; }
      const ssize_t count = ::send(socket.number(), packet.data() + sent, packet.size() - sent,
                                   MSG_NOSIGNAL | MSG_DONTWAIT);
      if (count > 0) {
        sent += static_cast<std::size_t>(count);
        moved = Clock::now();
      } else if (count < 0 && errno != EAGAIN && errno != EINTR) {
        return false;
      } else {
        wait_until_writable(socket);
      }
    }
    return true;
  }

  static void wait_until_writable(const Descriptor& socket) {
    pollfd ready{socket.number(), POLLOUT, 0};
    ::poll(&ready, 1, 50);
  }

  // Closed if nobody is there.
  [[nodiscard]] Descriptor connect() const {
    for (const addrinfo* one = addresses_.get(); one != nullptr; one = one->ai_next) {
      Descriptor socket(
          ::socket(one->ai_family, one->ai_socktype | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
      if (!socket.is_open()) { continue; }
      if (::connect(socket.number(), one->ai_addr, one->ai_addrlen) != 0 && errno != EINPROGRESS) {
        continue;
      }
      const Time began = Clock::now();
      pollfd ready{socket.number(), POLLOUT, 0};
      while (::poll(&ready, 1, 50) == 0 && !is_time_up() &&
             Clock::now() - began < limits_.send_max) {}
      int error = ECONNREFUSED;
      socklen_t length = sizeof error;
      ::getsockopt(socket.number(), SOL_SOCKET, SO_ERROR, &error, &length);
      if ((ready.revents & POLLOUT) != 0 && error == 0) { return socket; }
    }
    return {};
  }

  Endpoint viewer_;
  AddressList addresses_;  // asked for once: a name server may take its time
  std::string name_;
  std::uint32_t width_;
  std::uint32_t height_;
  DisplayLimits limits_;
  mutable std::mutex mutex_;  // of what follows, up to the thread
  std::condition_variable news_;
  std::deque<std::shared_ptr<const Tile>> tiles_;
  std::size_t next_ = 0;  // the first of tiles_ that this viewer has not got
  std::size_t kept_bytes_ = 0;
  Counts counts_;
  std::optional<Time> end_;  // when to stop, once the render has ended
  std::thread thread_;       // last: it uses the rest
};

TevDisplay::TevDisplay(const Endpoint& viewer, std::string name, std::uint32_t width,
                       std::uint32_t height, const DisplayLimits& limits)
    : impl_(std::make_unique<Impl>(viewer, std::move(name), width, height, limits)) {}

TevDisplay::~TevDisplay() = default;

void TevDisplay::tile_done(const TileRect& rect, const TilePixels& pixels) {
  impl_->add(rect, pixels.rgb);
}

TevDisplay::Counts TevDisplay::counts() const { return impl_->counts(); }

Result<Endpoint> parse_display(const std::string& text) {
  const bool has_port = text.find(':') != std::string::npos;
  Result<Endpoint> endpoint = parse_endpoint(
      fmt::format("tcp://{}{}", text, has_port ? "" : fmt::format(":{}", kUsualPort)));
  if (!endpoint || endpoint->port == 0) {
    return fail(
        ExitCode::kUsage,
        fmt::format("bad address \"{}\": expected HOST:PORT such as 127.0.0.1:14158", text));
  }
  if (!addresses_of(*endpoint, /*to_listen=*/false)) {
    return fail(ExitCode::kUsage, fmt::format("the viewer's host {} is not known", endpoint->host));
  }
  return endpoint;
}

}  // namespace preheat
