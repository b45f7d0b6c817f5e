// Random numbers as a function of (seed, pixel, sample, bounce, dimension) and nothing else, in
// integers, so that every machine draws the same ones in any order (DESIGN section 3, rule 1).
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
  explicit Rng(std::uint64_t seed);
  // Requires: bounce < 2^24.
  [[nodiscard]] RandomPair pair(std::uint32_t pixel, std::uint32_t sample, std::uint32_t bounce,
                                Dimension dimension) const;

 private:
  std::uint64_t key_;
};

}  // namespace preheat
