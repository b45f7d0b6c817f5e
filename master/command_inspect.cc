#include <CLI/CLI.hpp>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>

#include "master/commands.h"
#include "master/inspect.h"
#include "master/options.h"
#include "master/scene_source.h"

namespace preheat {
namespace {

struct InspectOptions {
  SceneOptions scene{};
  std::string json{};
};

Result<void> inspect(const InspectOptions& options) {
  if (auto writable = check_text_output(options.json); !writable) { return writable; }
  const auto opened = open_scene(options.scene);
  if (!opened) { return tl::unexpected(opened.error()); }
  if (options.json != "-") {
    if (auto printed = write_text_output("-", describe_store(opened->store)); !printed) {
      return printed;
    }
  }
  return write_text_output(options.json, store_json(opened->store).dump(2) + "\n");
}

}  // namespace

void add_inspect_command(CLI::App& app, Command& chosen) {
  const auto options = std::make_shared<InspectOptions>();
  CLI::App* const command =
      app.add_subcommand("inspect", "Say what a scene or store holds and how it is cut up");
  add_scene_options(*command, options->scene);
  command->add_option("--json", options->json, "Write it here as JSON too; - for stdout")
      ->type_name("FILE");
  command->footer("Example: preheat inspect demo --json -");
  command->callback([&chosen, options] { chosen = [options] { return inspect(*options); }; });
}

}  // namespace preheat
