#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <memory>
#include <string>

#include "master/commands.h"
#include "master/file_output.h"
#include "master/options.h"
#include "master/scene_source.h"

namespace preheat {
namespace {

struct CompileCommandOptions {
  SceneOptions scene{};
  std::string output{};
};

Result<void> compile(const CompileCommandOptions& options) {
  if (auto writable = check_output(options.output); !writable) { return writable; }
  const auto compiled = compile_scene_file(options.scene, options.output);
  if (!compiled) { return tl::unexpected(compiled.error()); }
  const Store& store = compiled->store;
  fmt::print(stderr, "{}: {} triangles in {} voxels, {} bytes, {:.2f} s\n", options.output,
             store.tables().triangle_count, store.tables().voxels.size(), store.file_bytes(),
             compiled->compile_seconds);
  return {};
}

}  // namespace

void add_compile_command(CLI::App& app, Command& chosen) {
  const auto options = std::make_shared<CompileCommandOptions>();
  CLI::App* const command = app.add_subcommand("compile", "Turn a scene file into a store");
  add_scene_options(*command, options->scene);
  command->add_option("-o,--output", options->output, "The store to write")
      ->required()
      ->type_name("FILE.store");
  command->footer("Example: preheat compile room.gltf -o room.store");
  command->callback([&chosen, options] { chosen = [options] { return compile(*options); }; });
}

}  // namespace preheat
