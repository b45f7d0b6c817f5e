#include "cache/counted_render.h"

#include <chrono>
#include <cstdint>
#include <utility>
#include <variant>

#include "cache/doorbell.h"
#include "cache/local_residency.h"
#include "cache/renderer.h"

namespace preheat {
namespace {

using Clock = std::chrono::steady_clock;

constexpr std::uint32_t kTileSize = 32;

double seconds_since(Clock::time_point begin) {
  return std::chrono::duration<double>(Clock::now() - begin).count();
}

}  // namespace

Result<CountedRender> render_counted(const Store& store, const RenderSettings& settings,
                                     const CountedRenderOptions& options) {
  RendererOptions renderer_options;
  renderer_options.threads = options.threads;
  renderer_options.cache_limit_bytes = store.tables().resident_bytes();
  renderer_options.tile_size = kTileSize;
  renderer_options.count_accesses = options.count_accesses;
  renderer_options.counting_tree = options.counting_tree;
  Doorbell doorbell;
  Renderer renderer(store.tables(), settings, renderer_options, [&doorbell] { doorbell.ring(); });

  CountedRender counted;
  Clock::time_point begin = Clock::now();
  // The caller's store outlives the renderer.
  if (auto hot = make_everything_hot(store, renderer); !hot) { return tl::unexpected(hot.error()); }
  const TileGrid grid{settings.width, settings.height, kTileSize};
  std::uint32_t tiles_done = 0;
  while (tiles_done < grid.count()) {
    doorbell.wait_for(std::chrono::milliseconds(100));
    for (const RendererEvent& event : renderer.take_events()) {
      if (std::holds_alternative<TileDone>(event)) {
        ++tiles_done;
      } else if (const auto* const failed = std::get_if<RendererFailed>(&event)) {
        return tl::unexpected(failed->error);
      } else if (std::holds_alternative<HotSetReady>(event)) {
        counted.build_seconds = seconds_since(begin);
        begin = Clock::now();
        for (std::uint32_t tile = 0; tile < grid.count(); ++tile) {
          renderer.add_tile(TileId{tile});
        }
      }
    }
  }
  counted.trace_seconds = seconds_since(begin);
  counted.rays = renderer.stats().rays;
  counted.accesses = renderer.accesses_by_cell();
  return counted;
}

}  // namespace preheat
