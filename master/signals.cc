#include "master/signals.h"

#include <unistd.h>

#include <csignal>

namespace preheat {
namespace {

std::atomic<int> stop_signal{0};
std::atomic<bool> reload{false};
// Or a handler could not touch them.
static_assert(std::atomic<int>::is_always_lock_free && std::atomic<bool>::is_always_lock_free);

void on_hangup(int /*signal*/) { reload.store(true); }

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

std::atomic<bool>& catch_reload_signal() {
  struct sigaction action {};
  action.sa_handler = on_hangup;
  sigemptyset(&action.sa_mask);
  action.sa_flags = 0;
  sigaction(SIGHUP, &action, nullptr);
  return reload;
}

ExitCode exit_code_of_signal(int signal) {
  return signal == SIGINT ? ExitCode::kInterrupted : ExitCode::kTerminated;
}

}  // namespace preheat
