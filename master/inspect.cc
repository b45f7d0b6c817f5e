#include "master/inspect.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <bit>
#include <cstdint>
#include <iterator>
#include <map>
#include <vector>

#include "common/content_hash.h"
#include "common/scene_tables.h"

namespace preheat {
namespace {

// Sizes of one kind, summed up.
struct Spread {
  std::uint64_t least = 0;
  std::uint64_t median = 0;
  std::uint64_t most = 0;
  std::uint64_t sum = 0;
};

[[nodiscard]] Spread spread_of(std::vector<std::uint64_t> sizes) {
  if (sizes.empty()) { return {}; }
  std::sort(sizes.begin(), sizes.end());
  Spread spread{sizes.front(), sizes[sizes.size() / 2], sizes.back(), 0};
  for (const std::uint64_t size : sizes) { spread.sum += size; }
  return spread;
}

template <class Size>
[[nodiscard]] Spread spread_over_voxels(const SceneTables& tables, Size&& size) {
  std::vector<std::uint64_t> sizes;
  sizes.reserve(tables.voxels.size());
  std::transform(tables.voxels.begin(), tables.voxels.end(), std::back_inserter(sizes), size);
  return spread_of(std::move(sizes));
}

[[nodiscard]] Spread block_spread(const SceneTables& tables) {
  return spread_over_voxels(tables, [](const VoxelEntry& voxel) { return voxel.block_bytes; });
}
[[nodiscard]] Spread triangle_spread(const SceneTables& tables) {
  return spread_over_voxels(tables, [](const VoxelEntry& voxel) { return voxel.triangle_count; });
}

// How many voxels have blocks of at least each power of two, and less than the next.
[[nodiscard]] std::map<std::uint64_t, std::uint64_t> block_histogram(const SceneTables& tables) {
  std::map<std::uint64_t, std::uint64_t> histogram;
  for (const VoxelEntry& voxel : tables.voxels) { ++histogram[std::bit_floor(voxel.block_bytes)]; }
  return histogram;
}

[[nodiscard]] std::string bytes_text(std::uint64_t bytes) {
  constexpr const char* kUnits[] = {"B", "KiB", "MiB", "GiB", "TiB"};
  double value = static_cast<double>(bytes);
  std::size_t unit = 0;
  for (; value >= 1024.0 && unit + 1 < std::size(kUnits); ++unit) { value /= 1024.0; }
  return unit == 0 ? fmt::format("{} B", bytes) : fmt::format("{:.1f} {}", value, kUnits[unit]);
}

[[nodiscard]] double share(std::uint64_t part, std::uint64_t whole) {
  return whole == 0 ? 0.0 : static_cast<double>(part) / static_cast<double>(whole);
}

[[nodiscard]] std::uint64_t voxels_of_octree(const StoreInfo& info) {
  return info.voxels_internal + info.voxels_leaf + info.voxels_empty;
}

void describe_scene(const Store& store, std::string& text) {
  const auto out = std::back_inserter(text);
  const StoreInfo& info = store.info();
  const SceneTables& tables = store.tables();
  fmt::format_to(out, "source            {} ({})\n", info.source_file, to_string(info.source_hash));
  fmt::format_to(out, "scene hash        {}\n", to_string(store.scene_hash()));
  fmt::format_to(out, "triangles         {} of {} declared; {} not finite, {} without area\n",
                 tables.triangle_count, info.import.triangles_declared,
                 info.import.triangles_non_finite, info.import.triangles_zero_area);
  fmt::format_to(out, "materials         {}\n", tables.materials.size());
  fmt::format_to(out, "lights            {} emissive triangles, {} punctual\n",
                 tables.emissive_triangles.size(), tables.lights.size());
  fmt::format_to(out, "cameras           {}\n", store.cameras().size());
  const Features features = detect_features(tables);
  fmt::format_to(out, "modelled          {}\n", fmt::join(features.modelled(), ", "));
  fmt::format_to(out, "left out          {}\n", fmt::join(features.left_out(), ", "));
  for (const std::string& note : info.import.notes) {
    fmt::format_to(out, "note              {}\n", note);
  }
}

void describe_octree(const StoreInfo& info, std::string& text) {
  const auto out = std::back_inserter(text);
  fmt::format_to(out, "\noctree\n");
  fmt::format_to(out, "  voxels          {}\n", voxels_of_octree(info));
  fmt::format_to(out, "  internal voxels {}\n", info.voxels_internal);
  fmt::format_to(out, "  leaf voxels     {}\n", info.voxels_leaf);
  fmt::format_to(out, "  empty voxels    {}\n", info.voxels_empty);
  fmt::format_to(out, "  min level       {}\n", info.level_min);
  fmt::format_to(out, "  max level       {}\n", info.level_max);
  fmt::format_to(out, "  mean depth      {:.3f}\n", info.depth_mean);
  fmt::format_to(out, "  mean blocking   {:.4f}\n", info.blocking_mean);
  fmt::format_to(out, "  objects a leaf  {:.2f}\n", info.objects_per_leaf);
  fmt::format_to(out, "  traversal cost  {:.2f} leaves a ray\n", info.traversal_cost);
}

void describe_voxels(const Store& store, std::string& text) {
  const auto out = std::back_inserter(text);
  const SceneTables& tables = store.tables();
  const Spread blocks = block_spread(tables);
  const Spread triangles = triangle_spread(tables);
  fmt::format_to(out, "\nunits of caching\n");
  fmt::format_to(out, "  count           {}, cut to {}\n", tables.voxels.size(),
                 bytes_text(store.info().voxel_size_bytes));
  fmt::format_to(out, "  triangles each  {} to {}, median {}; {:.3f} times the scene's in all\n",
                 triangles.least, triangles.most, triangles.median,
                 share(triangles.sum, tables.triangle_count));
  fmt::format_to(out, "  block each      {} to {}, median {}\n", bytes_text(blocks.least),
                 bytes_text(blocks.most), bytes_text(blocks.median));
  for (const auto& [bytes, count] : block_histogram(tables)) {
    fmt::format_to(out, "    from {:>9} {:>6}\n", bytes_text(bytes), count);
  }
  fmt::format_to(out, "  resident size   {}, one at least {}\n",
                 bytes_text(tables.resident_bytes()), bytes_text(tables.resident_bytes_min()));
}

}  // namespace

std::string describe_store(const Store& store) {
  std::string text;
  describe_scene(store, text);
  describe_octree(store.info(), text);
  describe_voxels(store, text);
  fmt::format_to(std::back_inserter(text), "\nstore             {}\n",
                 bytes_text(store.file_bytes()));
  for (const auto& [name, bytes] : store.section_bytes()) {
    fmt::format_to(std::back_inserter(text), "  {:<15} {:>11} {:>6.2f} %\n", name,
                   bytes_text(bytes), 100.0 * share(bytes, store.file_bytes()));
  }
  return text;
}

nlohmann::json store_json(const Store& store) {
  const StoreInfo& info = store.info();
  const SceneTables& tables = store.tables();
  const Features features = detect_features(tables);
  const auto spread_json = [](const Spread& spread) {
    return nlohmann::json{{"least", spread.least},
                          {"median", spread.median},
                          {"most", spread.most},
                          {"sum", spread.sum}};
  };
  nlohmann::json histogram = nlohmann::json::object();
  for (const auto& [bytes, count] : block_histogram(tables)) {
    histogram[std::to_string(bytes)] = count;
  }
  nlohmann::json sections = nlohmann::json::object();
  for (const auto& [name, bytes] : store.section_bytes()) { sections[name] = bytes; }
  return {{"source", {{"file", info.source_file}, {"hash", to_string(info.source_hash)}}},
          {"scene",
           {{"hash", to_string(store.scene_hash())},
            {"triangles", tables.triangle_count},
            {"materials", tables.materials.size()},
            {"emissive_triangles", tables.emissive_triangles.size()},
            {"punctual_lights", tables.lights.size()},
            {"cameras", store.cameras().size()},
            {"features_modelled", features.modelled()},
            {"features_left_out", features.left_out()}}},
          {"import",
           {{"triangles_declared", info.import.triangles_declared},
            {"triangles_non_finite", info.import.triangles_non_finite},
            {"triangles_zero_area", info.import.triangles_zero_area},
            {"notes", info.import.notes}}},
          {"octree",
           {{"voxels", voxels_of_octree(info)},
            {"internal_voxels", info.voxels_internal},
            {"leaf_voxels", info.voxels_leaf},
            {"empty_voxels", info.voxels_empty},
            {"min_level", info.level_min},
            {"max_level", info.level_max},
            {"depth_mean", info.depth_mean},
            {"blocking_mean", info.blocking_mean},
            {"objects_per_leaf", info.objects_per_leaf},
            {"traversal_cost", info.traversal_cost}}},
          {"voxels",
           {{"count", tables.voxels.size()},
            {"size_limit_bytes", info.voxel_size_bytes},
            {"block_bytes", spread_json(block_spread(tables))},
            {"block_bytes_histogram", histogram},
            {"triangles", spread_json(triangle_spread(tables))},
            {"resident_bytes", tables.resident_bytes()},
            {"resident_bytes_min", tables.resident_bytes_min()}}},
          {"store", {{"bytes", store.file_bytes()}, {"sections", sections}}}};
}

}  // namespace preheat
