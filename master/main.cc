// `preheat`: compiles, inspects, predicts, renders and compares. See README.md.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <exception>

#include "master/commands.h"

namespace preheat {
namespace {

int code_of(ExitCode code) { return static_cast<int>(code); }

// Help and version go to stdout; everything else is a usage error in one line.
int report_parse_end(const CLI::App& app, const CLI::ParseError& end) {
  if (end.get_exit_code() == 0) { return app.exit(end); }
  fmt::print(stderr, "preheat: {}\n", end.what());
  return code_of(ExitCode::kUsage);
}

int run(int argument_count, char** arguments) {
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
  add_render_command(app, chosen);
  add_compare_command(app, chosen);
  app.footer(
      "`preheat COMMAND --help` explains a command.\n"
      "Exit codes: 0 done, 1 failed, 2 usage, 3 no workers in time, 4 master gone, "
      "5 store damaged, 6 output cannot be written, 7 mismatch, 8 poisoned tile, "
      "9 scene rejected, 130 and 143 on signals.");
  try {
    app.parse(argument_count, arguments);
  } catch (const CLI::ParseError& end) { return report_parse_end(app, end); }
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
