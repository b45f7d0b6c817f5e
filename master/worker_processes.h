// The worker processes that a master started itself: children on loopback, ended with it.
//
// Threads: one owner. Children die with the thread that started them.
#pragma once

#include <sys/types.h>

#include <string>
#include <vector>

#include "common/clock.h"
#include "common/result.h"

namespace preheat {

class WorkerProcesses {
 public:
  WorkerProcesses() = default;
  ~WorkerProcesses();  // ends what is left, at once
  WorkerProcesses(const WorkerProcesses&) = delete;
  WorkerProcesses& operator=(const WorkerProcesses&) = delete;

  // Starts one more; its stdin is empty, its stdout is our stderr, and it is no part of our process
  // group, so that Ctrl-C reaches it through us. kFailed if the program cannot be started.
  [[nodiscard]] Result<void> start(const std::string& program,
                                   const std::vector<std::string>& arguments);

  struct Ended {
    pid_t pid = 0;
    std::string how{};  // "exit 4", "signal 9"
  };
  // Children that ended since the last call.
  [[nodiscard]] std::vector<Ended> reap();

  [[nodiscard]] std::size_t running() const { return pids_.size(); }

  // Waits for all to end by themselves until `patience` is over, then asks with SIGTERM, and after
  // `grace` ends them with SIGKILL.
  void end_all(Duration patience, Duration grace);

 private:
  void signal_all(int signal) const;
  void wait_for_all(Duration patience);

  std::vector<pid_t> pids_;
};

}  // namespace preheat
