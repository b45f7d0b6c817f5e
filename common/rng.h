// Random numbers as a function of (seed, pixel, sample, bounce, dimension) and nothing else, in
// integers, so that every machine draws the same ones in any order.
//
// Each (pixel, bounce, dimension) owns one copy of the first two dimensions of Sobol's sequence,
// with its index shuffled and both coordinates scrambled by hashes that act as Owen scrambling
// (Burley, "Practical Hash-based Owen Scrambling", JCGT 2020). Along `sample` such a pair is a
// (0,2)-sequence in base 2: every aligned run of 2^k samples puts one in each elementary interval
// of area 2^-k. Different pairs are independent of each other (padding).
#pragma once

#include <cstdint>

namespace preheat {

// Two numbers with 32 random bits each.
struct RandomPair {
  std::uint32_t x_bits = 0;
  std::uint32_t y_bits = 0;
  // In [0, 1), multiples of 2^-24.
  [[nodiscard]] float x() const { return static_cast<float>(x_bits >> 8U) * 0x1p-24F; }
  [[nodiscard]] float y() const { return static_cast<float>(y_bits >> 8U) * 0x1p-24F; }
};

namespace detail {

// A bijection of 64 bits whose every output bit depends on every input bit (Stafford's variant 13
// of the MurmurHash3 finaliser, as in SplitMix64).
[[nodiscard]] inline std::uint64_t mix(std::uint64_t x) {
  x = (x ^ (x >> 30U)) * 0xBF58476D1CE4E5B9ULL;
  x = (x ^ (x >> 27U)) * 0x94D049BB133111EBULL;
  return x ^ (x >> 31U);
}

[[nodiscard]] inline std::uint32_t reverse_bits(std::uint32_t x) {
  x = __builtin_bswap32(x);
  x = ((x & 0x0F0F0F0FU) << 4U) | ((x >> 4U) & 0x0F0F0F0FU);
  x = ((x & 0x33333333U) << 2U) | ((x >> 2U) & 0x33333333U);
  return ((x & 0x55555555U) << 1U) | ((x >> 1U) & 0x55555555U);
}

[[nodiscard]] inline RandomPair reverse_bits_of_both(std::uint32_t x, std::uint32_t y) {
  std::uint64_t both = __builtin_bswap64((static_cast<std::uint64_t>(y) << 32U) | x);
  both = ((both & 0x0F0F0F0F0F0F0F0FULL) << 4U) | ((both >> 4U) & 0x0F0F0F0F0F0F0F0FULL);
  both = ((both & 0x3333333333333333ULL) << 2U) | ((both >> 2U) & 0x3333333333333333ULL);
  both = ((both & 0x5555555555555555ULL) << 1U) | ((both >> 1U) & 0x5555555555555555ULL);
  return {static_cast<std::uint32_t>(both >> 32U), static_cast<std::uint32_t>(both)};
}

// A seeded bijection in which every bit depends on the seed and on itself and lower bits only: Owen
// scrambling of a number whose bits are reversed (Laine and Karras 2011; constants by N. Vegdahl).
[[nodiscard]] inline std::uint32_t scramble_reversed(std::uint32_t x, std::uint32_t seed) {
  x ^= x * 0x3D20ADEAU;
  x += seed;
  x *= (seed >> 16U) | 1U;
  x ^= x * 0x05526C56U;
  x ^= x * 0x53A22864U;
  return x;
}

// The second Sobol dimension with its bits reversed: the index times Pascal's triangle modulo 2,
// which factors into five steps because that triangle is a Kronecker power of [1 1; 0 1].
[[nodiscard]] inline std::uint32_t sobol_second_reversed(std::uint32_t index) {
  index ^= (index & 0xFFFF0000U) >> 16U;
  index ^= (index & 0xFF00FF00U) >> 8U;
  index ^= (index & 0xF0F0F0F0U) >> 4U;
  index ^= (index & 0xCCCCCCCCU) >> 2U;
  index ^= (index & 0xAAAAAAAAU) >> 1U;
  return index;
}

}  // namespace detail

// What a pair is drawn for. Camera belongs to bounce 0 and is distinct from the vertex ones.
enum class Dimension : std::uint8_t {
  kCamera = 0,     // point in the pixel
  kChoice = 1,     // x: which light, y: which lobe of the material
  kLight = 2,      // point on the light
  kDirection = 3,  // direction of the scattered ray
  kRoulette = 4    // x: whether the path goes on
};

class Rng {
 public:
  explicit Rng(std::uint64_t seed) : key_(detail::mix(seed + 0x9E3779B97F4A7C15ULL)) {}

  // Requires: bounce < 2^24.
  [[nodiscard]] RandomPair pair(std::uint32_t pixel, std::uint32_t sample, std::uint32_t bounce,
                                Dimension dimension) const {
    const std::uint64_t name = (static_cast<std::uint64_t>(pixel) << 32U) |
                               (static_cast<std::uint64_t>(bounce) << 8U) |
                               static_cast<std::uint64_t>(dimension);
    const std::uint64_t first = detail::mix(key_ ^ name);
    const std::uint64_t second = detail::mix(first + 0x9E3779B97F4A7C15ULL);
    const auto shuffle_seed = static_cast<std::uint32_t>(first);
    const auto x_seed = static_cast<std::uint32_t>(first >> 32U);
    const auto y_seed = static_cast<std::uint32_t>(second);
    const std::uint32_t index =
        detail::reverse_bits(detail::scramble_reversed(detail::reverse_bits(sample), shuffle_seed));
    return detail::reverse_bits_of_both(
        detail::scramble_reversed(index, x_seed),
        detail::scramble_reversed(detail::sobol_second_reversed(index), y_seed));
  }

 private:
  std::uint64_t key_;
};

}  // namespace preheat
