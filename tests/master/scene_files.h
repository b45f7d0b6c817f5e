// Scene files for the importers' tests: a folder that removes itself, and the smallest glTF.
#pragma once

#include <gtest/gtest.h>
#include <stdlib.h>

#include <cstddef>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <initializer_list>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

#include "master/import.h"

namespace preheat {

class TemporaryFolder {
 public:
  TemporaryFolder() {
    std::string name = (std::filesystem::temp_directory_path() / "preheat-test-XXXXXX").string();
    path_ = ::mkdtemp(name.data());
  }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  ~TemporaryFolder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  [[nodiscard]] const std::filesystem::path& path() const { return path_; }

  // Writes a file below the folder and gives its path.
  std::filesystem::path write(const std::filesystem::path& name, std::string_view content) const {
    const auto file = path_ / name;
    std::filesystem::create_directories(file.parent_path());
    std::ofstream(file, std::ios::binary)
        .write(content.data(), static_cast<std::streamsize>(content.size()));
    return file;
  }

 private:
  std::filesystem::path path_;
};

template <class T>
std::string bytes_of(std::initializer_list<T> values) {
  std::string bytes(values.size() * sizeof(T), '\0');
  std::memcpy(bytes.data(), values.begin(), bytes.size());
  return bytes;
}

// One triangle (0,0,0) (2,0,0) (0,1,0) by 16-bit indices, in "scene.bin": positions in bytes 0 to
// 35, indices in bytes 36 to 41.
inline nlohmann::json triangle_gltf() {
  return nlohmann::json::parse(R"({
    "asset": {"version": "2.0"},
    "scene": 0,
    "scenes": [{"nodes": [0]}],
    "nodes": [{"mesh": 0}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
    "materials": [{"name": "paint"}],
    "accessors": [
      {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
      {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"}],
    "bufferViews": [
      {"buffer": 0, "byteOffset": 0, "byteLength": 36},
      {"buffer": 0, "byteOffset": 36, "byteLength": 6}],
    "buffers": [{"byteLength": 44, "uri": "scene.bin"}]
  })");
}

inline std::string triangle_bin() {
  return bytes_of<float>({0.0F, 0.0F, 0.0F, 2.0F, 0.0F, 0.0F, 0.0F, 1.0F, 0.0F}) +
         bytes_of<std::uint16_t>({0, 1, 2, 0});
}

inline Result<Scene> import_gltf_json(const nlohmann::json& gltf,
                                      const std::string& bin = triangle_bin()) {
  const TemporaryFolder folder;
  folder.write("scene.bin", bin);
  return import_scene(folder.write("scene.gltf", gltf.dump()));
}

inline Result<Scene> import_obj_text(std::string_view obj, std::string_view mtl = "") {
  const TemporaryFolder folder;
  if (!mtl.empty()) { folder.write("scene.mtl", mtl); }
  return import_scene(folder.write("scene.obj", obj));
}

// Where a vertex of the scene lies in the file's units.
inline Vec3d file_position(const Scene& scene, std::uint32_t triangle, std::size_t corner) {
  const Vec3 position = scene.positions[scene.triangles[triangle].vertices[corner]];
  return Vec3d(position) * std::ldexp(1.0, -scene.frame.scale_exponent) + scene.frame.centre;
}

inline bool has_note(const Scene& scene, std::string_view part) {
  for (const std::string& note : scene.import.notes) {
    if (note.find(part) != std::string::npos) { return true; }
  }
  return false;
}

// True if the file was refused for the reason that `part` of the message names.
inline ::testing::AssertionResult is_rejected(const Result<Scene>& scene, std::string_view part) {
  if (scene) { return ::testing::AssertionFailure() << "accepted"; }
  if (scene.error().code != ExitCode::kSceneRejected) {
    return ::testing::AssertionFailure() << "code " << static_cast<int>(scene.error().code);
  }
  if (scene.error().message.find(part) == std::string::npos) {
    return ::testing::AssertionFailure() << "message: " << scene.error().message;
  }
  return ::testing::AssertionSuccess();
}

inline std::filesystem::path shared_scene(std::string_view name) {
  return std::filesystem::path(PREHEAT_SHARED_DIR) / "scenes" / name;
}

}  // namespace preheat

#define SKIP_WITHOUT_SHARED_SCENES()                                                       \
  if (!std::filesystem::exists(::preheat::shared_scene("INDEX.md"))) {                     \
    GTEST_SKIP() << "needs the shared scenes in " << ::preheat::shared_scene("").string(); \
  }                                                                                        \
  static_assert(true)
