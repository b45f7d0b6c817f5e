#include "common/byte_size.h"

#include <fmt/format.h>

#include <array>
#include <charconv>
#include <cmath>
#include <optional>
#include <string_view>

namespace preheat {
namespace {

struct Unit {
  std::string_view name;
  double bytes;
};
constexpr std::array kUnits = {Unit{"KiB", 1024.0}, Unit{"MiB", 1048576.0},
                               Unit{"GiB", 1073741824.0}, Unit{"TiB", 1099511627776.0}};

}  // namespace

std::optional<double> parse_number(std::string_view text) {
  double value = 0.0;
  const char* const end = text.data() + text.size();
  const auto [rest, error] = std::from_chars(text.data(), end, value);
  if (error != std::errc{} || rest != end || !std::isfinite(value)) { return std::nullopt; }
  return value;
}

tl::unexpected<Error> fail_to_parse(std::string_view text, std::string_view wanted) {
  return fail(ExitCode::kUsage, fmt::format("'{}' is not {}", text, wanted));
}

Result<std::uint64_t> parse_bytes(const std::string& text) {
  std::string_view number = text;
  double unit = 1.0;
  for (const Unit& candidate : kUnits) {
    if (!number.ends_with(candidate.name)) { continue; }
    number.remove_suffix(candidate.name.size());
    unit = candidate.bytes;
    break;
  }
  const std::optional<double> value = parse_number(number);
  const double bytes = value.value_or(0.0) * unit;
  if (bytes < 1.0 || bytes > 0x1p62) {
    return fail_to_parse(text, "a size of at least 1 byte such as 4096, 64KiB, 512MiB or 1.5GiB");
  }
  return static_cast<std::uint64_t>(bytes);
}

Result<double> parse_percentage(const std::string& text) {
  const std::optional<double> percent =
      text.ends_with('%') ? parse_number(std::string_view(text).substr(0, text.size() - 1))
                          : std::nullopt;
  if (!percent || *percent <= 0.0 || *percent > 100.0) {
    return fail_to_parse(text, "a percentage above 0% and up to 100%");
  }
  return *percent / 100.0;
}

}  // namespace preheat
