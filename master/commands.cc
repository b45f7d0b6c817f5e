#include "master/commands.h"

#include <fmt/format.h>

#include <cstdio>

#include "master/file_output.h"

namespace preheat {

Result<void> check_text_output(const std::string& file) {
  if (file.empty() || file == "-") { return {}; }
  return check_output(file);
}

Result<void> write_text_output(const std::string& file, const std::string& text) {
  if (file.empty()) { return {}; }
  if (file != "-") { return write_output(file, text); }
  if (std::fwrite(text.data(), 1, text.size(), stdout) != text.size() || std::fflush(stdout) != 0) {
    return fail(ExitCode::kOutputUnwritable, "cannot write standard output");
  }
  return {};
}

}  // namespace preheat
