#include "tests/bench/real_cache_render.h"

#include <sys/resource.h>

#include <chrono>
#include <utility>

#include "cache/doorbell.h"
#include "cache/local_residency.h"
#include "common/film.h"

namespace preheat {
namespace {

double user_seconds() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_utime.tv_sec) +
         static_cast<double>(usage.ru_utime.tv_usec) * 1e-6;
}

}  // namespace

Result<RealCacheRender> render_with_cache(const Store& store, const RenderSettings& settings,
                                          const RendererOptions& options,
                                          const std::vector<VoxelId>& hot) {
  Doorbell doorbell;
  Renderer renderer(store.tables(), settings, options, [&doorbell] { doorbell.ring(); });
  renderer.set_hot_voxels(hot);
  for (const VoxelId voxel : hot) {
    if (auto done = deliver_from(store, voxel, renderer); !done) {
      return tl::unexpected(done.error());
    }
  }
  const TileGrid grid{settings.width, settings.height, options.tile_size};
  Film film(settings.width, settings.height);
  double begin = 0.0;
  for (std::uint32_t tiles_done = 0; tiles_done < grid.count();) {
    doorbell.wait_for(std::chrono::milliseconds(100));
    for (RendererEvent& event : renderer.take_events()) {
      if (const auto* const needed = std::get_if<VoxelNeeded>(&event)) {
        if (auto done = deliver_from(store, needed->voxel, renderer); !done) {
          return tl::unexpected(done.error());
        }
      } else if (const auto* const tile = std::get_if<TileDone>(&event)) {
        film.assign(grid.rect(tile->tile), tile->pixels);
        ++tiles_done;
      } else if (const auto* const failed = std::get_if<RendererFailed>(&event)) {
        return tl::unexpected(failed->error);
      } else {
        begin = user_seconds();
        for (std::uint32_t id = 0; id < grid.count(); ++id) { renderer.add_tile(TileId{id}); }
      }
    }
  }
  return RealCacheRender{film.pixels_sha256(), renderer.stats().cache, user_seconds() - begin};
}

}  // namespace preheat
