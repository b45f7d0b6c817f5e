// SIGINT and SIGTERM: the first asks the program to end in order, the second ends it at once.
#pragma once

#include <atomic>

#include "common/result.h"

namespace preheat {

// Installs the handlers; call once. The value is 0 until a signal arrives, then its number.
[[nodiscard]] const std::atomic<int>& catch_stop_signals();

// SIGHUP from now on sets this, and whoever has seen to it clears it.
[[nodiscard]] std::atomic<bool>& catch_reload_signal();

[[nodiscard]] ExitCode exit_code_of_signal(int signal);

}  // namespace preheat
