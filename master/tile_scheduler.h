// Which tile is begun next: Morton order, so that neighbours in time are neighbours in the image
// and share voxels; a tile that came back goes before all that were never begun.
//
// Pure; knows nothing of workers, leases or time.
#pragma once

#include <algorithm>
#include <cstddef>
#include <deque>
#include <optional>
#include <vector>

#include "common/ids.h"
#include "common/render_settings.h"

namespace preheat {

class TileScheduler {
 public:
  explicit TileScheduler(const TileGrid& grid);

  // The first pending tile that `eligible(tile)` accepts, which is then pending no more. Only tiles
  // that came back may be refused; looks at no more than 64 of those.
  template <class Eligible>
  [[nodiscard]] std::optional<TileId> next(Eligible&& eligible) {
    const std::size_t returned_looked_at = std::min<std::size_t>(returned_.size(), kLookedAtMax);
    for (std::size_t i = 0; i < returned_looked_at; ++i) {
      const TileId tile = returned_[i];
      if (!eligible(tile)) { continue; }
      returned_.erase(returned_.begin() + static_cast<std::ptrdiff_t>(i));
      return tile;
    }
    if (fresh_next_ == fresh_.size()) { return std::nullopt; }
    return fresh_[fresh_next_++];
  }

  // Pending again.
  void give_back(TileId tile) { returned_.push_back(tile); }

  // Pending no more, if it was given back.
  void remove(TileId tile) { std::erase(returned_, tile); }

  [[nodiscard]] std::size_t pending() const {
    return returned_.size() + fresh_.size() - fresh_next_;
  }

 private:
  static constexpr std::size_t kLookedAtMax = 64;

  std::vector<TileId> fresh_;  // [tile_count], Morton order
  std::size_t fresh_next_ = 0;
  std::deque<TileId> returned_;
};

}  // namespace preheat
