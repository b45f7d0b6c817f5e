#include "tests/bench/access_trace.h"

#include <fmt/format.h>

#include <algorithm>
#include <fstream>
#include <map>
#include <optional>
#include <utility>

#include "cache/tracing.h"
#include "common/check.h"
#include "common/path.h"

namespace preheat {
namespace {

constexpr std::uint64_t kFileMagic = 0x3165636172746870;  // "phtrace1"

struct FileHead {
  std::uint64_t magic = kFileMagic;
  std::uint32_t width = 0;
  std::uint32_t height = 0;
  std::uint32_t tile_size = 0;
  std::uint32_t spp = 0;
  std::uint64_t step_count = 0;
  std::uint64_t access_count = 0;
};

template <class T>
void write(std::ostream& out, const T* values, std::size_t count) {
  out.write(reinterpret_cast<const char*>(values), static_cast<std::streamsize>(count * sizeof(T)));
}

template <class T>
void read(std::istream& in, T* values, std::size_t count) {
  in.read(reinterpret_cast<char*>(values), static_cast<std::streamsize>(count * sizeof(T)));
}

// Rays and what they entered, by depth, of the tile that is being traced.
class DepthCounts {
 public:
  DepthCounts(const SceneTables& tables, std::uint32_t depths)
      : tables_(tables),
        rays_(depths),
        entered_(depths, std::vector<std::uint32_t>(tables.voxels.size())) {}

  void count(std::uint32_t depth, const Ray& ray, float t_hit) {
    ++rays_[depth];
    for_each_cell(std::span<const VoxelNode>(tables_.voxel_nodes), ray, t_hit,
                  [&](std::uint32_t voxel) { ++entered_[depth][voxel]; });
  }

  void move_to(AccessTrace& trace, TileId tile) {
    for (std::uint32_t depth = 0; depth < rays_.size(); ++depth) {
      accesses_.clear();
      for (std::uint32_t voxel = 0; voxel < entered_[depth].size(); ++voxel) {
        if (const std::uint32_t rays = std::exchange(entered_[depth][voxel], 0U); rays > 0) {
          accesses_.push_back({VoxelId{voxel}, rays});
        }
      }
      const std::uint64_t rays = std::exchange(rays_[depth], 0U);
      if (rays > 0) { trace.add_step(tile, depth, rays, accesses_); }
    }
  }

 private:
  const SceneTables& tables_;
  std::vector<std::uint64_t> rays_;                  // [depth]
  std::vector<std::vector<std::uint32_t>> entered_;  // [depth][voxel]
  std::vector<TraceAccess> accesses_;
};

// Everything hot.
class RecordedScene {
 public:
  RecordedScene(const Store& store, const RenderSettings& settings)
      : tables_(store.tables()),
        settings_(settings),
        shading_(tables_, settings),
        mesh_(tables_, every_voxel(tables_)),
        resident_(tables_.voxels.size(), 1),
        uses_(tables_.voxels.size()),
        counts_(tables_, settings.bounces + 2) {
    for (const VoxelId voxel : every_voxel(tables_)) {
      mesh_.add(view_voxel_block(store.block(voxel), tables_.materials.size()).value());
    }
    residency_.emplace(device_, mesh_, tables_, std::vector<VoxelId>{}, resident_);
  }

  void record(const TileRect& rect, TileId tile, AccessTrace& trace) {
    for (std::uint32_t y = rect.y; y < rect.y + rect.height; ++y) {
      for (std::uint32_t x = rect.x; x < rect.x + rect.width; ++x) {
        for (std::uint32_t sample = 0; sample < settings_.spp; ++sample) {
          follow(y * settings_.width + x, sample);
        }
      }
    }
    counts_.move_to(trace, tile);
  }

 private:
  static std::vector<VoxelId> every_voxel(const SceneTables& tables) {
    std::vector<VoxelId> voxels;
    for (std::uint32_t voxel = 0; voxel < tables.voxels.size(); ++voxel) {
      voxels.push_back(VoxelId{voxel});
    }
    return voxels;
  }

  // Traces to the nearest hit, shadow rays too: what lies behind the nearest blocker is not needed.
  RayQuery trace(const Ray& ray, std::uint32_t depth) {
    RayQuery query;
    query.ray = ray;
    CHECK(residency_->trace(query, uses_) == Residency::Answer::kFinal);
    counts_.count(depth, ray, query.t_best);
    return query;
  }

  void follow(std::uint32_t pixel, std::uint32_t sample) {
    const ResidentTable::Guard guard(resident_, 0);
    PathState path;
    ShadedVertex vertex;
    vertex.scatter = shading_.start_path(pixel, sample, path);
    vertex.has_scatter_ray = true;
    for (std::uint32_t depth = 0; vertex.has_scatter_ray; ++depth) {
      const RayQuery hit = trace(vertex.scatter, depth);
      if (!hit.has_hit()) { return; }
      vertex = shading_.shade_hit(hit.ray, residency_->surface(hit), path);
      if (vertex.has_shadow_ray) { trace(vertex.shadow, depth + 1); }
    }
  }

  const SceneTables& tables_;
  const RenderSettings& settings_;
  Shading shading_;
  TracingDevice device_{2};
  HotMesh mesh_;
  ResidentTable resident_;
  VoxelUses uses_;
  std::optional<Residency> residency_;
  DepthCounts counts_;
};

}  // namespace

void AccessTrace::add_step(TileId tile, std::uint32_t depth, std::uint64_t rays,
                           std::span<const TraceAccess> accesses) {
  steps_.push_back({tile, depth, rays, accesses_.size()});
  accesses_.insert(accesses_.end(), accesses.begin(), accesses.end());
}

std::span<const TraceAccess> AccessTrace::accesses(std::size_t step) const {
  const std::uint64_t end =
      step + 1 < steps_.size() ? steps_[step + 1].begin : std::uint64_t{accesses_.size()};
  return std::span(accesses_).subspan(steps_[step].begin, end - steps_[step].begin);
}

std::uint64_t AccessTrace::bytes() const {
  return steps_.size() * sizeof(Step) + accesses_.size() * sizeof(TraceAccess);
}

Result<void> AccessTrace::save(const std::filesystem::path& file) const {
  std::ofstream out(file, std::ios::binary);
  const FileHead head{kFileMagic, grid_.width,   grid_.height,    grid_.tile_size,
                      spp_,       steps_.size(), accesses_.size()};
  write(out, &head, 1);
  write(out, steps_.data(), steps_.size());
  write(out, accesses_.data(), accesses_.size());
  if (!out.flush()) {
    return fail(ExitCode::kOutputUnwritable, fmt::format("{} cannot be written", file.string()));
  }
  return {};
}

Result<AccessTrace> AccessTrace::load(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  FileHead head;
  read(in, &head, 1);
  const std::uint64_t bytes =
      head.step_count * sizeof(Step) + head.access_count * sizeof(TraceAccess);
  std::error_code error;
  if (!in || head.magic != kFileMagic || head.step_count > kTraceBytesMax ||
      head.access_count > kTraceBytesMax ||
      sizeof head + bytes != std::filesystem::file_size(file, error)) {
    return fail(ExitCode::kFailed, fmt::format("{} is not a recorded trace", file.string()));
  }
  AccessTrace trace(head.width, head.height, head.spp, head.tile_size);
  trace.steps_.resize(head.step_count);
  trace.accesses_.resize(head.access_count);
  read(in, trace.steps_.data(), trace.steps_.size());
  read(in, trace.accesses_.data(), trace.accesses_.size());
  return trace;
}

Result<AccessTrace> record_accesses(const Store& store, const RenderSettings& settings,
                                    std::uint32_t tile_size) {
  AccessTrace trace(settings.width, settings.height, settings.spp, tile_size);
  RecordedScene scene(store, settings);
  for (std::uint32_t tile = 0; tile < trace.grid().count(); ++tile) {
    scene.record(trace.grid().rect(TileId{tile}), TileId{tile}, trace);
    if (trace.bytes() > kTraceBytesMax) {
      return fail(ExitCode::kFailed,
                  fmt::format("the trace takes more than {} bytes by tile {} of {}", kTraceBytesMax,
                              tile, trace.grid().count()));
    }
  }
  return trace;
}

std::vector<std::vector<TraceAccess>> wave_steps(const AccessTrace& trace, std::uint64_t paths_max,
                                                 unsigned worker_count) {
  const std::uint64_t paths_per_tile =
      std::uint64_t{trace.grid().tile_size} * trace.grid().tile_size * trace.spp();
  const std::uint64_t tiles_per_wave = std::max<std::uint64_t>(1, paths_max / paths_per_tile);
  std::vector<std::vector<TraceAccess>> waves;
  std::vector<std::map<VoxelId, std::uint32_t>> depths;
  const auto end_wave = [&] {
    for (auto& depth : depths) {
      std::vector<TraceAccess>& step = waves.emplace_back();
      for (const auto& [voxel, rays] : depth) { step.push_back({voxel, rays}); }
    }
    depths.clear();
  };
  std::uint64_t wave = 0;
  for (std::size_t at = 0; at < trace.steps().size(); ++at) {
    const AccessTrace::Step& step = trace.steps()[at];
    const std::uint64_t wave_of_step = index_of(step.tile) / tiles_per_wave;
    if (wave_of_step != wave) {
      end_wave();
      wave = wave_of_step;
    }
    if (wave % worker_count != 0) { continue; }
    if (depths.size() <= step.depth) { depths.resize(step.depth + 1); }
    for (const TraceAccess& access : trace.accesses(at)) {
      depths[step.depth][access.voxel] += access.rays;
    }
  }
  end_wave();
  return waves;
}

}  // namespace preheat
