// Sizes as users write them.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "common/result.h"

namespace preheat {

// The whole of `text` as a finite number.
[[nodiscard]] std::optional<double> parse_number(std::string_view text);
// A usage error: "'text' is not wanted".
[[nodiscard]] tl::unexpected<Error> fail_to_parse(std::string_view text, std::string_view wanted);

// "4096", "64KiB", "1.5GiB"; at least one byte.
[[nodiscard]] Result<std::uint64_t> parse_bytes(const std::string& text);
// "25%": more than 0 %, at most 100 %; as a share of 1.
[[nodiscard]] Result<double> parse_percentage(const std::string& text);

}  // namespace preheat
