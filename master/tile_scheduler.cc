#include "master/tile_scheduler.h"

#include <bit>
#include <cstdint>
#include <utility>

namespace preheat {
namespace {

// How far along the Hilbert curve through a square of `side` (a power of two) the cell lies. Each
// level picks a quadrant and turns what is inside it so that the curve goes on where it left off.
std::uint64_t hilbert_distance(std::uint32_t side, std::uint32_t x, std::uint32_t y) {
  std::uint64_t distance = 0;
  for (std::uint32_t half = side / 2; half > 0; half /= 2) {
    const std::uint32_t right = (x & half) != 0 ? 1 : 0;
    const std::uint32_t upper = (y & half) != 0 ? 1 : 0;
    distance += std::uint64_t{half} * half * ((3 * right) ^ upper);
    if (upper == 0) {
      if (right == 1) {
        x = side - 1 - x;
        y = side - 1 - y;
      }
      std::swap(x, y);
    }
  }
  return distance;
}

// With so many tiles for each thread the end costs about 1 part in 30.
constexpr std::uint64_t kTilesPerThreadMin = 32;

}  // namespace

std::uint32_t tile_size_for(std::uint32_t width, std::uint32_t height, std::uint64_t threads) {
  std::uint32_t size = 32;
  while (size > 8 && TileGrid{width, height, size}.count() < kTilesPerThreadMin * threads) {
    size /= 2;
  }
  return size;
}

TileScheduler::TileScheduler(const TileGrid& grid) {
  const std::uint32_t columns = grid.columns();
  const std::uint32_t side = std::bit_ceil(std::max(columns, grid.rows()));
  std::vector<std::pair<std::uint64_t, TileId>> order;
  order.reserve(grid.count());
  for (std::uint32_t tile = 0; tile < grid.count(); ++tile) {
    order.emplace_back(hilbert_distance(side, tile % columns, tile / columns), TileId{tile});
  }
  std::sort(order.begin(), order.end());
  fresh_.reserve(order.size());
  for (const auto& [distance, tile] : order) { fresh_.push_back(tile); }
  if (!fresh_.empty()) { stretches_.push_back({kNoWorker, 0, fresh_.size()}); }
}

std::vector<TileScheduler::Stretch>::iterator TileScheduler::take_stretch(WorkerId worker) {
  const auto own =
      std::find_if(stretches_.begin(), stretches_.end(),
                   [worker](const Stretch& stretch) { return stretch.owner == worker; });
  if (own != stretches_.end()) { return own; }
  const auto longest =
      std::max_element(stretches_.begin(), stretches_.end(),
                       [](const Stretch& a, const Stretch& b) { return a.length() < b.length(); });
  if (longest == stretches_.end()) { return longest; }
  // Nobody's, or too short to share: all of it.
  if (longest->owner == kNoWorker || longest->length() == 1) {
    longest->owner = worker;
    return longest;
  }
  const std::size_t middle = longest->begin + (longest->length() + 1) / 2;
  const Stretch later{worker, middle, longest->end};
  longest->end = middle;
  stretches_.push_back(later);
  return std::prev(stretches_.end());
}

std::optional<TileId> TileScheduler::next_fresh(WorkerId worker) {
  const auto stretch = take_stretch(worker);
  if (stretch == stretches_.end()) { return std::nullopt; }
  const TileId tile = fresh_[stretch->begin++];
  if (stretch->length() == 0) { stretches_.erase(stretch); }
  return tile;
}

std::size_t TileScheduler::pending() const {
  std::size_t count = returned_.size();
  for (const Stretch& stretch : stretches_) { count += stretch.length(); }
  return count;
}

}  // namespace preheat
