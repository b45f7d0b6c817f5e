#include "master/options.h"

#include <fmt/format.h>

#include <array>
#include <charconv>
#include <cmath>
#include <string_view>

#include "master/command_line.h"

namespace preheat {
namespace {

std::optional<std::uint32_t> count_in(std::string_view text) {
  std::uint32_t value = 0;
  const char* const end = text.data() + text.size();
  const auto [rest, error] = std::from_chars(text.data(), end, value);
  if (error != std::errc{} || rest != end) { return std::nullopt; }
  return value;
}

}  // namespace

Result<CacheSize> parse_cache_size(const std::string& text) {
  if (!text.ends_with('%')) {
    return parse_bytes(text).map([](std::uint64_t bytes) { return CacheSize{0.0, bytes}; });
  }
  return parse_percentage(text).map([](double share) { return CacheSize{share, 0}; });
}

Result<ImageSize> parse_image_size(const std::string& text) {
  const std::size_t cross = std::min(text.find('x'), text.size());
  const auto sides = std::string_view(text);
  const std::optional<std::uint32_t> width = count_in(sides.substr(0, cross));
  const std::optional<std::uint32_t> height =
      count_in(sides.substr(std::min(cross + 1, sides.size())));
  if (!width || !height) { return fail_to_parse(text, "an image size such as 640x480"); }
  const auto is_side = [](std::uint32_t side) { return side >= 1 && side <= kImageSideMax; };
  if (!is_side(*width) || !is_side(*height) || std::uint64_t{*width} * *height > kImagePixelsMax) {
    return fail_to_parse(text, fmt::format("within 1..{} pixels a side and {} pixels in all",
                                           kImageSideMax, kImagePixelsMax));
  }
  return ImageSize{*width, *height};
}

Result<Vec3d> parse_vector(const std::string& text) {
  Vec3d vector{0.0};
  std::string_view rest = text;
  for (int axis = 0; axis < 3; ++axis) {
    const std::size_t comma = axis < 2 ? rest.find(',') : rest.size();
    const std::optional<double> value =
        comma == std::string_view::npos ? std::nullopt : parse_number(rest.substr(0, comma));
    if (!value) { return fail_to_parse(text, "three finite numbers such as 1,2.5,-3"); }
    vector[axis] = *value;
    rest.remove_prefix(std::min(comma + 1, rest.size()));
  }
  return vector;
}

Result<Vec3> parse_radiance(const std::string& text) {
  const Result<Vec3d> vector = parse_vector(text);
  if (!vector) { return tl::unexpected(vector.error()); }
  const auto radiance = Vec3(*vector);
  for (int channel = 0; channel < 3; ++channel) {
    if (radiance[channel] < 0.0F || !std::isfinite(radiance[channel])) {
      return fail_to_parse(text, "three numbers of at least 0 such as 0.5,0.5,1");
    }
  }
  return radiance;
}

Result<std::uint64_t> parse_seed(const std::string& text) {
  std::uint64_t seed = 0;
  const char* const end = text.data() + text.size();
  const auto [rest, error] = std::from_chars(text.data(), end, seed);
  if (error != std::errc{} || rest != end) {
    return fail_to_parse(text, "a whole number in 0..2^64-1");
  }
  return seed;
}

Result<double> parse_preload_share(const std::string& text) {
  if (text == "auto") { return -1.0; }
  const std::optional<double> share = parse_number(text);
  if (!share || *share < 0.0 || *share > 1.0) { return fail_to_parse(text, "auto or within 0..1"); }
  return *share;
}

Result<AccessCounting> parse_access_counting(const std::string& text) {
  if (text == "exact") { return AccessCounting::kExact; }
  if (text == "sampled") { return AccessCounting::kSampled; }
  if (text == "none") { return AccessCounting::kNone; }
  return fail_to_parse(text, "exact, sampled or none");
}

Result<std::string> parse_address(const std::string& text) {
  constexpr std::string_view kScheme = "tcp://";
  const std::size_t colon = text.rfind(':');
  if (text.starts_with(kScheme) && colon > kScheme.size() && colon != std::string::npos) {
    const std::string_view port = std::string_view(text).substr(colon + 1);
    const std::optional<std::uint32_t> number = count_in(port);
    if (port == "*" || (number && *number <= 65535)) { return text; }
  }
  return fail_to_parse(text, "an address such as tcp://127.0.0.1:5555");
}

CLI::Option* add_keys_option(CLI::App& app, SecurityOptions& security) {
  return app
      .add_option("--keys", security.keys_folder,
                  "Folder made by `preheat keygen`: every connection is encrypted, and only who "
                  "holds a listed key takes part")
      ->type_name("DIR")
      ->envname("PREHEAT_KEYS");
}

void add_view_options(CLI::App& app, ViewOptions& view) {
  constexpr const char* kGroup = "View";
  app.option_defaults()->multi_option_policy(CLI::MultiOptionPolicy::TakeLast);
  const auto vector_option = [&](const char* name, std::optional<Vec3d>& target, const char* help) {
    add_parsed_option(app, name, target, &parse_vector, help)->type_name("X,Y,Z")->group(kGroup);
  };
  app.add_option("--camera", view.camera,
                 "Camera of the scene (default: the first one, else a view that frames the scene)")
      ->type_name("NAME|INDEX")
      ->group(kGroup);
  vector_option("--eye", view.eye, "Where the camera stands, in the file's units");
  vector_option("--look-at", view.look_at, "The point in the middle of the image");
  vector_option("--up", view.up, "What is upwards in the image (default: 0,1,0)");
  app.add_option("--fov", view.fov_deg, "Vertical field of view")
      ->type_name("DEGREES")
      ->check(in_range(0.001, 179.0))
      ->group(kGroup);
  add_parsed_option(app, "--size", view.size, &parse_image_size, "Image size in pixels")
      ->type_name("WxH")
      ->default_str(fmt::format("{}x{}", view.size.width, view.size.height))
      ->group(kGroup);
  app.add_option("--spp", view.spp, "Samples per pixel")
      ->type_name("N")
      ->check(in_range(1U, kSppMax))
      ->capture_default_str()
      ->group(kGroup);
  app.add_option("--bounces", view.bounces,
                 "Scattering events after the camera ray; 0 shows the lights alone")
      ->type_name("N")
      ->check(in_range(0U, kBouncesMax))
      ->capture_default_str()
      ->group(kGroup);
  add_parsed_option(app, "--seed", view.seed, &parse_seed, "Another number gives other noise")
      ->type_name("N")
      ->default_str("0")
      ->group(kGroup);
  add_parsed_option(app, "--sky", view.sky, &parse_radiance,
                    "Radiance of a constant sky (default: none if the scene has any light, else "
                    "1,1,1)")
      ->type_name("R,G,B")
      ->group(kGroup);
}

void add_scene_options(CLI::App& app, SceneOptions& scene) {
  app.option_defaults()->multi_option_policy(CLI::MultiOptionPolicy::TakeLast);
  app.add_option("SCENE", scene.scene,
                 "A .gltf, .glb or .obj file, a compiled store, or demo: the built-in scene "
                 "(demo:10M for about ten million triangles)")
      ->required();
  add_parsed_option(app, "--voxel-size", scene.voxel_size_bytes, &parse_bytes,
                    "Bytes of a voxel at most, when the scene is compiled (default: the smaller of "
                    "256KiB and 1/256 of the scene)")
      ->type_name("BYTES");
  app.add_option("--store-cache", scene.store_cache,
                 "Folder that keeps compiled scenes (default: $XDG_CACHE_HOME/preheat or "
                 "~/.cache/preheat)")
      ->type_name("DIR");
}

}  // namespace preheat
