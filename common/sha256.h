// SHA-256 (FIPS 180-4), for naming images. Not meant for secrets.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>

namespace preheat {

// In lower-case hex, 64 characters.
[[nodiscard]] std::string sha256_hex(std::span<const std::byte> bytes);

}  // namespace preheat
