// Shows a render in the tev image viewer, or whatever else speaks its TCP protocol, as tiles
// arrive.
//
// A thread of its own connects and sends; the render's loop only copies a tile into a list with a
// bound. A viewer that is not there yet, hangs or dies costs the render nothing: it is connected
// again, gets the tiles that are kept, and misses those for which there was no room.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>

#include "common/result.h"
#include "common/transport.h"
#include "master/render_watch.h"

namespace preheat {

// Packets of the viewer's protocol, little-endian: length of the whole (u32), type (u8), and then
// CreateImage (4): grab focus (u8), name, width, height, count of channels (i32), their names;
// UpdateImage (6): grab focus, name, count of channels, their names, x, y, width, height (i32), for
// each channel the offset and then for each the stride of its values (i64), and the values (float).
// Strings end with a zero byte.
[[nodiscard]] std::string create_image_packet(const std::string& name, std::uint32_t width,
                                              std::uint32_t height);
[[nodiscard]] std::string update_image_packet(const std::string& name, const TileRect& rect,
                                              const std::vector<float>& rgb);

struct DisplayLimits {
  std::size_t kept_bytes_max = std::size_t{128} << 20;  // of tiles, sent or not
  std::chrono::milliseconds connect_again{2000};
  std::chrono::milliseconds send_max{3000};   // without a byte taken: the viewer hangs
  std::chrono::milliseconds flush_max{1000};  // when the render has ended
};

class TevDisplay : public RenderWatch {
 public:
  TevDisplay(const Endpoint& viewer, std::string name, std::uint32_t width, std::uint32_t height,
             const DisplayLimits& limits = {});
  ~TevDisplay() override;  // sends what is left, for flush_max at most

  void look(RenderSnapshot) override {}
  void tile_done(const TileRect& rect, const TilePixels& pixels) override;

  struct Counts {
    std::uint64_t sent = 0;     // tiles, again ones too
    std::uint64_t dropped = 0;  // tiles for which there was no room before they were sent
    std::uint64_t connections = 0;
  };
  [[nodiscard]] Counts counts() const;

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

// HOST:PORT, or HOST with the viewer's usual port. kUsage if there is no such host.
[[nodiscard]] Result<Endpoint> parse_display(const std::string& text);

}  // namespace preheat
