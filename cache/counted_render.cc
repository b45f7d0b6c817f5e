#include "cache/counted_render.h"

#include <fmt/format.h>

#include <chrono>
#include <cstdint>
#include <utility>
#include <variant>

#include "cache/doorbell.h"
#include "cache/renderer.h"

namespace preheat {
namespace {

using Clock = std::chrono::steady_clock;

constexpr std::uint32_t kTileSize = 32;

double seconds_since(Clock::time_point begin) {
  return std::chrono::duration<double>(Clock::now() - begin).count();
}

Result<void> make_everything_hot(const Store& store, Renderer& renderer) {
  std::vector<VoxelId> voxels;
  for (std::uint32_t voxel = 0; voxel < store.tables().voxels.size(); ++voxel) {
    voxels.push_back(VoxelId{voxel});
  }
  renderer.set_hot_voxels(voxels);
  for (const VoxelId voxel : voxels) {
    if (!store.block_is_intact(voxel)) {
      return fail(ExitCode::kStoreDamaged,
                  fmt::format("store damaged: voxel {} does not have the content that its "
                              "directory names",
                              index_of(voxel)));
    }
    // The caller's store owns the mapping for as long as the renderer lives.
    if (auto delivered = renderer.deliver(voxel, VoxelBytes{store.block(voxel), nullptr});
        !delivered) {
      return delivered;
    }
  }
  return {};
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
