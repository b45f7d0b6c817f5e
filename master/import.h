// Reads a scene file, glTF 2.0 (.gltf, .glb) or Wavefront OBJ with MTL (.obj), into a Scene.
//
// Files are untrusted. Whatever is wrong with one is an Error with kSceneRejected and a message
// that names the file and the fault: nothing outside the scene's folder is opened, no count is
// believed before it was compared with the bytes that are there, and no input makes the process
// crash, hang or allocate out of proportion to the files' size.
// Textures are not read: the factor that a texture would scale is used, and a note says so.
#pragma once

#include <filesystem>

#include "common/result.h"
#include "common/scene.h"
#include "common/scene_tables.h"

namespace preheat {

// The format is told by the content where it has a mark, else by the extension.
[[nodiscard]] Result<Scene> import_scene(const std::filesystem::path& file);

// Names what import_scene would read: a hash over the bytes of the file and of every buffer or
// material library that it refers to, in order. It also changes with the importer's own version, so
// that a compiled scene under this name is never older than the rules it was imported by.
[[nodiscard]] Result<Hash128> hash_scene_files(const std::filesystem::path& file);

}  // namespace preheat
