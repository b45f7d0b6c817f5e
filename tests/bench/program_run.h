// Runs a program to its end and says what it cost.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "common/result.h"

namespace preheat {

struct ProgramRun {
  int exit_code = 0;  // 128 + signal where one ended it
  double wall_seconds = 0.0;
  double processor_seconds = 0.0;  // user and system, with the children it waited for
  std::uint64_t peak_bytes = 0;    // resident, of the largest process among them
};

// stdout and stderr go to `log`, replacing it. kFailed if the program cannot be started.
[[nodiscard]] Result<ProgramRun> run_program(const std::vector<std::string>& command,
                                             const std::filesystem::path& log);

}  // namespace preheat
