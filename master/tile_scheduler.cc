#include "master/tile_scheduler.h"

#include <cstdint>

namespace preheat {
namespace {

// The low 16 bits of x, a zero before each.
std::uint32_t spread(std::uint32_t x) {
  x &= 0xFFFFU;
  x = (x | (x << 8)) & 0x00FF00FFU;
  x = (x | (x << 4)) & 0x0F0F0F0FU;
  x = (x | (x << 2)) & 0x33333333U;
  return (x | (x << 1)) & 0x55555555U;
}

}  // namespace

TileScheduler::TileScheduler(const TileGrid& grid) {
  const std::uint32_t columns = grid.columns();
  fresh_.reserve(grid.count());
  for (std::uint32_t tile = 0; tile < grid.count(); ++tile) { fresh_.push_back(TileId{tile}); }
  std::stable_sort(fresh_.begin(), fresh_.end(), [columns](TileId a, TileId b) {
    const auto morton = [columns](TileId tile) {
      return spread(index_of(tile) % columns) | (spread(index_of(tile) / columns) << 1);
    };
    return morton(a) < morton(b);
  });
}

}  // namespace preheat
