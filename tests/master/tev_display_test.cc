#include "master/tev_display.h"

#include <gtest/gtest.h>
#include <poll.h>
#include <sys/socket.h>

#include <optional>
#include <thread>

#include "master/tcp_socket.h"

namespace preheat {
namespace {

using std::chrono::milliseconds;

std::string hex_of(const std::string& bytes) {
  std::string text;
  for (const char character : bytes) {
    const auto byte = static_cast<unsigned char>(character);
    text += "0123456789abcdef"[byte / 16];
    text += "0123456789abcdef"[byte % 16];
  }
  return text;
}

TEST(TevPacket, CreatesAnImageByteByByte) {
  EXPECT_EQ(hex_of(create_image_packet("a.b", 640, 432)),
            "1c000000"  // 28 bytes in all
            "04"
            "01"        // CreateImage, grab the focus
            "612e6200"  // a.b
            "80020000"
            "b0010000"  // 640, 432
            "03000000"  // three channels
            "5200"
            "4700"
            "4200");  // R, G, B
}

TEST(TevPacket, UpdatesATileByteByByte) {
  EXPECT_EQ(hex_of(update_image_packet("a", {32, 16, 1, 2}, {1.0F, 0.5F, 0.0F, 2.0F, 0.0F, -1.0F})),
            "6a000000"  // 106 bytes in all
            "06"
            "00"    // UpdateImage, leave the focus
            "6100"  // a
            "03000000"
            "5200"
            "4700"
            "4200"
            "20000000"
            "10000000"
            "01000000"
            "02000000"
            "0000000000000000"
            "0100000000000000"
            "0200000000000000"
            "0300000000000000"
            "0300000000000000"
            "0300000000000000"
            "0000803f"
            "0000003f"
            "00000000"
            "00000040"
            "00000000"
            "000080bf");
}

TilePixels pixels_of(const TileRect& rect, float value) {
  TilePixels pixels;
  pixels.rgb.assign(std::size_t{3} * rect.width * rect.height, value);
  return pixels;
}

// A viewer that a test plays.
class Viewer {
 public:
  Viewer() : listener_(*listen_at({"127.0.0.1", 0})) {}
  [[nodiscard]] Endpoint endpoint() const { return {"127.0.0.1", port_of(listener_)}; }
  // The next client's connection; closed if none comes.
  [[nodiscard]] Descriptor accept() const {
    pollfd ready{listener_.number(), POLLIN, 0};
    if (::poll(&ready, 1, 20'000) <= 0) { return {}; }
    return Descriptor(::accept(listener_.number(), nullptr, nullptr));
  }

 private:
  Descriptor listener_;
};

// Exactly so many bytes, or as many as came before the end.
std::string read_bytes(const Descriptor& socket, std::size_t count) {
  std::string bytes(count, '\0');
  std::size_t filled = 0;
  while (filled < count) {
    const ssize_t read = ::recv(socket.number(), bytes.data() + filled, count - filled, 0);
    if (read <= 0) { break; }
    filled += static_cast<std::size_t>(read);
  }
  bytes.resize(filled);
  return bytes;
}

DisplayLimits quick_limits() {
  DisplayLimits limits;
  limits.connect_again = milliseconds(20);
  return limits;
}

TileRect column_of(std::uint32_t tile) { return {tile * 8, 0, 8, 32}; }

std::string packet_of(std::uint32_t tile) {
  const TileRect rect = column_of(tile);
  return update_image_packet("out.png", rect, pixels_of(rect, static_cast<float>(tile)).rgb);
}

void add(TevDisplay& display, std::uint32_t tile) {
  display.tile_done(column_of(tile), pixels_of(column_of(tile), static_cast<float>(tile)));
}

TEST(TevDisplay, SendsTheImageAndEveryTileInOrder) {
  const Viewer viewer;
  TevDisplay display(viewer.endpoint(), "out.png", 64, 32, quick_limits());
  std::string expected = create_image_packet("out.png", 64, 32);
  for (std::uint32_t tile = 0; tile < 8; ++tile) {
    add(display, tile);
    expected += packet_of(tile);
  }

  const Descriptor socket = viewer.accept();

  EXPECT_EQ(read_bytes(socket, expected.size()), expected);
}

TEST(TevDisplay, AViewerThatCameBackGetsEverythingAgain) {
  const Viewer viewer;
  TevDisplay display(viewer.endpoint(), "out.png", 64, 32, quick_limits());
  add(display, 0);
  const std::string expected = create_image_packet("out.png", 64, 32) + packet_of(0) + packet_of(1);
  { EXPECT_EQ(read_bytes(viewer.accept(), 40), expected.substr(0, 40)); }

  // It finds out by sending.
  std::optional<Descriptor> second;
  std::thread accepting([&] { second.emplace(viewer.accept()); });
  add(display, 1);
  std::uint64_t tiles = 2;
  while (display.counts().connections < 2 && tiles < 2000) {
    add(display, static_cast<std::uint32_t>(tiles++ % 8));
    std::this_thread::sleep_for(milliseconds(5));
  }
  accepting.join();

  EXPECT_EQ(read_bytes(*second, expected.size()), expected);
}

TEST(TevDisplay, AViewerThatReadsNothingCostsNothingButItsTiles) {
  const Viewer viewer;
  DisplayLimits limits = quick_limits();
  limits.kept_bytes_max = std::size_t{1} << 20;
  limits.send_max = std::chrono::hours(1);
  limits.flush_max = milliseconds(100);
  Descriptor socket;
  {
    TevDisplay display(viewer.endpoint(), "out.png", 64, 32, limits);
    socket = viewer.accept();
    ASSERT_TRUE(socket.is_open());
    // 120 MB, which neither the list nor the sockets between them can hold.
    for (std::uint32_t tile = 0; tile < 40'000; ++tile) { add(display, tile % 8); }

    EXPECT_GT(display.counts().dropped, 10'000U);
    EXPECT_LT(display.counts().sent, 20'000U);
  }
  SUCCEED() << "and its end is waited for no longer than flush_max";
}

TEST(TevDisplay, AViewerThatHangsIsLeftAndTriedAgain) {
  const Viewer viewer;
  DisplayLimits limits = quick_limits();
  limits.send_max = milliseconds(50);
  TevDisplay display(viewer.endpoint(), "out.png", 4096, 4096, limits);
  const Descriptor first = viewer.accept();
  const TileRect large{0, 0, 1024, 1024};
  display.tile_done(large, pixels_of(large, 1.0F));

  const Descriptor second = viewer.accept();

  EXPECT_TRUE(second.is_open());
}

TEST(TevDisplay, WithoutAViewerTheRenderEndsAtOnce) {
  Endpoint nobody;
  { nobody = Viewer().endpoint(); }
  DisplayLimits limits;
  limits.connect_again = std::chrono::hours(1);
  limits.flush_max = std::chrono::hours(1);
  TevDisplay::Counts counts;
  {
    TevDisplay display(nobody, "out.png", 64, 32, limits);
    for (std::uint32_t tile = 0; tile < 8; ++tile) { add(display, tile); }
    counts = display.counts();
  }

  EXPECT_EQ(counts.connections, 0U);
}

TEST(TevDisplay, SendsWhatIsLeftWhenTheRenderEnds) {
  const Viewer viewer;
  std::string received;
  std::string expected = create_image_packet("out.png", 64, 32);
  std::thread reader([&] { received = read_bytes(viewer.accept(), std::size_t{1} << 20); });
  {
    DisplayLimits limits = quick_limits();
    limits.flush_max = std::chrono::seconds(20);
    TevDisplay display(viewer.endpoint(), "out.png", 64, 32, limits);
    for (std::uint32_t tile = 0; tile < 8; ++tile) {
      add(display, tile);
      expected += packet_of(tile);
    }
  }
  reader.join();

  EXPECT_EQ(received, expected);
}

TEST(DisplayAddress, HasTheViewersUsualPort) {
  EXPECT_EQ(parse_display("127.0.0.1")->port, 14158);
  EXPECT_EQ(parse_display("127.0.0.1:99")->port, 99);
  for (const char* bad : {"", "127.0.0.1:0", "127.0.0.1:x", ":1"}) {
    EXPECT_FALSE(parse_display(bad).has_value()) << bad;
  }
}

}  // namespace
}  // namespace preheat
