#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "master/master.h"

namespace preheat {

Result<std::uint64_t> CacheSize::resolve(const SceneTables& tables) const {
  const std::uint64_t least = tables.resident_bytes_min();
  if (bytes == 0) {
    const double all = static_cast<double>(tables.resident_bytes());
    return std::max(least, static_cast<std::uint64_t>(std::ceil(share * all)));
  }
  if (bytes < least) {
    return fail(
        ExitCode::kUsage,
        fmt::format("--cache {} bytes is below one voxel: this scene needs at least {} bytes",
                    bytes, least));
  }
  return bytes;
}

}  // namespace preheat
