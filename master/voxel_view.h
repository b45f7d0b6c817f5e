// Which voxel each pixel of a view looks at, and that view painted with numbers of the voxels.
//
// Found without a triangle: a camera ray ends in the first leaf of the proxy where a real ray would
// more likely have been stopped than not.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "common/proxy.h"
#include "common/render_settings.h"
#include "common/result.h"
#include "common/scene_tables.h"
#include "master/heat_colors.h"

namespace preheat {

struct VoxelView {
  static constexpr std::uint32_t kNone = 0xFFFFFFFFU;
  std::uint32_t width = 0;
  std::uint32_t height = 0;
  std::vector<std::uint32_t> voxels{};  // [height * width], row by row; kNone where nothing is
};

// The image's view in at most `side_max` pixels a side. An error where tables and proxy do not
// belong together.
[[nodiscard]] Result<VoxelView> see_voxels(const SceneTables& tables, const Proxy& proxy,
                                           const RenderSettings& settings, std::uint32_t side_max);

// As a PNG; transparent where no voxel is.
[[nodiscard]] std::string paint_voxels(const VoxelView& view,
                                       const std::function<Rgb8(std::uint32_t)>& color_of);

}  // namespace preheat
