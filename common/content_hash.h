// XXH3, 128 bits, of some bytes: the name of their content.
#pragma once

#include <cstddef>
#include <span>
#include <string>

#include "common/scene_tables.h"

namespace preheat {

[[nodiscard]] Hash128 content_hash(std::span<const std::byte> bytes);

// 32 hexadecimal digits, the high half first.
[[nodiscard]] std::string to_string(const Hash128& hash);

}  // namespace preheat
