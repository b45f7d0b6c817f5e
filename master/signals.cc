#include "master/signals.h"

#include <unistd.h>

#include <csignal>

namespace preheat {
namespace {

std::atomic<int> stop_signal{0};
static_assert(std::atomic<int>::is_always_lock_free);  // or a handler could not touch it

void on_signal(int signal) {
  if (stop_signal.exchange(signal) != 0) { ::_exit(128 + signal); }
}

}  // namespace

const std::atomic<int>& catch_stop_signals() {
  struct sigaction action {};
  action.sa_handler = on_signal;
  sigemptyset(&action.sa_mask);
  action.sa_flags = 0;  // blocking calls return, so that loops see the flag
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
  return stop_signal;
}

ExitCode exit_code_of_signal(int signal) {
  return signal == SIGINT ? ExitCode::kInterrupted : ExitCode::kTerminated;
}

}  // namespace preheat
