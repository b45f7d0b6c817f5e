#include "cache/tracer.h"

#include <algorithm>
#include <utility>

#include "common/check.h"

namespace preheat {
namespace {

constexpr std::size_t kBatchRays = 2048;

// A fixed choice of rays for counting: a mix of the ray's name (finaliser of MurmurHash3).
std::uint32_t ray_hash(const PathState& state, std::uint32_t kind) {
  std::uint32_t hash = state.pixel * 0x9E3779B9U;
  hash = (hash ^ state.sample) * 0x85EBCA6BU;
  hash ^= hash >> 13;
  hash = (hash ^ (state.bounce * 2 + kind)) * 0xC2B2AE35U;
  return hash ^ (hash >> 16);
}

}  // namespace

Tracer::Tracer(const TracerContext& context, unsigned index)
    : context_(context),
      index_(index),
      paths_(context.paths_max),
      uses_(context.tables.voxels.size()) {
  paths_free_.reserve(paths_.size());
  for (std::size_t path = paths_.size(); path-- > 0;) {
    paths_free_.push_back(static_cast<std::uint32_t>(path));
  }
  if (context_.count_accesses != AccessCounting::kNone) {
    const CountingTree* const tree = context_.counting_tree;
    counting_nodes_ = tree == nullptr ? context_.tables.voxel_nodes : tree->nodes;
    accesses_by_cell_.resize(tree == nullptr ? context_.tables.voxels.size() : tree->cell_count);
  }
}

bool Tracer::wants_tile() const {
  return runnable_.empty() && available_.empty() && tiles_startable_.empty() &&
         !paths_free_.empty();
}

bool Tracer::wants_voxels() const {
  const bool starved =
      runnable_.empty() && available_.empty() && (tiles_startable_.empty() || paths_free_.empty());
  return starved || paths_free_.size() * 2 < paths_.size();
}

void Tracer::add_tile(TileId tile) {
  auto active = std::make_unique<ActiveTile>();
  active->id = tile;
  active->rect = context_.grid.rect(tile);
  active->sums = TileAccumulator(active->pixel_count());
  begin_window(*active);
  auto slot = std::find(tiles_.begin(), tiles_.end(), nullptr);
  if (slot == tiles_.end()) { slot = tiles_.insert(tiles_.end(), nullptr); }
  *slot = std::move(active);
  tiles_startable_.push_back(static_cast<std::uint32_t>(slot - tiles_.begin()));
}

void Tracer::begin_window(ActiveTile& tile) const {
  const std::size_t window_max = std::max<std::size_t>(1, context_.paths_max / tile.pixel_count());
  tile.window_size = static_cast<std::uint32_t>(
      std::min<std::size_t>(window_max, context_.settings.spp - tile.window_begin));
  tile.started = 0;
  tile.finished = 0;
  tile.samples.resize(tile.window_count());
}

void Tracer::voxel_available(VoxelId voxel) {
  if (parked_.contains(voxel)) { available_.push_back(voxel); }
}

bool Tracer::run_batch() {
  if (runnable_.empty() && available_.empty() &&
      (tiles_startable_.empty() || paths_free_.empty())) {
    return false;
  }
  const ResidentTable::Guard guard(context_.resident, index_);
  for (const VoxelId voxel : std::exchange(available_, {})) { serve(voxel); }
  for (std::size_t rays = 0; rays < kBatchRays; ++rays) {
    if (runnable_.empty() && !start_path()) { break; }
    const Task task = runnable_.back();
    runnable_.pop_back();
    run(task);
  }
  return true;
}

bool Tracer::start_path() {
  if (tiles_startable_.empty() || paths_free_.empty()) { return false; }
  const std::uint32_t tile_slot = tiles_startable_.back();
  ActiveTile& tile = *tiles_[tile_slot];
  const std::uint32_t path_index = paths_free_.back();
  paths_free_.pop_back();
  Path& path = paths_[path_index];
  path.tile = tile_slot;
  path.sample = tile.started;
  const std::uint32_t pixel_in_tile = tile.started / tile.window_size;
  const std::uint32_t sample = tile.window_begin + tile.started % tile.window_size;
  const std::uint32_t x = tile.rect.x + pixel_in_tile % tile.rect.width;
  const std::uint32_t y = tile.rect.y + pixel_in_tile / tile.rect.width;
  ShadedVertex camera;
  camera.has_scatter_ray = true;
  camera.scatter = context_.shading.start_path(y * context_.settings.width + x, sample, path.state);
  ++rays_.camera;
  launch(path_index, camera);
  if (++tile.started == tile.window_count()) { tiles_startable_.pop_back(); }
  return true;
}

void Tracer::launch(std::uint32_t path_index, const ShadedVertex& vertex) {
  Path& path = paths_[path_index];
  path.has_scatter = vertex.has_scatter_ray;
  path.has_shadow = vertex.has_shadow_ray;
  path.pending = 0;
  if (vertex.has_scatter_ray) {
    path.scatter = RayQuery{};
    path.scatter.ray = vertex.scatter;
    ++path.pending;
    runnable_.push_back({path_index, RayKind::kScatter});
  }
  if (vertex.has_shadow_ray) {
    path.shadow = RayQuery{};
    path.shadow.ray = vertex.shadow;
    // A ray that is counted needs its nearest blocker, not any: accesses are those before it.
    path.shadow.any_hit = !is_counted(path, RayKind::kShadow);
    path.direct = vertex.direct;
    ++path.pending;
    runnable_.push_back({path_index, RayKind::kShadow});
  }
  if (path.pending == 0) { finish_path(path_index); }
}

void Tracer::run(Task task) {
  Path& path = paths_[task.path];
  RayQuery& query = task.kind == RayKind::kShadow ? path.shadow : path.scatter;
  settle(task, context_.residency.trace(query, uses_));
}

void Tracer::serve(VoxelId voxel) {
  const auto found = parked_.find(voxel);
  if (found == parked_.end() || context_.resident.lookup(voxel) == nullptr) { return; }
  const Queue queue = std::move(found->second);
  parked_.erase(found);
  parked_count_ -= queue.tasks.size();
  for (const Task task : queue.tasks) {
    Path& path = paths_[task.path];
    RayQuery& query = task.kind == RayKind::kShadow ? path.shadow : path.scatter;
    settle(task, context_.residency.resume(query, uses_));
  }
  if (queue.reported > 0) { served_.push_back({voxel, queue.reported}); }
}

void Tracer::settle(Task task, Residency::Answer answer) {
  Path& path = paths_[task.path];
  if (answer == Residency::Answer::kWaiting) {
    const RayQuery& query = task.kind == RayKind::kShadow ? path.shadow : path.scatter;
    const VoxelId voxel = query.missing[0].voxel;
    Queue& queue = parked_[voxel];
    if (queue.tasks.size() == queue.reported) { parked_changed_.push_back(voxel); }
    queue.tasks.push_back(task);
    ++parked_count_;
    ++misses_;
    return;
  }
  count(path, task.kind);
  if (--path.pending == 0) { advance(task.path); }
}

void Tracer::advance(std::uint32_t path_index) {
  Path& path = paths_[path_index];
  if (path.has_shadow && !path.shadow.blocked && !path.shadow.has_hit()) {
    path.state.radiance += path.direct;
  }
  if (!path.has_scatter) {
    finish_path(path_index);
    return;
  }
  if (!path.scatter.has_hit()) {
    context_.shading.shade_miss(path.scatter.ray, path.state);
    finish_path(path_index);
    return;
  }
  const ShadedVertex vertex = context_.shading.shade_hit(
      path.scatter.ray, context_.residency.surface(path.scatter), path.state);
  rays_.scatter += vertex.has_scatter_ray ? 1 : 0;
  rays_.shadow += vertex.has_shadow_ray ? 1 : 0;
  launch(path_index, vertex);
}

void Tracer::finish_path(std::uint32_t path_index) {
  const Path& path = paths_[path_index];
  ActiveTile& tile = *tiles_[path.tile];
  tile.samples[path.sample] = path.state.radiance;
  paths_free_.push_back(path_index);
  if (++tile.finished == tile.window_count()) { end_window(path.tile); }
}

void Tracer::end_window(std::uint32_t tile_slot) {
  ActiveTile& tile = *tiles_[tile_slot];
  for (std::uint32_t pixel = 0; pixel < tile.pixel_count(); ++pixel) {
    for (std::uint32_t sample = 0; sample < tile.window_size; ++sample) {
      const Vec3& radiance = tile.samples[std::size_t{pixel} * tile.window_size + sample];
      if (!tile.sums.add(pixel, radiance)) { ++rays_.samples_invalid; }
    }
  }
  tile.window_begin += tile.window_size;
  if (tile.window_begin < context_.settings.spp) {
    begin_window(tile);
    tiles_startable_.push_back(tile_slot);
    return;
  }
  finished_.push_back({tile.id, tile.sums.finish(context_.settings.spp)});
  tiles_[tile_slot] = nullptr;
}

bool Tracer::is_counted(const Path& path, RayKind kind) const {
  switch (context_.count_accesses) {
    case AccessCounting::kNone:
      return false;
    case AccessCounting::kExact:
      return true;
    case AccessCounting::kSampled:
      break;
  }
  return ray_hash(path.state, static_cast<std::uint32_t>(kind)) % kAccessSampling == 0;
}

void Tracer::count(const Path& path, RayKind kind) {
  if (!is_counted(path, kind)) { return; }
  const RayQuery& query = kind == RayKind::kShadow ? path.shadow : path.scatter;
  // Nothing has scattered before the camera ray.
  const auto type = kind == RayKind::kShadow ? &CellAccesses::shadow
                    : path.state.bounce == 0 ? &CellAccesses::camera
                                             : &CellAccesses::scatter;
  std::uint64_t entered = 0;
  for_each_cell(counting_nodes_, query.ray, query.t_best, [&](std::uint32_t cell) {
    ++(accesses_by_cell_[cell].*type);
    ++entered;
  });
  accesses_ += entered * accesses_per_count(context_.count_accesses);
}

std::vector<VoxelRays> Tracer::take_demands() {
  std::vector<VoxelRays> demands;
  for (const VoxelId voxel : std::exchange(parked_changed_, {})) {
    const auto found = parked_.find(voxel);
    if (found == parked_.end()) { continue; }
    Queue& queue = found->second;
    if (queue.tasks.size() == queue.reported) { continue; }
    demands.push_back({voxel, queue.tasks.size() - queue.reported});
    queue.reported = queue.tasks.size();
  }
  return demands;
}

std::vector<VoxelRays> Tracer::take_served() { return std::exchange(served_, {}); }

std::vector<FinishedTile> Tracer::take_finished() { return std::exchange(finished_, {}); }

}  // namespace preheat
