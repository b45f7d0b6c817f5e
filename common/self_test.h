// What the bits of an image depend on besides the scene: this build and this processor's
// arithmetic.
#pragma once

#include <cstdint>

namespace preheat {

// The program's version, e.g. "0.1.0". Master and workers must be of the same.
[[nodiscard]] const char* build_version();

// A digest of some ten thousand float and double operations, among them those that contraction,
// flushed denormals or another rounding mode would change. Equal on every machine that may share an
// image.
[[nodiscard]] std::uint64_t numeric_self_test();

}  // namespace preheat
