// Runs one worker process from its first Hello to its exit code: moves messages between the sockets
// and the session, and the session's wishes to the renderer. Decides nothing.
#pragma once

#include <atomic>
#include <cstdint>
#include <string>

#include "common/clock.h"
#include "common/eviction.h"
#include "common/messages.h"
#include "common/result.h"
#include "common/secure_transport.h"

namespace preheat {

struct WorkerOptions {
  std::string connect{};  // the master's control socket
  CacheRequestKind cache_kind = CacheRequestKind::kMasterDecides;
  double cache_share = 0.0;
  std::uint64_t cache_bytes = 0;
  unsigned threads = 1;
  double give_up_seconds = 60.0;  // without a word from the master
  // Where other workers ask for voxels; empty: a port beside the own end of the way to the master.
  std::string peer_listen{};
  bool keep = false;  // serve one master after the other
  Eviction eviction = kEvictionDefault;
  SecurityOptions security{};
};

// `stop_signal` is set by a signal handler (0 = none), which also makes `wake_fd`, an eventfd,
// readable. Returns when the job is done, or with `keep` when there is an error that no other
// master will mend; anything but a done job is an error whose code is the exit code.
[[nodiscard]] Result<void> run_worker(const WorkerOptions& options,
                                      const std::atomic<int>& stop_signal, int wake_fd);

}  // namespace preheat
