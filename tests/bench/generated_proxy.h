// A proxy of any size without its scene: hills, for measuring how prediction grows with leaves.
#pragma once

#include <cstdint>

#include "common/proxy.h"
#include "common/render_settings.h"
#include "common/scene_tables.h"

namespace preheat {

struct GeneratedProxy {
  SceneTables tables{};
  Proxy proxy{};
  RenderSettings settings{};  // a view over the hills under a sky
};

// voxels_side^2 voxels, a power of two a side, each with about 32 x 32 flat leaves.
[[nodiscard]] GeneratedProxy generate_hills(std::uint32_t voxels_side);

}  // namespace preheat
