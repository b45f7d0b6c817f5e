#include "common/rng.h"

namespace preheat {
namespace {

// A bijection of 64 bits whose every output bit depends on every input bit (Stafford's variant 13
// of the MurmurHash3 finaliser, as in SplitMix64).
std::uint64_t mix(std::uint64_t x) {
  x = (x ^ (x >> 30U)) * 0xBF58476D1CE4E5B9ULL;
  x = (x ^ (x >> 27U)) * 0x94D049BB133111EBULL;
  return x ^ (x >> 31U);
}

std::uint32_t reverse_bits(std::uint32_t x) {
  x = __builtin_bswap32(x);
  x = ((x & 0x0F0F0F0FU) << 4U) | ((x >> 4U) & 0x0F0F0F0FU);
  x = ((x & 0x33333333U) << 2U) | ((x >> 2U) & 0x33333333U);
  return ((x & 0x55555555U) << 1U) | ((x >> 1U) & 0x55555555U);
}

// A seeded bijection in which every bit depends on the seed and on itself and lower bits only: Owen
// scrambling of a number whose bits are reversed (Laine and Karras 2011; constants by N. Vegdahl).
std::uint32_t scramble_reversed(std::uint32_t x, std::uint32_t seed) {
  x ^= x * 0x3D20ADEAU;
  x += seed;
  x *= (seed >> 16U) | 1U;
  x ^= x * 0x05526C56U;
  x ^= x * 0x53A22864U;
  return x;
}

// The second Sobol dimension with its bits reversed: the index times Pascal's triangle modulo 2,
// which factors into five steps because that triangle is a Kronecker power of [1 1; 0 1].
std::uint32_t sobol_second_reversed(std::uint32_t index) {
  index ^= (index & 0xFFFF0000U) >> 16U;
  index ^= (index & 0xFF00FF00U) >> 8U;
  index ^= (index & 0xF0F0F0F0U) >> 4U;
  index ^= (index & 0xCCCCCCCCU) >> 2U;
  index ^= (index & 0xAAAAAAAAU) >> 1U;
  return index;
}

}  // namespace

Rng::Rng(std::uint64_t seed) : key_(mix(seed + 0x9E3779B97F4A7C15ULL)) {}

RandomPair Rng::pair(std::uint32_t pixel, std::uint32_t sample, std::uint32_t bounce,
                     Dimension dimension) const {
  const std::uint64_t name = (static_cast<std::uint64_t>(pixel) << 32U) |
                             (static_cast<std::uint64_t>(bounce) << 8U) |
                             static_cast<std::uint64_t>(dimension);
  const std::uint64_t first = mix(key_ ^ name);
  const std::uint64_t second = mix(first + 0x9E3779B97F4A7C15ULL);
  const auto shuffle_seed = static_cast<std::uint32_t>(first);
  const auto x_seed = static_cast<std::uint32_t>(first >> 32U);
  const auto y_seed = static_cast<std::uint32_t>(second);
  const std::uint32_t index = reverse_bits(scramble_reversed(reverse_bits(sample), shuffle_seed));
  return {reverse_bits(scramble_reversed(index, x_seed)),
          reverse_bits(scramble_reversed(sobol_second_reversed(index), y_seed))};
}

}  // namespace preheat
