#include "master/voxel_view.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>

#include "cache/proxy_walk.h"
#include "master/png_image.h"

namespace preheat {
namespace {

// Half of all rays are stopped before they come so far.
constexpr float kUnstopped = 0.5F;

Ray ray_through(const View& view, float x, float y) {
  const Vec3 across = view.right * x - view.up * y;
  Ray ray;
  ray.origin = view.orthographic ? view.origin + across : view.origin;
  ray.direction = view.orthographic ? view.forward : glm::normalize(view.forward + across);
  return ray;
}

}  // namespace

Result<VoxelView> see_voxels(const SceneTables& tables, const Proxy& proxy,
                             const RenderSettings& settings, std::uint32_t side_max) {
  const Result<ProxyWalk> walk = ProxyWalk::create(tables, proxy);
  if (!walk) { return tl::unexpected(walk.error()); }
  const double scale =
      std::min(1.0, static_cast<double>(side_max) / std::max(settings.width, settings.height));
  const auto shrunk = [scale](std::uint32_t side) {
    return std::max(1U, static_cast<std::uint32_t>(scale * side));
  };
  VoxelView view{shrunk(settings.width), shrunk(settings.height), {}};
  view.voxels.assign(std::size_t{view.width} * view.height, VoxelView::kNone);
  tbb::parallel_for(tbb::blocked_range<std::uint32_t>(0, view.height, 8), [&](const auto& rows) {
    std::vector<double> accesses(tables.voxels.size());  // the walk's, of no interest here
    for (std::uint32_t row = rows.begin(); row < rows.end(); ++row) {
      for (std::uint32_t column = 0; column < view.width; ++column) {
        const auto place = [](std::uint32_t index, std::uint32_t count) {
          return (2.0F * static_cast<float>(index) + 1.0F) / static_cast<float>(count) - 1.0F;
        };
        const Ray ray =
            ray_through(settings.view, place(column, view.width), place(row, view.height));
        const ProxyStop stop = walk->walk(ray, {}, kUnstopped, accesses);
        if (stop.is_stopped) {
          view.voxels[std::size_t{row} * view.width + column] = stop.leaf.voxel;
        }
      }
    }
  });
  return view;
}

std::string paint_voxels(const VoxelView& view,
                         const std::function<Rgb8(std::uint32_t)>& color_of) {
  std::vector<std::uint8_t> pixels;
  pixels.reserve(4 * view.voxels.size());
  for (const std::uint32_t voxel : view.voxels) {
    const bool seen = voxel != VoxelView::kNone;
    const Rgb8 color = seen ? color_of(voxel) : Rgb8{};
    pixels.insert(pixels.end(),
                  {color[0], color[1], color[2], static_cast<std::uint8_t>(seen ? 255 : 0)});
  }
  return encode_png(pixels, view.width, view.height, 4);
}

}  // namespace preheat
