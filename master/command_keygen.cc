#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <memory>
#include <string>

#include "common/keys.h"
#include "master/commands.h"

namespace preheat {
namespace {

struct KeygenOptions {
  std::string folder{};
  bool if_missing = false;
};

Result<void> keygen(const KeygenOptions& options) {
  if (options.if_missing && has_keys(options.folder)) {
    // There they are, but are they good?
    for (const KeyRole role : {KeyRole::kMaster, KeyRole::kWorker}) {
      if (auto keys = load_keys(options.folder, role); !keys) {
        return tl::unexpected(keys.error());
      }
    }
    return {};
  }
  if (auto made = make_keys(options.folder); !made) { return made; }
  fmt::print(stderr,
             "{0}/master  for the master, which lets in whom {0}/master/authorized_workers lists\n"
             "{0}/worker  for every worker: copy it to their machines over a safe way\n"
             "Each program takes --keys {0}\n",
             options.folder);
  return {};
}

}  // namespace

void add_keygen_command(CLI::App& app, Command& chosen) {
  const auto options = std::make_shared<KeygenOptions>();
  CLI::App* const command = app.add_subcommand(
      "keygen", "Make the keys with which a master and its workers know each other");
  command
      ->add_option("folder", options->folder,
                   "Where to; it is made, and what is in it is never overwritten")
      ->required()
      ->type_name("DIR");
  command->add_flag("--if-missing", options->if_missing,
                    "Do nothing if sound keys of master and worker are there");
  command->footer(
      "Example, for two machines:\n"
      "  preheat keygen keys\n"
      "  ssh render1 mkdir -m 700 keys && scp -pr keys/worker render1:keys/\n"
      "  preheat render room.gltf -o room.png --listen tcp://0.0.0.0:5555 --keys keys");
  command->callback([&chosen, options] { chosen = [options] { return keygen(*options); }; });
}

}  // namespace preheat
