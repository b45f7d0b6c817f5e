#include "master/import.h"

#include <fmt/format.h>
#include <xxhash.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "master/gltf_document.h"
#include "master/import_gltf.h"
#include "master/import_obj.h"
#include "master/scene_file.h"

namespace preheat {

namespace {

// Increased whenever the same files give another Scene.
constexpr std::uint64_t kImportVersion = 1;

enum class Format { kGltf, kObj };

struct ForeignFormat {
  std::string_view extension;
  std::string_view name;
};

constexpr std::array kForeignFormats{
    ForeignFormat{".3ds", "3D Studio"}, ForeignFormat{".blend", "Blender"},
    ForeignFormat{".dae", "COLLADA"},   ForeignFormat{".fbx", "FBX"},
    ForeignFormat{".off", "OFF"},       ForeignFormat{".pbrt", "pbrt"},
    ForeignFormat{".ply", "PLY"},       ForeignFormat{".stl", "STL"},
    ForeignFormat{".usd", "USD"},       ForeignFormat{".usda", "USD"},
    ForeignFormat{".usdc", "USD"},      ForeignFormat{".usdz", "USD"},
    ForeignFormat{".x3d", "X3D"},       ForeignFormat{".xml", "XML"},
};

constexpr std::string_view kSupported =
    "supported are glTF 2.0 (.gltf, .glb) and Wavefront OBJ (.obj)";

tl::unexpected<Error> rejected(const std::filesystem::path& file, std::string_view why) {
  return fail(ExitCode::kSceneRejected, fmt::format("{}: {}", file.string(), why));
}

std::string extension_of(const std::filesystem::path& file) {
  std::string extension = file.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return extension;
}

Result<Format> detect_format(const std::filesystem::path& file) {
  const auto mapped = MappedFile::open(file);
  if (!mapped) { return tl::unexpected(mapped.error()); }
  const std::string_view text = mapped->text();
  if (text.empty()) { return rejected(file, "the file is empty"); }
  if (text.starts_with("glTF")) { return Format::kGltf; }
  const std::string extension = extension_of(file);
  if (extension == ".gltf" || extension == ".glb") { return Format::kGltf; }
  if (extension == ".obj") { return Format::kObj; }
  for (const ForeignFormat& format : kForeignFormats) {
    if (extension == format.extension) {
      return rejected(file, fmt::format("{} files are not supported; {}", format.name, kSupported));
    }
  }
  return rejected(file, fmt::format("not a known scene format; {}", kSupported));
}

// Errors from inside a file do not know its name; those about files begin with it.
Error with_name(Error error, const std::filesystem::path& file) {
  if (!error.message.starts_with(file.string())) {
    error.message = fmt::format("{}: {}", file.string(), error.message);
  }
  return error;
}

}  // namespace

Result<Scene> import_scene(const std::filesystem::path& file) {
  const auto format = detect_format(file);
  if (!format) { return tl::unexpected(format.error()); }
  auto scene = *format == Format::kGltf ? import_gltf(file) : import_obj(file);
  if (!scene) { return tl::unexpected(with_name(scene.error(), file)); }
  return scene;
}

Result<Hash128> hash_scene_files(const std::filesystem::path& file) {
  const auto format = detect_format(file);
  if (!format) { return tl::unexpected(format.error()); }
  auto listed =
      *format == Format::kGltf ? list_gltf_buffer_files(file) : list_obj_material_files(file);
  if (!listed) { return tl::unexpected(with_name(listed.error(), file)); }
  listed->insert(listed->begin(), file);

  const std::unique_ptr<XXH3_state_t, decltype(&XXH3_freeState)> state(XXH3_createState(),
                                                                       XXH3_freeState);
  XXH3_128bits_reset_withSeed(state.get(), kImportVersion);
  for (const std::filesystem::path& path : *listed) {
    const auto mapped = MappedFile::open(path);
    if (!mapped) { return tl::unexpected(with_name(mapped.error(), file)); }
    // With its length, bytes that move from one file to the next change the hash.
    const std::uint64_t size = mapped->bytes().size();
    XXH3_128bits_update(state.get(), &size, sizeof size);
    XXH3_128bits_update(state.get(), mapped->bytes().data(), mapped->bytes().size());
  }
  const XXH128_hash_t digest = XXH3_128bits_digest(state.get());
  return Hash128{digest.low64, digest.high64};
}

}  // namespace preheat
