// The built-in scene: a furnished room at dusk, with clutter, glass, metal and several lights.
//
// A pure function of its argument, so that everybody renders the same one.
#pragma once

#include <cstdint>

#include "common/scene.h"

namespace preheat {

inline constexpr std::uint64_t kDemoTrianglesDefault = 1'000'000;
inline constexpr std::uint64_t kDemoTrianglesMin = 50'000;
inline constexpr std::uint64_t kDemoTrianglesMax = 100'000'000;
// Part of the compiled scene's name: counts the scenes that this code has been.
inline constexpr std::uint32_t kDemoVersion = 2;

// About `triangles_target` triangles, within some 15 % from 250,000 on: the same room, finer and with
// more in it. A coarser room stays furnished, so that 50,000 becomes about 90,000.
// Requires: kDemoTrianglesMin <= triangles_target <= kDemoTrianglesMax.
[[nodiscard]] Scene make_demo_scene(std::uint64_t triangles_target);

}  // namespace preheat
