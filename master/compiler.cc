#include "master/compiler.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <vector>

#include "common/content_hash.h"
#include "common/octree_statistics.h"
#include "common/octree_summary.h"
#include "common/proxy.h"
#include "common/scene_tables_codec.h"
#include "common/store.h"
#include "common/store_format.h"
#include "common/store_writer.h"
#include "common/voxel_block.h"
#include "master/voxel_cut.h"

namespace preheat {
namespace {

// Blocks that are encoded together before they are written: bounds the memory they take.
constexpr std::size_t kBlocksPerBatch = 256;

class StageClock {
 public:
  // Logs what was done since the last call.
  template <class... Values>
  void log(const char* stage, fmt::format_string<Values...> format, Values&&... values) {
    const auto now = std::chrono::steady_clock::now();
    const double seconds = std::chrono::duration<double>(now - last_).count();
    last_ = now;
    spdlog::info("event=compile stage={} seconds={:.3f} {}", stage, seconds,
                 fmt::format(format, std::forward<Values>(values)...));
  }

 private:
  std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
};

[[nodiscard]] tl::unexpected<Error> rejected(std::string what) {
  return fail(ExitCode::kSceneRejected, "scene: " + std::move(what));
}

// At most kNameBytesMax bytes, and no half of a UTF-8 character at the end.
[[nodiscard]] std::string shortened(const std::string& text) {
  if (text.size() <= kNameBytesMax) { return text; }
  std::size_t end = kNameBytesMax;
  while (end > 0 && (static_cast<unsigned char>(text[end]) & 0xC0U) == 0x80U) { --end; }
  return text.substr(0, end);
}

// What the store's format, and every worker, has a limit for.
[[nodiscard]] Result<void> check_limits(const Scene& scene) {
  const auto check = [](const char* what, std::size_t count, std::size_t most) -> Result<void> {
    if (count <= most) { return {}; }
    return rejected(fmt::format("{} {}, at most {}", count, what, most));
  };
  if (scene.materials.empty()) { return rejected("no material"); }
  return check("triangles", scene.triangles.size(), kTriangleCountMax)
      .and_then([&] { return check("materials", scene.materials.size(), kMaterialCountMax); })
      .and_then([&] { return check("lights", scene.lights.size(), kLightCountMax); })
      .and_then([&] { return check("cameras", scene.cameras.size(), kCameraCountMax); });
}

[[nodiscard]] std::vector<EmissiveTriangle> find_emissive(const Scene& scene) {
  std::vector<EmissiveTriangle> emissive;
  for (std::size_t id = 0; id < scene.triangles.size(); ++id) {
    const Triangle& triangle = scene.triangles[id];
    if (scene.materials[triangle.material].emission == Vec3(0.0F)) { continue; }
    EmissiveTriangle& entry = emissive.emplace_back();
    entry.triangle = static_cast<std::uint32_t>(id);
    entry.material = triangle.material;
    for (std::size_t i = 0; i < 3; ++i) {
      entry.vertices[i] = scene.positions[triangle.vertices[i]];
    }
  }
  return emissive;
}

// Everything but the voxels.
[[nodiscard]] SceneTables tables_without_voxels(const Scene& scene) {
  SceneTables tables;
  tables.frame = scene.frame;
  tables.triangle_count = scene.triangles.size();
  tables.materials = scene.materials;
  for (Material& material : tables.materials) { material.name = shortened(material.name); }
  tables.lights = scene.lights;
  tables.emissive_triangles = find_emissive(scene);
  return tables;
}

[[nodiscard]] StoreInfo describe(const OctreeStatistics& statistics) {
  StoreInfo info;
  info.voxels_internal = statistics.voxels_internal;
  info.voxels_leaf = statistics.voxels_leaf;
  info.voxels_empty = statistics.voxels_empty;
  info.level_min = statistics.level_min;
  info.level_max = statistics.level_max;
  info.depth_mean = statistics.depth_mean;
  info.blocking_mean = statistics.blocking_mean;
  info.objects_per_leaf = statistics.objects_per_leaf;
  info.traversal_cost = statistics.traversal_cost;
  return info;
}

[[nodiscard]] ImportReport shortened(ImportReport report) {
  report.notes.resize(std::min(report.notes.size(), kImportNoteCountMax));
  for (std::string& note : report.notes) { note = shortened(note); }
  return report;
}

// Encodes the voxels in batches and writes each batch in order, so that offsets follow the ids.
[[nodiscard]] Result<void> write_voxels(const Scene& scene, const Octree& octree,
                                        const VoxelCut& cut, StoreWriter& writer,
                                        std::vector<VoxelEntry>& voxels) {
  voxels.resize(cut.roots.size());
  std::vector<std::vector<std::byte>> blocks(kBlocksPerBatch);
  for (std::size_t begin = 0; begin < voxels.size(); begin += kBlocksPerBatch) {
    const std::size_t end = std::min(voxels.size(), begin + kBlocksPerBatch);
    tbb::parallel_for(begin, end, [&](std::size_t i) {
      const std::vector<std::uint32_t> ids = triangles_below(octree, cut.roots[i]);
      voxels[i].triangle_count = static_cast<std::uint32_t>(ids.size());
      if (voxel_block_bytes(0, ids.size(), false) > kVoxelBytesMax) {  // not worth encoding
        voxels[i].block_bytes = static_cast<std::uint32_t>(kVoxelBytesMax + 1);
        return;
      }
      std::vector<std::byte>& block = blocks[i - begin];
      block = encode_voxel_block(scene, ids);
      voxels[i].bounds = voxel_bounds(scene, ids, cut.cells[i]);
      voxels[i].block_bytes =
          static_cast<std::uint32_t>(std::min(block.size(), kVoxelBytesMax + 1));
      voxels[i].resident_bytes = block.size() + bvh_bytes_bound(ids.size());
      voxels[i].hash = content_hash(block);
    });
    for (std::size_t i = begin; i < end; ++i) {
      if (voxels[i].block_bytes > kVoxelBytesMax) {
        return rejected(
            fmt::format("{} triangles lie so close together that they cannot be split: "
                        "a voxel has at most {} bytes",
                        voxels[i].triangle_count, kVoxelBytesMax));
      }
      voxels[i].block_offset = writer.blocks_bytes();
      if (Result<void> written = writer.append_block(blocks[i - begin]); !written) {
        return written;
      }
    }
  }
  return {};
}

[[nodiscard]] Result<void> compile(const Scene& scene, const std::string& source_file,
                                   Hash128 source_hash, const CompileOptions& options,
                                   const std::filesystem::path& store_file) {
  StageClock clock;
  if (Result<void> limits = check_limits(scene); !limits) { return limits; }
  // Before the work: a folder that cannot be written is found at once.
  Result<StoreWriter> writer = StoreWriter::create(store_file);
  if (!writer) { return tl::unexpected(writer.error()); }

  OctreeLimits limits = options.octree;
  limits.threads = options.threads;
  const Octree octree = build_octree(scene, limits);
  clock.log("octree", "triangles={} nodes={} references={}", scene.triangles.size(),
            octree.nodes.size(), octree.references.size());

  const OctreeSummary summary = build_octree_summary(scene, octree);
  StoreInfo info = describe(statistics_of(summary.sums()));
  info.source_file = shortened(source_file);
  info.source_hash = source_hash;
  info.import = shortened(scene.import);
  info.voxel_size_bytes =
      options.voxel_size_bytes == 0 ? default_voxel_size(scene) : options.voxel_size_bytes;
  clock.log("statistics",
            "depth_mean={:.2f} blocking_mean={:.4f} traversal_cost={:.2f} nodes_kept={}",
            info.depth_mean, info.blocking_mean, info.traversal_cost, summary.nodes.size());

  VoxelCut cut = cut_into_voxels(scene, octree, info.voxel_size_bytes);
  clock.log("cut", "voxels={} voxel_size_bytes={}", cut.roots.size(), info.voxel_size_bytes);

  SceneTables tables = tables_without_voxels(scene);
  if (Result<void> written = write_voxels(scene, octree, cut, *writer, tables.voxels); !written) {
    return written;
  }
  tables.voxel_nodes = std::move(cut.nodes);
  set_node_bounds(tables.voxel_nodes, tables.voxels);
  clock.log("blocks", "bytes={} resident_bytes={}", writer->blocks_bytes(),
            tables.resident_bytes());

  const Proxy proxy = build_proxy(scene, octree, cut.roots, kStoreBlocksOffset);
  clock.log("proxy", "voxels={}", cut.roots.size());

  if (const Result<void> valid = validate_scene_tables(tables); !valid) {
    return rejected(valid.error().message);
  }
  std::vector<Camera> cameras = scene.cameras;
  for (Camera& camera : cameras) { camera.name = shortened(camera.name); }
  Result<void> finished = writer->finish(info, tables, cameras, proxy, summary);
  if (finished) { clock.log("store", "file={}", store_file.string()); }
  return finished;
}

}  // namespace

Result<void> compile_scene(const Scene& scene, const std::string& source_file, Hash128 source_hash,
                           const CompileOptions& options, const std::filesystem::path& store_file) {
  const int threads =
      options.threads == 0 ? tbb::task_arena::automatic : static_cast<int>(options.threads);
  return tbb::task_arena(threads).execute(
      [&] { return compile(scene, source_file, source_hash, options, store_file); });
}

}  // namespace preheat
