#include "tests/bench/cluster_simulation.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <numeric>
#include <optional>
#include <queue>
#include <random>
#include <set>
#include <tuple>
#include <utility>

#include "common/check.h"
#include "tests/bench/cache_replay.h"

namespace preheat {
namespace {

constexpr std::uint32_t kNoHome = UINT32_MAX;

// The links of one machine: when each direction is free again.
struct Links {
  double up_free = 0.0;
  double down_free = 0.0;
};

class Network {
 public:
  Network(std::size_t machines, const ClusterOptions& options)
      : options_(options), links_(machines) {}

  // A transfer that is asked for at `time`: when its last byte has arrived.
  double send(std::size_t from, std::size_t to, std::uint64_t bytes, double time) {
    const double seconds = static_cast<double>(bytes) / options_.link_bytes_per_second;
    Links& source = links_[from];
    Links& sink = links_[to];
    source.up_free = std::max(time, source.up_free) + seconds;
    const double first_byte = source.up_free - seconds + options_.latency_seconds;
    sink.down_free = std::max(first_byte, sink.down_free) + seconds;
    return sink.down_free;
  }

 private:
  const ClusterOptions& options_;
  std::vector<Links> links_;
};

// Whose memory each cold voxel's block lies in: the largest first, each to who holds least, in half
// of what a worker's cache leaves beside the hot set.
struct Homes {
  std::vector<std::uint32_t> of{};     // [voxel]
  std::vector<std::uint64_t> bytes{};  // [worker]
  std::vector<double> there_since{};   // [voxel]; infinite = not fetched from the origin yet
};

Homes assign_homes(const ClusterWork& work, unsigned workers) {
  Homes homes{std::vector<std::uint32_t>(work.voxels.size(), kNoHome),
              std::vector<std::uint64_t>(workers),
              std::vector<double>(work.voxels.size(), std::numeric_limits<double>::infinity())};
  std::vector<std::uint32_t> order(work.voxels.size());
  std::iota(order.begin(), order.end(), 0U);
  std::stable_sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) {
    return work.voxels[a].block_bytes > work.voxels[b].block_bytes;
  });
  std::set<std::pair<std::uint64_t, std::uint32_t>> by_bytes;
  for (std::uint32_t worker = 0; worker < workers; ++worker) { by_bytes.emplace(0, worker); }
  for (const std::uint32_t voxel : order) {
    if (work.is_hot[voxel]) { continue; }
    const auto [bytes, worker] = *by_bytes.begin();
    const std::uint64_t with = bytes + work.voxels[voxel].block_bytes;
    if (with > work.cold_limit_bytes / 2) { continue; }
    by_bytes.erase(by_bytes.begin());
    by_bytes.emplace(with, worker);
    homes.of[voxel] = worker;
    homes.bytes[worker] = with;
  }
  return homes;
}

class Cluster {
 public:
  Cluster(const ClusterWork& work, const ClusterOptions& options)
      : work_(work),
        options_(options),
        network_(options.workers + 1, options),
        homes_(assign_homes(work, options.workers)),
        tiles_(work.tiles.size()) {
    CHECK(options.workers > 0 && !work.tiles.empty());
    std::mt19937_64 random(options.seed);
    EvictionInput input;
    for (const VoxelCache::Size& voxel : work.voxels) { input.bytes.push_back(voxel.block_bytes); }
    for (unsigned id = 0; id < options.workers; ++id) {
      const double uniform = static_cast<double>(random() >> 11U) * 0x1p-53;
      Worker& worker = workers_.emplace_back();
      worker.slowness = 1.0 - options.slowness_mean * std::log1p(-uniform);
      worker.cache = std::make_unique<ReplayedCache>(work.voxels, work.is_hot,
                                                     work.cold_limit_bytes - homes_.bytes[id],
                                                     make_eviction_policy(options.eviction, input));
    }
  }

  ClusterResult run() {
    preload();
    while (tiles_done_ < tiles_.size()) {
      const auto [time, order, worker] = events_.top();
      events_.pop();
      go_on(worker, time);
    }
    settle();
    const double total = static_cast<double>(options_.workers) * result_.frame_seconds;
    const ClusterSplit& split = result_.split;
    result_.split.idle = total - split.traced - split.preload - split.stalled - split.duplicated;
    return result_;
  }

 private:
  struct Wave {
    std::size_t tile = 0;
    std::size_t index = 0;
    double ready = 0.0;  // its missing voxels are built
  };
  struct Worker {
    double slowness = 1.0;
    double ready = 0.0;  // with its hot set
    std::unique_ptr<ReplayedCache> cache{};
    double builder_free = 0.0;
    std::optional<Wave> current{};
    std::optional<Wave> next{};
    bool is_running = false;  // the current wave has not ended
    double current_begin = 0.0;
    double tile_traced = 0.0;   // of the current tile so far, without the wave that runs
    double tile_stalled = 0.0;  // likewise
  };
  struct Tile {
    unsigned copies = 0;
    bool is_done = false;
    double expected_end = 0.0;
    std::uint32_t first_worker = 0;
  };
  using Event = std::tuple<double, std::uint64_t, std::uint32_t>;  // time, order, worker

  [[nodiscard]] std::size_t master() const { return options_.workers; }

  [[nodiscard]] const std::vector<SimulatedWave>& waves(std::size_t tile) const {
    return work_.waves[work_.tiles[tile].recorded];
  }

  [[nodiscard]] double trace_seconds(const Worker& worker, const Wave& wave) const {
    return waves(wave.tile)[wave.index].rays * work_.tiles[wave.tile].rays_share *
           options_.seconds_per_ray * worker.slowness;
  }

  [[nodiscard]] double tile_seconds(const Worker& worker, std::size_t tile) const {
    double seconds = 0.0;
    for (std::size_t index = 0; index < waves(tile).size(); ++index) {
      seconds += trace_seconds(worker, {tile, index, 0.0});
    }
    return seconds;
  }

  void preload() {
    const std::vector<double> there = broadcast_seconds(work_.hot_block_bytes, options_);
    const unsigned first_ones = std::min(options_.broadcast_fan_out, options_.workers);
    result_.origin_bytes += first_ones * work_.hot_block_bytes;
    result_.peer_bytes += (options_.workers - first_ones) * work_.hot_block_bytes;
    for (std::uint32_t id = 0; id < options_.workers; ++id) {
      const double ready = there[id] + options_.hot_build_seconds * workers_[id].slowness;
      workers_[id].ready = ready;
      result_.preload_seconds = std::max(result_.preload_seconds, ready);
      push(ready, id);
    }
  }

  void push(double time, std::uint32_t worker) { events_.emplace(time, ++events_pushed_, worker); }

  // The worker has ended its wave, or begins.
  void go_on(std::uint32_t id, double time) {
    Worker& worker = workers_[id];
    worker.is_running = false;
    if (worker.current) { end_wave(id, time); }
    worker.current.reset();
    if (worker.next && worker.next->index == 0 && tiles_[worker.next->tile].is_done) {
      worker.next.reset();
    }
    if (!worker.next) { worker.next = take_wave(id, time); }
    worker.current = std::exchange(worker.next, std::nullopt);
    if (!worker.current) { return; }
    worker.current_begin = time;
    worker.is_running = true;
    const double end =
        std::max(time + trace_seconds(worker, *worker.current), worker.current->ready);
    worker.next = take_wave(id, time);
    push(end, id);
  }

  void end_wave(std::uint32_t id, double time) {
    Worker& worker = workers_[id];
    const Wave& wave = *worker.current;
    const double traced = trace_seconds(worker, wave);
    worker.tile_traced += traced;
    worker.tile_stalled += std::max(0.0, time - worker.current_begin - traced);
    if (wave.index + 1 < waves(wave.tile).size()) { return; }
    Tile& tile = tiles_[wave.tile];
    const double tile_traced = std::exchange(worker.tile_traced, 0.0);
    result_.split.stalled += std::exchange(worker.tile_stalled, 0.0);
    if (tile.is_done) {
      result_.split.duplicated += tile_traced;
      return;
    }
    tile.is_done = true;
    ++tiles_done_;
    result_.split.traced += tile_traced;
    const double there = network_.send(id, master(), work_.tile_bytes, time);
    result_.frame_seconds = std::max(result_.frame_seconds, there);
  }

  // What follows the current wave, with its voxels asked for; nothing if no work is left.
  std::optional<Wave> take_wave(std::uint32_t id, double time) {
    Worker& worker = workers_[id];
    Wave wave;
    if (worker.current && worker.current->index + 1 < waves(worker.current->tile).size()) {
      wave = {worker.current->tile, worker.current->index + 1, 0.0};
    } else if (tiles_begun_ < tiles_.size()) {
      wave.tile = tiles_begun_++;
      Tile& tile = tiles_[wave.tile];
      tile.copies = 1;
      tile.first_worker = id;
      const double begin = worker.current ? time + trace_seconds(worker, *worker.current) : time;
      tile.expected_end = begin + tile_seconds(worker, wave.tile);
    } else if (const auto tile = worker.current ? std::nullopt : tile_to_double(id, time)) {
      wave.tile = *tile;
      ++tiles_[*tile].copies;
    } else {
      return std::nullopt;
    }
    wave.ready = ask_for(id, waves(wave.tile)[wave.index], time);
    return wave;
  }

  // The tile that will be done last, if this worker would be done with it sooner.
  std::optional<std::size_t> tile_to_double(std::uint32_t id, double time) const {
    if (!options_.double_tiles) { return std::nullopt; }
    std::optional<std::size_t> latest;
    // Tiles are begun in order, so those that run are among the last few.
    const std::size_t among = std::min<std::size_t>(tiles_.size(), 3 * options_.workers);
    for (std::size_t tile = tiles_.size() - among; tile < tiles_.size(); ++tile) {
      const Tile& candidate = tiles_[tile];
      if (candidate.is_done || candidate.copies != 1 || candidate.first_worker == id) { continue; }
      if (!latest || candidate.expected_end > tiles_[*latest].expected_end) { latest = tile; }
    }
    if (latest && time + tile_seconds(workers_[id], *latest) < tiles_[*latest].expected_end) {
      return latest;
    }
    return std::nullopt;
  }

  // Fetches and builds what the wave misses; when that is done.
  double ask_for(std::uint32_t id, const SimulatedWave& wave, double time) {
    Worker& worker = workers_[id];
    worker.cache->visit(wave.accesses);
    std::map<VoxelId, double> arrivals;
    for (const VoxelId voxel : worker.cache->fetched()) {
      arrivals[voxel] = fetch(id, voxel, time);
    }
    for (const VoxelId voxel : worker.cache->built()) {
      const auto arrival = arrivals.find(voxel);
      const double there = arrival == arrivals.end() ? time : arrival->second;
      const auto bytes = static_cast<double>(work_.voxels[index_of(voxel)].block_bytes);
      worker.builder_free = std::max(worker.builder_free, there) +
                            bytes * options_.build_seconds_per_byte * worker.slowness;
    }
    return worker.cache->built().empty() ? time : worker.builder_free;
  }

  double fetch(std::uint32_t id, VoxelId voxel, double time) {
    ++result_.fetches;
    const std::uint64_t bytes = work_.voxels[index_of(voxel)].block_bytes;
    const std::uint32_t home = homes_.of[index_of(voxel)];
    const double request = time + options_.latency_seconds;
    if (home == kNoHome) {
      result_.origin_bytes += bytes;
      return network_.send(master(), id, bytes, request);
    }
    double& there_since = homes_.there_since[index_of(voxel)];
    if (std::isinf(there_since)) {
      const double asked = home == id ? request : request + options_.latency_seconds;
      result_.origin_bytes += bytes;
      there_since = network_.send(master(), home, bytes, asked);
    }
    if (home == id) { return std::max(time, there_since); }
    result_.peer_bytes += bytes;
    return network_.send(home, id, bytes, std::max(request, there_since));
  }

  // Where everyone stands when the last tile is there; copies of tiles may still run.
  void settle() {
    for (const Worker& worker : workers_) {
      result_.split.preload += std::min(worker.ready, result_.frame_seconds);
      if (!worker.is_running) { continue; }
      result_.split.stalled += worker.tile_stalled;
      result_.split.duplicated +=
          worker.tile_traced + std::max(0.0, result_.frame_seconds - worker.current_begin);
    }
  }

  const ClusterWork& work_;
  const ClusterOptions& options_;
  Network network_;
  Homes homes_;
  std::vector<Tile> tiles_;
  std::vector<Worker> workers_;
  std::priority_queue<Event, std::vector<Event>, std::greater<>> events_;
  std::uint64_t events_pushed_ = 0;
  std::size_t tiles_begun_ = 0;
  std::size_t tiles_done_ = 0;
  ClusterResult result_{};
};

}  // namespace

double ClusterResult::efficiency() const {
  const double total = split.traced + split.preload + split.stalled + split.duplicated + split.idle;
  return total > 0.0 ? split.traced / total : 0.0;
}

double ClusterResult::efficiency_rendering() const {
  const double total = split.traced + split.stalled + split.duplicated + split.idle;
  return total > 0.0 ? split.traced / total : 0.0;
}

std::vector<double> broadcast_seconds(std::uint64_t bytes, const ClusterOptions& options) {
  const std::uint64_t chunks = (bytes + options.chunk_bytes - 1) / options.chunk_bytes;
  const double chunk_seconds = chunks == 0
                                   ? 0.0
                                   : static_cast<double>(bytes) / static_cast<double>(chunks) /
                                         options.link_bytes_per_second;
  // Node 0 is the master; the children of node n are n * fan_out + 1 and so on.
  const std::size_t nodes = options.workers + std::size_t{1};
  std::vector<std::vector<double>> there(nodes);
  there[0].assign(chunks, 0.0);
  for (std::size_t node = 0; node < nodes; ++node) {
    const std::size_t first = node * options.broadcast_fan_out + 1;
    const std::size_t last = std::min(nodes, first + options.broadcast_fan_out);
    double up_free = 0.0;
    for (std::uint64_t chunk = 0; chunk < chunks; ++chunk) {
      for (std::size_t child = first; child < last; ++child) {
        up_free = std::max(up_free, there[node][chunk]) + chunk_seconds;
        there[child].push_back(up_free + options.latency_seconds);
      }
    }
  }
  std::vector<double> done;
  for (std::size_t node = 1; node < nodes; ++node) {
    done.push_back(there[node].empty() ? 0.0 : there[node].back());
  }
  return done;
}

ClusterResult simulate_cluster(const ClusterWork& work, const ClusterOptions& options) {
  return Cluster(work, options).run();
}

namespace {

// One wave of a recorded tile: `scale` times its rays.
SimulatedWave scaled_wave(const std::vector<double>& rays_by_voxel, double rays, double scale,
                          std::mt19937_64& random) {
  SimulatedWave wave;
  wave.rays = rays * scale;
  for (std::uint32_t voxel = 0; voxel < rays_by_voxel.size(); ++voxel) {
    const double expected = rays_by_voxel[voxel] * scale;
    if (expected <= 0.0) { continue; }
    std::poisson_distribution<std::uint32_t> draw(std::min(expected, 1e9));
    if (const std::uint32_t drawn = draw(random); drawn > 0) {
      wave.accesses.push_back({VoxelId{voxel}, drawn});
    }
  }
  return wave;
}

}  // namespace

void scale_frame(const AccessTrace& trace, const FrameScale& scale, ClusterWork& work) {
  std::mt19937_64 random(scale.seed);
  const TileGrid& recorded = trace.grid();
  const TileGrid grid{scale.width, scale.height, scale.tile_size};
  const std::uint64_t tile_paths = std::uint64_t{scale.tile_size} * scale.tile_size * scale.spp;
  const std::uint64_t waves = (tile_paths + scale.paths_max - 1) / scale.paths_max;
  std::vector<std::vector<double>> rays_by_voxel(recorded.count(),
                                                 std::vector<double>(work.voxels.size()));
  std::vector<double> rays(recorded.count());
  for (std::size_t at = 0; at < trace.steps().size(); ++at) {
    const std::uint32_t tile = index_of(trace.steps()[at].tile);
    rays[tile] += static_cast<double>(trace.steps()[at].rays);
    for (const TraceAccess& access : trace.accesses(at)) {
      rays_by_voxel[tile][index_of(access.voxel)] += access.rays;
    }
  }
  work.waves.assign(recorded.count(), {});
  for (std::uint32_t tile = 0; tile < recorded.count(); ++tile) {
    const TileRect rect = recorded.rect(TileId{tile});
    const double recorded_paths = static_cast<double>(rect.width) * rect.height * trace.spp();
    const double factor =
        static_cast<double>(tile_paths) / recorded_paths / static_cast<double>(waves);
    for (std::uint64_t wave = 0; wave < waves; ++wave) {
      work.waves[tile].push_back(scaled_wave(rays_by_voxel[tile], rays[tile], factor, random));
    }
  }
  work.tiles.clear();
  for (std::uint32_t tile = 0; tile < grid.count(); ++tile) {
    const TileRect rect = grid.rect(TileId{tile});
    const std::uint64_t column = std::uint64_t{rect.x} * recorded.columns() / scale.width;
    const std::uint64_t row = std::uint64_t{rect.y} * recorded.rows() / scale.height;
    const double share = static_cast<double>(rect.width) * rect.height /
                         (static_cast<double>(scale.tile_size) * scale.tile_size);
    work.tiles.push_back({static_cast<std::uint32_t>(row * recorded.columns() + column), share});
  }
  work.tile_bytes = std::uint64_t{scale.tile_size} * scale.tile_size * 16;
}

}  // namespace preheat
