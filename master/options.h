// What a user writes on the command line, as values. Every limit is checked here, and a wrong value
// is a usage error that names the thing, the limit and the value.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "common/byte_size.h"
#include "common/limits.h"
#include "common/result.h"
#include "common/secure_transport.h"
#include "common/vec3.h"
#include "master/master.h"

namespace CLI {
class App;
}

namespace preheat {

struct ImageSize {
  std::uint32_t width = 512;
  std::uint32_t height = 512;
};

inline constexpr unsigned kWorkersMax = 256;

// As parse_bytes, or "25%" of the scene's resident size: more than 0 %, at most 100 %.
[[nodiscard]] Result<CacheSize> parse_cache_size(const std::string& text);
// "640x480".
[[nodiscard]] Result<ImageSize> parse_image_size(const std::string& text);
// "1,2.5,-3e2"; finite.
[[nodiscard]] Result<Vec3d> parse_vector(const std::string& text);
// "r,g,b"; finite, not negative.
[[nodiscard]] Result<Vec3> parse_radiance(const std::string& text);
// A whole number in 0..2^64-1.
[[nodiscard]] Result<std::uint64_t> parse_seed(const std::string& text);
// "auto", which is a negative number here, or a share in [0,1].
[[nodiscard]] Result<double> parse_preload_share(const std::string& text);
[[nodiscard]] Result<AccessCounting> parse_access_counting(const std::string& text);
// "tcp://HOST:PORT", a port in 1..65535, * or 0 (any free one).
[[nodiscard]] Result<std::string> parse_address(const std::string& text);

// From where, how large and how well to look. What is absent is decided by the scene.
struct ViewOptions {
  std::optional<std::string> camera{};  // name, or index from 0
  std::optional<Vec3d> eye{};           // file units
  std::optional<Vec3d> look_at{};
  std::optional<Vec3d> up{};
  std::optional<double> fov_deg{};  // vertical
  ImageSize size{};
  std::uint32_t spp = 16;
  std::uint32_t bounces = 4;
  std::uint64_t seed = 0;
  std::optional<Vec3> sky{};
};

// Of an option given several times the last one counts.
void add_view_options(CLI::App& app, ViewOptions& view);

// Which scene, and how it is compiled where it is not a store already.
struct SceneOptions {
  std::string scene{};
  std::uint64_t voxel_size_bytes = 0;  // 0 = the compiler's choice
  std::string store_cache{};           // folder; empty = the user's cache folder
  unsigned threads = 0;                // 0 = all cores
};

void add_scene_options(CLI::App& app, SceneOptions& scene);

}  // namespace preheat
