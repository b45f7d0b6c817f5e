// Which tile a worker begins next. The tiles lie along a Hilbert curve, so that neighbours in time
// are neighbours in the image and share voxels, and every worker goes along a stretch of its own,
// so that workers share few. One that has come to the end of its stretch takes the later half of
// the longest that is left. A tile that came back goes before all that were never begun.
//
// Pure; knows nothing of leases or time.
#pragma once

#include <algorithm>
#include <cstddef>
#include <deque>
#include <optional>
#include <vector>

#include "common/ids.h"
#include "common/render_settings.h"

namespace preheat {

// The side of tiles, in pixels, where so many threads render: 32 unless the last tiles would then
// be waited for long by those that are done, down to 8.
[[nodiscard]] std::uint32_t tile_size_for(std::uint32_t width, std::uint32_t height,
                                          std::uint64_t threads);

class TileScheduler {
 public:
  explicit TileScheduler(const TileGrid& grid);

  // The first pending tile that `eligible(tile)` accepts, which is then pending no more. Only tiles
  // that came back may be refused; looks at no more than 64 of those.
  template <class Eligible>
  [[nodiscard]] std::optional<TileId> next(WorkerId worker, Eligible&& eligible) {
    const std::size_t returned_looked_at = std::min<std::size_t>(returned_.size(), kLookedAtMax);
    for (std::size_t i = 0; i < returned_looked_at; ++i) {
      const TileId tile = returned_[i];
      if (!eligible(tile)) { continue; }
      returned_.erase(returned_.begin() + static_cast<std::ptrdiff_t>(i));
      return tile;
    }
    return next_fresh(worker);
  }

  // Pending again.
  void give_back(TileId tile) { returned_.push_back(tile); }

  // Pending no more, if it was given back.
  void remove(TileId tile) { std::erase(returned_, tile); }

  [[nodiscard]] std::size_t pending() const;

 private:
  static constexpr std::size_t kLookedAtMax = 64;

  // Tiles of fresh_ that were never begun; never empty.
  struct Stretch {
    WorkerId owner = kNoWorker;
    std::size_t begin = 0;
    std::size_t end = 0;
    [[nodiscard]] std::size_t length() const { return end - begin; }
  };

  [[nodiscard]] std::optional<TileId> next_fresh(WorkerId worker);
  [[nodiscard]] std::vector<Stretch>::iterator take_stretch(WorkerId worker);

  std::vector<TileId> fresh_;  // [tile_count], along the curve
  std::vector<Stretch> stretches_;
  std::deque<TileId> returned_;
};

}  // namespace preheat
