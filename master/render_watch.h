// Who looks on while a render runs. Told from the thread of its loop, so a watcher must be quick:
// it takes a copy and leaves the rest to a thread of its own.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/film.h"
#include "common/messages.h"
#include "common/render_settings.h"
#include "common/stats.h"

namespace preheat {

struct LeaseStats {
  std::uint64_t granted = 0;
  std::uint64_t doubled = 0;  // of these: tiles that another worker had as well
  std::uint64_t expired = 0;
  std::uint64_t duplicates = 0;
  std::uint64_t mismatches = 0;
};

enum class WorkerState : std::uint8_t { kPreparing, kReady, kGone };

struct WorkerSnapshot {
  WorkerState state = WorkerState::kPreparing;
  std::size_t threads = 1;
  std::size_t leases = 0;  // tiles that it holds
  WorkerStats stats{};     // as it told them last
};

// How far a render is at one moment.
struct RenderSnapshot {
  JobPhase phase = JobPhase::kWaiting;
  std::uint32_t tiles_done = 0;
  std::uint32_t tiles_total = 0;
  std::uint32_t workers_lost = 0;
  LeaseStats leases{};
  double waiting_seconds = 0.0;           // before the first tile
  double rendering_seconds = 0.0;         // since then
  std::vector<WorkerSnapshot> workers{};  // by WorkerId
};

// Requires of every member: it returns soon.
class RenderWatch {
 public:
  RenderWatch() = default;
  virtual ~RenderWatch() = default;
  RenderWatch(const RenderWatch&) = delete;
  RenderWatch& operator=(const RenderWatch&) = delete;

  // About ten times a second.
  virtual void look(RenderSnapshot snapshot) = 0;
  // Of the image; a tile may come again with other pixels.
  virtual void tile_done(const TileRect& rect, const TilePixels& pixels) = 0;
};

}  // namespace preheat
