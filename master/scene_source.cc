#include "master/scene_source.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <string_view>
#include <system_error>

#include "common/content_hash.h"
#include "common/store_format.h"
#include "master/compiler.h"
#include "master/demo_scene.h"
#include "master/import.h"

namespace preheat {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view kDemo = "demo";

// A scene's name for the cache: equal for equal content.
Result<Hash128> hash_source(const SceneOptions& options, std::uint64_t demo) {
  if (demo == 0) { return hash_scene_files(options.scene); }
  const std::string name = fmt::format("demo {} version {}", demo, kDemoVersion);
  return content_hash(std::as_bytes(std::span(name)));
}

Result<fs::path> cache_folder(const SceneOptions& options) {
  if (!options.store_cache.empty()) { return fs::path(options.store_cache); }
  if (const char* const cache = std::getenv("XDG_CACHE_HOME"); cache != nullptr && *cache != 0) {
    return fs::path(cache) / "preheat";
  }
  if (const char* const home = std::getenv("HOME"); home != nullptr && *home != 0) {
    return fs::path(home) / ".cache" / "preheat";
  }
  return fail(ExitCode::kUsage,
              "neither HOME nor XDG_CACHE_HOME is set: name a folder with --store-cache DIR");
}

// Everything that a store's content depends on is in its name.
Result<fs::path> cached_store(const SceneOptions& options, const Hash128& source) {
  const Result<fs::path> folder = cache_folder(options);
  if (!folder) { return folder; }
  std::error_code error;
  fs::create_directories(*folder, error);
  if (error) {
    return fail(ExitCode::kOutputUnwritable,
                fmt::format("cannot create the store cache {}: {}; name another with --store-cache",
                            folder->string(), error.message()));
  }
  const std::string key =
      fmt::format("{:016x}{:016x} voxel {} store {} preheat {}", source.high, source.low,
                  options.voxel_size_bytes, kStoreVersion, PREHEAT_VERSION);
  const Hash128 name = content_hash(std::as_bytes(std::span(key)));
  std::string stem = fs::path(options.scene).stem().string();
  std::replace_if(
      stem.begin(), stem.end(), [](unsigned char c) { return std::isalnum(c) == 0; }, '_');
  return *folder / fmt::format("{}-{}.store", stem.substr(0, 64), to_string(name));
}

Result<OpenedScene> compile_to(const SceneOptions& options, std::uint64_t demo,
                               const Hash128& source, const fs::path& store_file) {
  const auto began = std::chrono::steady_clock::now();
  Result<Scene> scene =
      demo == 0 ? import_scene(options.scene) : Result<Scene>(make_demo_scene(demo));
  if (!scene) { return tl::unexpected(scene.error()); }
  CompileOptions compile;
  compile.voxel_size_bytes = options.voxel_size_bytes;
  compile.threads = options.threads;
  auto compiled = compile_scene(*scene, options.scene, source, compile, store_file);
  if (!compiled) { return tl::unexpected(compiled.error()); }
  Result<Store> store = Store::open(store_file);
  if (!store) { return tl::unexpected(store.error()); }
  const std::chrono::duration<double> spent = std::chrono::steady_clock::now() - began;
  return OpenedScene{*std::move(store), spent.count()};
}

// What is neither a store nor a scene by its name is said to be a damaged store only if it is
// called one; the importer knows best which formats there are.
bool is_store(const fs::path& file) {
  std::array<char, kStoreMagic.size()> magic{};
  std::ifstream stream(file, std::ios::binary);
  stream.read(magic.data(), magic.size());
  const bool has_magic = stream && magic == kStoreMagic;
  return has_magic || file.extension() == ".store";
}

}  // namespace

Result<std::uint64_t> demo_triangles(const std::string& scene) {
  if (!scene.starts_with(kDemo)) { return 0; }
  const std::string_view rest = std::string_view(scene).substr(kDemo.size());
  if (rest.empty()) { return kDemoTrianglesDefault; }
  if (!rest.starts_with(':')) { return 0; }
  std::string number(rest.substr(1));
  double unit = 1.0;
  if (number.ends_with('M')) {
    unit = 1e6;
    number.pop_back();
  } else if (number.ends_with('k')) {
    unit = 1e3;
    number.pop_back();
  }
  char* end = nullptr;
  const double triangles = std::strtod(number.c_str(), &end) * unit;
  if (number.empty() || *end != 0 || !(triangles >= static_cast<double>(kDemoTrianglesMin)) ||
      !(triangles <= static_cast<double>(kDemoTrianglesMax))) {
    return fail(ExitCode::kUsage,
                fmt::format("scene '{}': the demo has between {} and {} triangles, e.g. demo:10M",
                            scene, kDemoTrianglesMin, kDemoTrianglesMax));
  }
  return static_cast<std::uint64_t>(triangles);
}

Result<OpenedScene> open_scene(const SceneOptions& options) {
  const Result<std::uint64_t> demo = demo_triangles(options.scene);
  if (!demo) { return tl::unexpected(demo.error()); }
  if (*demo == 0 && is_store(options.scene)) {
    return Store::open(options.scene).map([](Store store) {
      return OpenedScene{std::move(store), 0.0};
    });
  }
  const Result<Hash128> source = hash_source(options, *demo);
  if (!source) { return tl::unexpected(source.error()); }
  const Result<fs::path> store_file = cached_store(options, *source);
  if (!store_file) { return tl::unexpected(store_file.error()); }
  std::error_code ignored;
  if (fs::exists(*store_file, ignored)) {
    Result<Store> store = Store::open(*store_file);
    if (store) { return OpenedScene{*std::move(store), 0.0}; }
    fmt::print(stderr, "{}; compiling it again\n", store.error().message);
  }
  fmt::print(stderr, "compiling {} into {}\n", options.scene, store_file->string());
  return compile_to(options, *demo, *source, *store_file);
}

Result<OpenedScene> compile_scene_file(const SceneOptions& options, const fs::path& store_file) {
  const Result<std::uint64_t> demo = demo_triangles(options.scene);
  if (!demo) { return tl::unexpected(demo.error()); }
  const Result<Hash128> source = hash_source(options, *demo);
  if (!source) { return tl::unexpected(source.error()); }
  return compile_to(options, *demo, *source, store_file);
}

}  // namespace preheat
