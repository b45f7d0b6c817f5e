#include "cache/renderer.h"

#include <fmt/format.h>
#include <immintrin.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <deque>
#include <mutex>
#include <optional>
#include <thread>
#include <unordered_map>
#include <utility>

#include "cache/eviction_policy.h"
#include "cache/resident_table.h"
#include "cache/tracer.h"
#include "cache/tracing.h"
#include "cache/voxel_cache.h"
#include "common/check.h"

namespace preheat {
namespace {

using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point begin) {
  return std::chrono::duration<double>(Clock::now() - begin).count();
}

// Denormal numbers would slow single threads down and change their bits: every thread that traces
// or shades flushes them, in every process.
void flush_denormals() {
  constexpr unsigned kFlushToZero = 0x8000;
  constexpr unsigned kDenormalsAreZero = 0x0040;
  _mm_setcsr(_mm_getcsr() | kFlushToZero | kDenormalsAreZero);
}

// A cold voxel's block with the view that was checked when it came.
struct HeldBlock {
  VoxelBytes bytes{};
  VoxelBlockView view{};
};

// How long the builder sleeps between looks at batches that may still see a withdrawn mesh.
constexpr std::chrono::microseconds kQuiescencePoll{200};

// Paths that make a period of eviction: a part of those that a thread has in flight, which visit
// the same voxels together.
constexpr std::uint64_t kPathsPerPeriod = kPathsPerThread / 4;

}  // namespace

// One mutex guards everything that the threads share but for the resident table; it is held for
// bookkeeping only, never while tracing or building.
class Renderer::Impl {
 public:
  Impl(SceneTables tables, const RenderSettings& settings, const RendererOptions& options,
       std::function<void()> wake);
  ~Impl();

  void set_hot_voxels(const std::vector<VoxelId>& voxels, std::vector<VoxelId> warm);
  Result<void> deliver(VoxelId voxel, const VoxelBytes& bytes);
  void add_tile(TileId tile);
  void cancel_tile(TileId tile);
  std::vector<RendererEvent> take_events();
  std::uint64_t progress() const { return progress_.load(std::memory_order_relaxed); }
  std::size_t tiles_pending() const;
  WorkerStats stats() const;
  std::vector<CellAccesses> accesses_by_cell() const;

 private:
  struct TracerSeat {
    std::unique_ptr<Tracer> tracer{};  // touched by its thread only, once running
    std::vector<VoxelId> available{};  // published voxels it may have rays for
    RayStats rays{};                   // copies of the tracer's counts as of its last batch
    std::uint64_t misses = 0;
    std::uint64_t accesses = 0;
    std::vector<CellAccesses> accesses_by_cell{};
    double stall_seconds = 0.0;
  };
  struct Retired {
    VoxelId voxel{};
    std::uint64_t epoch = 0;
  };
  struct BuildHotSet {};
  using Job = std::variant<BuildHotSet, VoxelId>;

  void run_builder();
  void build_hot_set();
  void build_voxel(VoxelId voxel);
  bool free_retired();
  void run_tracer(unsigned index);
  // After a batch: tells demands and counts, fetches the next tile. Requires: mutex_ held.
  bool exchange(unsigned index, bool ran);
  void step_cache();
  [[nodiscard]] std::unique_ptr<EvictionPolicy> make_policy() const;
  void emit(RendererEvent event);

  SceneTables tables_;
  RenderSettings settings_;
  RendererOptions options_;
  std::function<void()> wake_;
  Shading shading_;
  ResidentTable resident_;
  TracingDevice hot_device_;

  mutable std::mutex mutex_;
  std::condition_variable tracers_wake_;
  std::condition_variable builder_wake_;
  bool stopping_ = false;
  std::vector<RendererEvent> events_;
  std::deque<TileId> tiles_waiting_;
  std::size_t tiles_under_way_ = 0;  // with a tracer
  std::size_t tiles_finished_ = 0;   // in events_
  std::vector<TracerSeat> seats_;
  std::deque<Job> jobs_;
  std::vector<Retired> retired_;

  // The hot set, until it is built.
  std::vector<bool> is_hot_;
  std::vector<VoxelId> warm_;
  std::size_t hot_missing_ = 0;
  std::vector<bool> hot_delivered_;
  std::unique_ptr<HotMesh> hot_mesh_;
  std::unique_ptr<Residency> residency_;
  Clock::time_point hot_begin_{};
  PreloadStats preload_{};
  std::uint64_t hot_bytes_ = 0;
  std::uint64_t build_peak_bytes_ = 0;

  std::optional<VoxelCache> cache_;
  std::unordered_map<VoxelId, HeldBlock> blocks_;
  std::unordered_map<VoxelId, std::unique_ptr<VoxelMesh>> meshes_;
  std::uint64_t tiles_done_ = 0;
  std::uint64_t paths_in_period_ = 0;  // begun since cache_'s period did
  std::atomic<std::uint64_t> progress_{0};
  std::vector<std::thread> tracer_threads_;
  std::thread builder_thread_;
};

Renderer::Impl::Impl(SceneTables tables, const RenderSettings& settings,
                     const RendererOptions& options, std::function<void()> wake)
    : tables_(std::move(tables)),
      settings_(settings),
      options_(options),
      wake_(std::move(wake)),
      shading_(tables_, settings_),
      resident_(tables_.voxels.size(), options.threads),
      hot_device_(options.threads),
      seats_(options.threads),
      is_hot_(tables_.voxels.size()),
      hot_delivered_(tables_.voxels.size()),
      builder_thread_([this] { run_builder(); }) {
  CHECK(options.threads > 0);
}

Renderer::Impl::~Impl() {
  {
    const std::lock_guard lock(mutex_);
    stopping_ = true;
  }
  tracers_wake_.notify_all();
  builder_wake_.notify_all();
  // The builder starts the tracer threads, so it is joined first.
  builder_thread_.join();
  for (std::thread& thread : tracer_threads_) { thread.join(); }
}

void Renderer::Impl::set_hot_voxels(const std::vector<VoxelId>& voxels, std::vector<VoxelId> warm) {
  const std::lock_guard lock(mutex_);
  CHECK(hot_mesh_ == nullptr);
  hot_begin_ = Clock::now();
  hot_mesh_ = std::make_unique<HotMesh>(tables_, voxels);
  for (const VoxelId voxel : voxels) { is_hot_[index_of(voxel)] = true; }
  hot_missing_ = voxels.size();
  warm_ = std::move(warm);
  preload_.voxels = voxels.size();
  if (hot_missing_ == 0) {
    jobs_.emplace_back(BuildHotSet{});
    builder_wake_.notify_one();
  }
}

Result<void> Renderer::Impl::deliver(VoxelId voxel, const VoxelBytes& bytes) {
  if (index_of(voxel) >= tables_.voxels.size()) {
    return fail(ExitCode::kMismatch, fmt::format("voxel {} does not exist: the scene has {}",
                                                 index_of(voxel), tables_.voxels.size()));
  }
  const VoxelEntry& entry = tables_.voxels[index_of(voxel)];
  const Result<VoxelBlockView> block = view_voxel_block(bytes.bytes, tables_.materials.size());
  if (!block) { return tl::unexpected(block.error()); }
  if (block->triangles.size() != entry.triangle_count) {
    return fail(ExitCode::kMismatch,
                fmt::format("voxel {} holds {} triangles, its directory entry says {}",
                            index_of(voxel), block->triangles.size(), entry.triangle_count));
  }
  for (const std::uint32_t triangle : block->triangles) {
    if (triangle >= tables_.triangle_count) {
      return fail(ExitCode::kMismatch,
                  fmt::format("voxel {} holds triangle {} of a scene of {}", index_of(voxel),
                              triangle, tables_.triangle_count));
    }
  }
  const std::lock_guard lock(mutex_);
  if (is_hot_[index_of(voxel)]) {
    if (hot_delivered_[index_of(voxel)]) { return {}; }
    hot_delivered_[index_of(voxel)] = true;
    hot_mesh_->add(*block);
    preload_.bytes += bytes.bytes.size();
    if (--hot_missing_ == 0) {
      jobs_.emplace_back(BuildHotSet{});
      builder_wake_.notify_one();
    }
    return {};
  }
  if (!cache_ || !cache_->block_arrived(voxel)) { return {}; }
  blocks_[voxel] = {bytes, *block};
  step_cache();
  return {};
}

void Renderer::Impl::add_tile(TileId tile) {
  const std::lock_guard lock(mutex_);
  tiles_waiting_.push_back(tile);
  tracers_wake_.notify_one();
}

void Renderer::Impl::cancel_tile(TileId tile) {
  const std::lock_guard lock(mutex_);
  std::erase(tiles_waiting_, tile);
}

std::vector<RendererEvent> Renderer::Impl::take_events() {
  const std::lock_guard lock(mutex_);
  tiles_finished_ = 0;
  return std::exchange(events_, {});
}

std::size_t Renderer::Impl::tiles_pending() const {
  const std::lock_guard lock(mutex_);
  return tiles_waiting_.size() + tiles_under_way_ + tiles_finished_;
}

WorkerStats Renderer::Impl::stats() const {
  const std::lock_guard lock(mutex_);
  WorkerStats stats;
  stats.tiles = tiles_done_;
  stats.preload = preload_;
  stats.cache.limit_bytes = options_.cache_limit_bytes;
  stats.cache.peak_bytes = hot_bytes_;
  stats.cache.build_peak_bytes = build_peak_bytes_;
  for (const TracerSeat& seat : seats_) {
    stats.rays.add(seat.rays);
    stats.cache.misses += seat.misses;
    stats.cache.accesses += seat.accesses;
    stats.cache.stall_seconds += seat.stall_seconds;
  }
  if (cache_) {
    const VoxelCache::Counts& counts = cache_->counts();
    stats.preload.voxels += counts.prefetches;
    stats.preload.bytes += counts.prefetched_bytes;
    stats.cache.peak_bytes += cache_->held_bytes_peak();
    stats.cache.remote_fetches = counts.fetches;
    stats.cache.remote_bytes = counts.fetched_bytes;
    stats.cache.rebuilds = counts.rebuilds;
    stats.cache.evictions = counts.evictions;
  }
  return stats;
}

std::vector<CellAccesses> Renderer::Impl::accesses_by_cell() const {
  const std::lock_guard lock(mutex_);
  const CountingTree* const tree = options_.counting_tree.get();
  std::vector<CellAccesses> sums(tree == nullptr ? tables_.voxels.size() : tree->cell_count);
  for (const TracerSeat& seat : seats_) {
    for (std::size_t cell = 0; cell < seat.accesses_by_cell.size(); ++cell) {
      sums[cell].add(seat.accesses_by_cell[cell]);
    }
  }
  return sums;
}

void Renderer::Impl::emit(RendererEvent event) {
  events_.push_back(std::move(event));
  wake_();
}

void Renderer::Impl::step_cache() {
  for (const VoxelCache::Command& command : cache_->step()) {
    switch (command.action) {
      case VoxelCache::Action::kFetch:
        emit(VoxelNeeded{command.voxel, cache_->is_waited_for(command.voxel)});
        break;
      case VoxelCache::Action::kBuild:
        jobs_.emplace_back(command.voxel);
        builder_wake_.notify_one();
        break;
      case VoxelCache::Action::kWithdraw:
        retired_.push_back({command.voxel, resident_.withdraw(command.voxel)});
        builder_wake_.notify_one();
        break;
      case VoxelCache::Action::kDropBlock:
        blocks_.erase(command.voxel);
        break;
    }
  }
}

void Renderer::Impl::run_builder() {
  std::unique_lock lock(mutex_);
  for (;;) {
    const auto has_work = [this] { return stopping_ || !jobs_.empty(); };
    if (retired_.empty()) {
      builder_wake_.wait(lock, [&] { return has_work() || !retired_.empty(); });
    } else {
      builder_wake_.wait_for(lock, kQuiescencePoll, has_work);
    }
    if (stopping_) { return; }
    lock.unlock();
    const bool freed = free_retired();
    lock.lock();
    if (freed) { step_cache(); }
    if (jobs_.empty()) { continue; }
    const Job job = jobs_.front();
    jobs_.pop_front();
    lock.unlock();
    if (const VoxelId* voxel = std::get_if<VoxelId>(&job)) {
      build_voxel(*voxel);
    } else {
      build_hot_set();
    }
    lock.lock();
  }
}

void Renderer::Impl::build_hot_set() {
  hot_mesh_->all_added();
  hot_device_.reset_peak();
  std::vector<VoxelId> cold;
  for (std::size_t voxel = 0; voxel < is_hot_.size(); ++voxel) {
    if (!is_hot_[voxel]) { cold.push_back(VoxelId{static_cast<std::uint32_t>(voxel)}); }
  }
  auto residency = std::make_unique<Residency>(hot_device_, *hot_mesh_, tables_, cold, resident_);
  const std::string error = hot_device_.take_error();

  const std::lock_guard lock(mutex_);
  if (!error.empty()) {
    emit(RendererFailed{{ExitCode::kFailed, "the hot set could not be built: " + error}});
    return;
  }
  // The boxes of the cold voxels are part of every worker's fixed memory, not of the cache.
  std::uint64_t promised = cold.size() < is_hot_.size() ? kBvhBytesFixed : 0;
  for (std::size_t voxel = 0; voxel < is_hot_.size(); ++voxel) {
    if (is_hot_[voxel]) { promised += tables_.voxels[voxel].hot_bytes(); }
  }
#ifndef NDEBUG
  CHECK(hot_mesh_->bytes() + hot_device_.bytes() <=
        promised + kBvhBytesFixed + kColdBoxBytes * cold.size());
#endif
  hot_bytes_ = std::min(promised, hot_mesh_->bytes() + hot_device_.bytes());
  build_peak_bytes_ = std::max(build_peak_bytes_, hot_device_.bytes_peak() - hot_device_.bytes());
  preload_.seconds = seconds_since(hot_begin_);
  std::vector<VoxelCache::Size> sizes;
  for (const VoxelEntry& voxel : tables_.voxels) {
    sizes.push_back({voxel.block_bytes, VoxelMesh::bytes_max(voxel.triangle_count)});
  }
  cache_.emplace(std::move(sizes), options_.cache_limit_bytes - hot_bytes_, make_policy());
  residency_ = std::move(residency);
  const TracerContext context{.tables = tables_,
                              .settings = settings_,
                              .shading = shading_,
                              .residency = *residency_,
                              .resident = resident_,
                              .grid = {settings_.width, settings_.height, options_.tile_size},
                              .count_accesses = options_.count_accesses,
                              .counting_tree = options_.counting_tree.get(),
                              .paths_max = options_.paths_per_thread};
  for (unsigned index = 0; index < options_.threads; ++index) {
    seats_[index].tracer = std::make_unique<Tracer>(context, index);
    tracer_threads_.emplace_back([this, index] { run_tracer(index); });
  }
  emit(HotSetReady{preload_});
  cache_->prefetch(std::exchange(warm_, {}));
  step_cache();
}

std::unique_ptr<EvictionPolicy> Renderer::Impl::make_policy() const {
  EvictionInput input;
  for (const VoxelEntry& voxel : tables_.voxels) { input.bytes.push_back(voxel.block_bytes); }
  input.chance_expected = chance_per_period(
      options_.rays_expected, sample_count(settings_) / static_cast<double>(kPathsPerPeriod));
  return make_eviction_policy(options_.eviction, std::move(input));
}

void Renderer::Impl::build_voxel(VoxelId voxel) {
  HeldBlock block;
  {
    const std::lock_guard lock(mutex_);
    block = blocks_.at(voxel);
  }
  auto mesh = std::make_unique<VoxelMesh>(block.view);
  const std::uint64_t bvh_bytes = mesh->bytes();

  const std::lock_guard lock(mutex_);
  cache_->built(voxel, bvh_bytes);
  resident_.publish(voxel, mesh.get());
  meshes_[voxel] = std::move(mesh);
  for (TracerSeat& seat : seats_) { seat.available.push_back(voxel); }
  tracers_wake_.notify_all();
  step_cache();
}

// True if the cache has something new to decide on.
bool Renderer::Impl::free_retired() {
  std::vector<std::pair<VoxelId, std::unique_ptr<VoxelMesh>>> unreachable;
  {
    const std::lock_guard lock(mutex_);
    std::erase_if(retired_, [&](const Retired& retired) {
      if (!resident_.is_quiescent(retired.epoch)) { return false; }
      const auto mesh = meshes_.find(retired.voxel);
      unreachable.emplace_back(retired.voxel, std::move(mesh->second));
      meshes_.erase(mesh);
      return true;
    });
  }
  for (auto& [voxel, mesh] : unreachable) { mesh.reset(); }
  const std::lock_guard lock(mutex_);
  for (const auto& [voxel, mesh] : unreachable) { cache_->withdrawn(voxel); }
  return !unreachable.empty();
}

bool Renderer::Impl::exchange(unsigned index, bool ran) {
  TracerSeat& seat = seats_[index];
  Tracer& tracer = *seat.tracer;
  paths_in_period_ += tracer.rays().camera - seat.rays.camera;
  seat.rays = tracer.rays();
  seat.misses = tracer.misses();
  seat.accesses = tracer.accesses();
  for (const VoxelRays& rays : tracer.take_uses()) { cache_->used(rays.voxel, rays.rays); }
  if (paths_in_period_ >= kPathsPerPeriod) {
    paths_in_period_ = 0;
    cache_->begin_period();
  }
  bool cache_changed = false;
  for (const VoxelRays& rays : tracer.take_served()) {
    cache_->served(rays.voxel, rays.rays);
    cache_changed = true;
  }
  const std::vector<VoxelRays> demands =
      tracer.wants_voxels() ? tracer.take_demands() : std::vector<VoxelRays>{};
  for (const VoxelRays& rays : demands) {
    cache_->add_waiting(rays.voxel, rays.rays);
    cache_changed = true;
    // Published between the ray's look and now: nobody else would tell.
    if (cache_->is_built(rays.voxel)) { seat.available.push_back(rays.voxel); }
  }
  if (cache_changed) { step_cache(); }
  std::vector<FinishedTile> finished = tracer.take_finished();
  if (!finished.empty() && tiles_waiting_.empty()) {
    seat.accesses_by_cell = tracer.accesses_by_cell();
  }
  for (FinishedTile& tile : finished) {
    --tiles_under_way_;
    ++tiles_finished_;
    ++tiles_done_;
    emit(TileDone{tile.tile, std::move(tile.pixels)});
  }
  bool has_work = ran;
  for (const VoxelId voxel : std::exchange(seat.available, {})) {
    tracer.voxel_available(voxel);
    has_work = true;
  }
  if (tracer.wants_tile() && !tiles_waiting_.empty()) {
    tracer.add_tile(tiles_waiting_.front());
    tiles_waiting_.pop_front();
    ++tiles_under_way_;
    has_work = true;
  }
  return has_work;
}

void Renderer::Impl::run_tracer(unsigned index) {
  flush_denormals();
  TracerSeat& seat = seats_[index];
  Tracer& tracer = *seat.tracer;
  std::unique_lock lock(mutex_);
  bool ran = true;
  while (!stopping_) {
    if (!exchange(index, ran)) {
      const bool stalled = tracer.has_parked_rays();
      const Clock::time_point begin = Clock::now();
      tracers_wake_.wait(lock, [&] {
        return stopping_ || !seat.available.empty() ||
               (tracer.wants_tile() && !tiles_waiting_.empty());
      });
      if (stalled) { seat.stall_seconds += seconds_since(begin); }
      ran = true;
      continue;
    }
    lock.unlock();
    ran = tracer.run_batch();
    progress_.fetch_add(ran ? 1 : 0, std::memory_order_relaxed);
    lock.lock();
  }
}

Renderer::Renderer(SceneTables tables, const RenderSettings& settings,
                   const RendererOptions& options, std::function<void()> wake)
    : impl_(std::make_unique<Impl>(std::move(tables), settings, options, std::move(wake))) {}
Renderer::~Renderer() = default;
void Renderer::set_hot_voxels(std::vector<VoxelId> voxels, std::vector<VoxelId> warm) {
  impl_->set_hot_voxels(voxels, std::move(warm));
}
Result<void> Renderer::deliver(VoxelId voxel, VoxelBytes bytes) {
  return impl_->deliver(voxel, bytes);
}
void Renderer::add_tile(TileId tile) { impl_->add_tile(tile); }
void Renderer::cancel_tile(TileId tile) { impl_->cancel_tile(tile); }
std::vector<RendererEvent> Renderer::take_events() { return impl_->take_events(); }
std::uint64_t Renderer::progress() const { return impl_->progress(); }
std::size_t Renderer::tiles_pending() const { return impl_->tiles_pending(); }
WorkerStats Renderer::stats() const { return impl_->stats(); }
std::vector<CellAccesses> Renderer::accesses_by_cell() const { return impl_->accesses_by_cell(); }

}  // namespace preheat
