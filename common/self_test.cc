#include "common/self_test.h"

#include <bit>
#include <cmath>
#include <initializer_list>

namespace preheat {
namespace {

// Mixes a value into the digest (the multiplier is that of SplitMix64's finaliser).
std::uint64_t mix(std::uint64_t digest, std::uint64_t value) {
  digest = (digest ^ value) * 0xBF58476D1CE4E5B9U;
  return digest ^ (digest >> 31);
}

// Values come from a generator at run time, so that the compiler folds nothing of it.
template <class Float, class Bits>
std::uint64_t digest_of(std::uint64_t seed) {
  constexpr int kRounds = 2000;
  std::uint64_t digest = seed;
  std::uint64_t state = seed;
  const auto next = [&state] {
    state = state * 6364136223846793005U + 1442695040888963407U;
    // 24 random bits over 2^-60 to 2^3: sums lose bits, products of the small ones are denormal in
    // float.
    const auto mantissa = static_cast<Float>((state >> 40) + 1);
    return std::ldexp(mantissa, -84 + static_cast<int>((state >> 8) % 64));
  };
  for (int round = 0; round < kRounds; ++round) {
    const Float a = next();
    const Float b = next();
    const Float c = next();
    // What a fused multiply-add would round once, -ffp-contract=off rounds twice.
    const Float product_sum = a * b - c;
    const Float product = a * b * b;
    const Float quotient = a / (b + c);
    const Float root = std::sqrt(a * c + b);
    for (const Float value : {product_sum, product, quotient, root}) {
      digest = mix(digest, std::uint64_t{std::bit_cast<Bits>(value)});
    }
  }
  return digest;
}

}  // namespace

const char* build_version() { return PREHEAT_VERSION; }

std::uint64_t numeric_self_test() {
  return digest_of<double, std::uint64_t>(digest_of<float, std::uint32_t>(1));
}

}  // namespace preheat
