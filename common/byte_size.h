// Sizes as users write them.
#pragma once

#include <cstdint>
#include <string>

#include "common/result.h"

namespace preheat {

// "4096", "64KiB", "1.5GiB"; at least one byte.
[[nodiscard]] Result<std::uint64_t> parse_bytes(const std::string& text);
// "25%": more than 0 %, at most 100 %; as a share of 1.
[[nodiscard]] Result<double> parse_percentage(const std::string& text);

}  // namespace preheat
