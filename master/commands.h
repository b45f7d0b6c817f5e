// The subcommands of `preheat`, one file each.
#pragma once

#include <functional>
#include <nlohmann/json_fwd.hpp>
#include <string>

#include "common/result.h"

namespace CLI {
class App;
}

namespace preheat {

// What the parsed command line asks for.
using Command = std::function<Result<void>()>;

// Each declares its subcommand and options on `app`; parsing one sets `chosen`.
void add_compare_command(CLI::App& app, Command& chosen);
void add_compile_command(CLI::App& app, Command& chosen);
void add_evaluate_command(CLI::App& app, Command& chosen);
void add_inspect_command(CLI::App& app, Command& chosen);
void add_keygen_command(CLI::App& app, Command& chosen);
void add_predict_command(CLI::App& app, Command& chosen);
void add_render_command(CLI::App& app, Command& chosen);
void add_status_command(CLI::App& app, Command& chosen);

// For --json and --csv: nothing asked for, "-" for stdout, or a file.
[[nodiscard]] Result<void> check_text_output(const std::string& file);
[[nodiscard]] Result<void> write_text_output(const std::string& file, const std::string& text);

}  // namespace preheat
