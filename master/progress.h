// How a render is going, on stderr: one line redrawn on a terminal, a plain line now and then in a
// log file.
#pragma once

#include <cstdio>
#include <string>

#include "master/master.h"

namespace preheat {

// "37% 96/256 tiles  1.84 Mray/s  hit 97.1%  2 workers  0:21 left". What is not known is left out.
[[nodiscard]] std::string format_progress(const MasterProgress& progress);

class ProgressPrinter {
 public:
  // Draws on `stream`, which outlives it; redraws if `is_terminal`.
  ProgressPrinter(std::FILE* stream, bool is_terminal);

  // `progress.seconds` is the clock: plain lines come every ten of them.
  void update(const MasterProgress& progress);
  // Leaves the cursor at the start of an empty line.
  void finish();

 private:
  std::FILE* stream_;
  bool is_terminal_;
  bool has_line_ = false;
  double next_seconds_ = 10.0;
};

}  // namespace preheat
