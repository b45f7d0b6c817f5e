// SCENE or STORE, as a user names it -> an open store. A scene file is compiled first, into a cache
// folder under a name made of its content and the compiler's options, so that the next time it is
// only opened.
#pragma once

#include <filesystem>
#include <string>

#include "common/result.h"
#include "common/store.h"
#include "master/options.h"

namespace preheat {

struct OpenedScene {
  Store store;
  double compile_seconds = 0.0;  // 0 where nothing had to be compiled
};

// Tells stderr when it compiles.
[[nodiscard]] Result<OpenedScene> open_scene(const SceneOptions& options);

// Compiles a scene file, or the demo, into `store_file`, whatever a cache holds.
[[nodiscard]] Result<OpenedScene> compile_scene_file(const SceneOptions& options,
                                                     const std::filesystem::path& store_file);

// Triangles that "demo" or "demo:10M" asks for; 0 if `scene` names a file. A wrong count after the
// colon is a usage error.
[[nodiscard]] Result<std::uint64_t> demo_triangles(const std::string& scene);

}  // namespace preheat
