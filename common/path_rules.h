// When a path goes on and when it samples a light: what the renderer does and what prediction has
// to count with. Both include this file, so that they cannot drift apart.
#pragma once

#include <algorithm>
#include <cstdint>

#include "common/math.h"
#include "common/vec3.h"

namespace preheat {

// Shadow rays at a vertex that samples lights.
inline constexpr std::uint32_t kLightSamplesPerVertex = 1;

// Russian roulette begins with the ray that follows this many scattering events.
inline constexpr std::uint32_t kRouletteScatteringsMin = 3;

// Even a path that lost nothing ends at some time, so that a closed white room does.
inline constexpr float kRouletteSurvivalMax = 0.95F;

// The light that a vertex receives directly is its own scattering event, so it is only sampled
// where one more is allowed. `bounce` = scattering events before this vertex.
[[nodiscard]] constexpr bool may_scatter(std::uint32_t bounce, std::uint32_t bounces_max) {
  return bounce < bounces_max;
}

// The last allowed scatter ray can only find emission; where no ray can meet any (nothing but
// punctual lights), it is not traced.
[[nodiscard]] constexpr bool may_continue(std::uint32_t bounce, std::uint32_t bounces_max,
                                          bool emission_can_be_met) {
  return bounce + 1 < bounces_max || (bounce < bounces_max && emission_can_be_met);
}

// The probability that a path with this throughput survives; `scatterings` counts the one just
// sampled. Throughput inside a solid of index n is smaller by n^2 until the ray comes out again,
// which the caller takes back first.
[[nodiscard]] inline float roulette_survival(std::uint32_t scatterings, const Vec3& throughput) {
  if (scatterings < kRouletteScatteringsMin) { return 1.0F; }
  return std::min(kRouletteSurvivalMax, max_component(throughput));
}

}  // namespace preheat
