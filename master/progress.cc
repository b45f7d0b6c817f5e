#include "master/progress.h"

#include <fmt/format.h>

#include <cmath>

namespace preheat {
namespace {

constexpr double kPlainLineSeconds = 10.0;

std::string format_duration(double seconds) {
  const auto whole = static_cast<long>(std::ceil(seconds));
  if (whole < 3600) { return fmt::format("{}:{:02}", whole / 60, whole % 60); }
  return fmt::format("{}:{:02}:{:02}", whole / 3600, whole / 60 % 60, whole % 60);
}

}  // namespace

std::string format_progress(const MasterProgress& progress) {
  const double share = progress.tiles_total == 0 ? 0.0
                                                 : static_cast<double>(progress.tiles_done) /
                                                       static_cast<double>(progress.tiles_total);
  std::string line = fmt::format("{:3.0f}% {}/{} tiles", std::floor(100.0 * share),
                                 progress.tiles_done, progress.tiles_total);
  if (progress.seconds > 0.0) {
    line += fmt::format("  {:.2f} Mray/s",
                        static_cast<double>(progress.rays) / progress.seconds * 1e-6);
  }
  if (progress.hit_rate >= 0.0) { line += fmt::format("  hit {:.1f}%", 100.0 * progress.hit_rate); }
  line += fmt::format("  {} worker{}", progress.workers, progress.workers == 1 ? "" : "s");
  if (share > 0.0) {
    line += fmt::format("  {} left", format_duration(progress.seconds * (1.0 - share) / share));
  }
  return line;
}

ProgressPrinter::ProgressPrinter(std::FILE* stream, bool is_terminal)
    : stream_(stream), is_terminal_(is_terminal) {}

void ProgressPrinter::update(const MasterProgress& progress) {
  if (is_terminal_) {
    // Back to the line's start, the text, and what is left of a longer text before erased.
    fmt::print(stream_, "\r{}\x1b[K", format_progress(progress));
    std::fflush(stream_);
    has_line_ = true;
    return;
  }
  if (progress.seconds < next_seconds_) { return; }
  fmt::print(stream_, "{}\n", format_progress(progress));
  next_seconds_ = progress.seconds + kPlainLineSeconds;
}

void ProgressPrinter::finish() {
  if (!has_line_) { return; }
  fmt::print(stream_, "\r\x1b[K");
  std::fflush(stream_);
  has_line_ = false;
}

}  // namespace preheat
