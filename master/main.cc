// `preheat`: one program, one file per command. See README.md.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <cstdlib>
#include <exception>

#include "common/log.h"
#include "master/commands.h"

namespace preheat {
namespace {

int code_of(ExitCode code) { return static_cast<int>(code); }

// Help and version go to stdout; everything else is a usage error in one line.
int report_parse_end(const CLI::App& app, const CLI::ParseError& end, const char* first) {
  if (end.get_exit_code() == 0) { return app.exit(end); }
  if (!app.get_subcommands().empty()) {
    fmt::print(stderr, "preheat {}: {}\n", app.get_subcommands().front()->get_name(), end.what());
    return code_of(ExitCode::kUsage);
  }
  std::string known;
  for (const CLI::App* const command : app.get_subcommands(nullptr)) {
    known += " " + command->get_name();
  }
  fmt::print(stderr, "preheat: {}; the commands are:{}\n",
             first == nullptr ? "no command" : fmt::format("'{}' is not a command", first), known);
  return code_of(ExitCode::kUsage);
}

int run(int argument_count, char** arguments) {
  // The progress line and the summary are for everyone, events for those who ask. The workers that
  // a render starts inherit this.
  ::setenv("PREHEAT_LOG", "warn", /*overwrite=*/0);
  set_up_logging("preheat");
  CLI::App app{
      "Distributed path tracer that predicts which parts of a scene will be hot and has "
      "them in every worker's cache before the first ray."};
  app.name("preheat");
  app.set_version_flag("--version", std::string("preheat ") + PREHEAT_VERSION);
  app.require_subcommand(1);
  app.failure_message(CLI::FailureMessage::simple);
  Command chosen;
  add_compile_command(app, chosen);
  add_inspect_command(app, chosen);
  add_predict_command(app, chosen);
  add_evaluate_command(app, chosen);
  add_render_command(app, chosen);
  add_compare_command(app, chosen);
  add_keygen_command(app, chosen);
  add_status_command(app, chosen);
  app.footer(
      "`preheat COMMAND --help` explains a command.\n"
      "Exit codes: 0 done, 1 failed, 2 usage, 3 no workers in time, 4 master gone, "
      "5 store damaged, 6 output cannot be written, 7 mismatch, 8 poisoned tile, "
      "9 scene rejected, 130 and 143 on signals.");
  try {
    app.parse(argument_count, arguments);
  } catch (const CLI::ParseError& end) {
    return report_parse_end(app, end, argument_count > 1 ? arguments[1] : nullptr);
  }
  const Result<void> done = chosen();
  if (done) { return code_of(ExitCode::kDone); }
  fmt::print(stderr, "preheat: {}\n", done.error().message);
  return code_of(done.error().code);
}

}  // namespace
}  // namespace preheat

int main(int argument_count, char** arguments) {
  try {
    return preheat::run(argument_count, arguments);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "preheat: %s\n", error.what());
    return 1;
  }
}
