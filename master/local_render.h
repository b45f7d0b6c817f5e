// Renders in this process, the whole scene in one BVH: the reference for every image and every
// speed.
#pragma once

#include <atomic>
#include <functional>

#include "common/limits.h"
#include "common/render_settings.h"
#include "common/result.h"
#include "common/store.h"
#include "master/master.h"

namespace preheat {

struct LocalOptions {
  unsigned threads = 1;
  std::uint32_t tile_size = 32;
  AccessCounting count_accesses = AccessCounting::kSampled;
  std::uint32_t paths_per_thread = kPathsPerThread;  // in flight
  RenderWatch* watch = nullptr;  // nullptr = nobody looks on
};

// As run_master; the one worker of the result is this process.
[[nodiscard]] Result<MasterResult> render_local(
    const Store& store, const RenderSettings& settings, const LocalOptions& options,
    const std::atomic<int>& stop_signal,
    const std::function<void(const MasterProgress&)>& progress);

}  // namespace preheat
