#include "master/master.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <array>
#include <csignal>
#include <cstring>
#include <deque>
#include <fstream>
#include <map>
#include <memory>
#include <optional>
#include <utility>

#include "cache/preload_plan.h"
#include "cache/renderer.h"
#include "common/content_hash.h"
#include "common/limits.h"
#include "common/self_test.h"
#include "common/zmq_transport.h"
#include "master/endpoint_file.h"
#include "master/home_assignment.h"
#include "master/job.h"
#include "master/worker_processes.h"

namespace preheat {
namespace {

constexpr std::chrono::milliseconds kWait{50};
constexpr std::chrono::milliseconds kWaitWhileFull{2};
constexpr std::chrono::milliseconds kBetweenTicks{20};
constexpr std::chrono::milliseconds kBetweenProgress{100};
constexpr std::size_t kReceivedPerTurn = 256;
constexpr std::size_t kQueuedPerWorkerMax = 1024;

std::shared_ptr<const EncodedPlan> encode_plan(const PreloadPlan& preload) {
  std::vector<VoxelId> ids = preload.hot;
  if (!preload.warm.empty()) {
    ids.push_back(VoxelId{kPlanDivider});
    ids.insert(ids.end(), preload.warm.begin(), preload.warm.end());
  }
  auto plan = std::make_shared<EncodedPlan>();
  plan->hot_count = preload.hot.size();
  plan->bytes.resize(ids.size() * sizeof(VoxelId));
  if (!ids.empty()) { std::memcpy(plan->bytes.data(), ids.data(), plan->bytes.size()); }
  plan->hash = content_hash(plan->bytes);
  return plan;
}

// Plans by cache size: workers of one size share one.
class Planner {
 public:
  // `workers` is how many are expected to share the cold voxels; 1 or none: nobody keeps any.
  Planner(const Store& store, const Prediction& prediction, double share, std::size_t workers)
      : store_(store), prediction_(prediction), share_(share), workers_(workers) {}

  Result<WorkerPlan> plan(const CacheSize& size) {
    const Result<std::uint64_t> limit = size.resolve(store_.tables());
    if (!limit) { return tl::unexpected(limit.error()); }
    auto [entry, is_new] = plans_.try_emplace(*limit);
    if (is_new) { entry->second = make(*limit); }
    return entry->second;
  }

 private:
  [[nodiscard]] WorkerPlan make(std::uint64_t limit) const {
    const SceneTables& tables = store_.tables();
    PreloadPlan preload = plan_preload(tables, prediction_, limit, share_);
    std::uint64_t cold_bytes = 0;
    for (const VoxelEntry& voxel : tables.voxels) { cold_bytes += voxel.block_bytes; }
    for (const VoxelId voxel : preload.hot) {
      cold_bytes -= tables.voxels[index_of(voxel)].block_bytes;
    }
    const std::uint64_t for_others = home_bytes(tables, cold_bytes, limit, workers_);
    if (for_others > 0) { preload = plan_preload(tables, prediction_, limit - for_others, share_); }
    return {limit, for_others, encode_plan(preload)};
  }

  const Store& store_;
  const Prediction& prediction_;
  double share_;
  std::size_t workers_;
  std::map<std::uint64_t, WorkerPlan> plans_;
};

// Frames on their way out of one socket, in order for each peer; a peer that does not read blocks
// nobody else.
class Outbox {
 public:
  explicit Outbox(Channel& channel) : channel_(channel) {}

  void add(const Outgoing& outgoing, const JobKey& job, std::vector<SessionId>& gone) {
    Queued queued{encode_frame(job, outgoing.message), outgoing.data};
    const auto waiting = queues_.find({outgoing.to.low, outgoing.to.high});
    if (waiting != queues_.end()) {
      if (waiting->second.size() < kQueuedPerWorkerMax) {
        waiting->second.push_back(std::move(queued));
      } else {
        gone.push_back(outgoing.to);
      }
      return;
    }
    switch (channel_.send(outgoing.to, queued.head, queued.data)) {
      case SendOutcome::kSent:
        return;
      case SendOutcome::kFull:
        queues_[{outgoing.to.low, outgoing.to.high}].push_back(std::move(queued));
        return;
      case SendOutcome::kGone:
        gone.push_back(outgoing.to);
        return;
    }
  }

  void flush(std::vector<SessionId>& gone) {
    for (auto entry = queues_.begin(); entry != queues_.end();) {
      const SessionId to{entry->first.first, entry->first.second};
      std::deque<Queued>& queue = entry->second;
      SendOutcome outcome = SendOutcome::kSent;
      while (!queue.empty() && outcome == SendOutcome::kSent) {
        outcome = channel_.send(to, queue.front().head, queue.front().data);
        if (outcome == SendOutcome::kSent) { queue.pop_front(); }
      }
      if (outcome == SendOutcome::kGone) { gone.push_back(to); }
      entry = outcome == SendOutcome::kFull ? std::next(entry) : queues_.erase(entry);
    }
  }

  [[nodiscard]] bool empty() const { return queues_.empty(); }

 private:
  struct Queued {
    std::vector<std::byte> head{};
    Payload data{};
  };
  Channel& channel_;
  std::map<std::pair<std::uint64_t, std::uint64_t>, std::deque<Queued>> queues_;
};

// Who may enter; read again while running.
struct Guard {
  std::string folder{};
  std::shared_ptr<AllowList> allowed{};  // nullptr without keys
  std::atomic<bool>* reload = nullptr;

  // An unreadable list changes nothing: who is inside stays, and the error is told.
  void look_again() const {
    if (!allowed || reload == nullptr || !reload->exchange(false)) { return; }
    const auto workers = load_authorized_workers(folder);
    if (!workers) {
      spdlog::error("event=keys_not_reloaded reason=\"{}\"", workers.error().message);
      return;
    }
    allowed->set_workers(*workers);
    spdlog::warn("event=keys_reloaded workers={}", workers->size());
  }
};

struct Channels {
  std::unique_ptr<Channel> control{};
  std::unique_ptr<Channel> bulk{};
};

class MasterLoop {
 public:
  MasterLoop(std::unique_ptr<Transport> transport, Guard guard, Channels channels,
             JobOptions options, JobScene scene)
      : transport_(std::move(transport)),
        guard_(std::move(guard)),
        control_(std::move(channels.control)),
        bulk_(std::move(channels.bulk)),
        control_out_(*control_),
        bulk_out_(*bulk_),
        timers_(options.timers),
        watch_(options.watch),
        job_(std::move(options), std::move(scene), Clock::now()) {}

  Result<void> start_workers(const MasterOptions& options) {
    std::vector<std::string> arguments{"--connect", control_->endpoint(), "--threads",
                                       std::to_string(options.threads_per_worker)};
    if (!options.security.keys_folder.empty()) {
      arguments.insert(arguments.end(), {"--keys", options.security.keys_folder});
    }
    for (unsigned i = 0; i < options.workers_to_start; ++i) {
      const Result<void> started = children_.start(options.worker_program, arguments);
      if (!started) { return started; }
    }
    return {};
  }

  Result<MasterResult> run(const std::atomic<int>& stop_signal,
                           const std::function<void(const MasterProgress&)>& progress) {
    while (!job_.over()) {
      receive(*control_, ChannelKind::kControl);
      receive(*bulk_, ChannelKind::kBulk);
      const Time now = Clock::now();
      if (const int signal = stop_signal.load(); signal != 0) {
        job_.stop(signal == SIGINT ? ExitCode::kInterrupted : ExitCode::kTerminated, now);
      }
      if (now - tick_last_ >= kBetweenTicks) {
        tick_last_ = now;
        guard_.look_again();
        for (const WorkerProcesses::Ended& ended : children_.reap()) {
          job_.on_child_ended(static_cast<std::uint32_t>(ended.pid), ended.how, children_.running(),
                              now);
        }
        job_.tick(now);
      }
      send(now);
      if (now - progress_last_ >= kBetweenProgress) {
        progress_last_ = now;
        if (progress) { progress(job_.progress(now)); }
        if (watch_ != nullptr) { watch_->look(job_.snapshot(now)); }
      }
      if (job_.over()) { break; }
      const std::array<Channel*, 2> channels{control_.get(), bulk_.get()};
      const bool full = !control_out_.empty() || !bulk_out_.empty();
      transport_->wait(channels, -1, full ? kWaitWhileFull : kWait);
    }
    if (progress) { progress(job_.progress(Clock::now())); }
    children_.end_all(timers_.farewell, timers_.kill_grace);
    const std::uint64_t dropped = control_->dropped() + bulk_->dropped() + frames_dropped_;
    if (dropped > 0) { spdlog::warn("event=unsound_messages_dropped count={}", dropped); }
    Result<MasterResult> result = job_.take_result();
    if (result) { result->connections_denied = transport_->denied(); }
    return result;
  }

 private:
  void receive(Channel& channel, ChannelKind kind) {
    for (std::size_t i = 0; i < kReceivedPerTurn; ++i) {
      const std::optional<Received> received = channel.receive();
      if (!received) { return; }
      const auto frame = decode_frame(received->head.bytes);
      if (!frame) {
        ++frames_dropped_;
        if (frame.error().fault == FrameFault::kVersion && kind == ChannelKind::kControl) {
          job_.on_other_version(received->session, frame.error().version);
        }
      } else if (!may_say(received->role, *frame)) {
        ++frames_dropped_;
      } else if (kind == ChannelKind::kControl) {
        job_.on_control(received->session, *frame, Clock::now());
      } else {
        job_.on_bulk(received->session, *frame, received->data, Clock::now());
      }
    }
  }

  // With keys, a worker's may not ask for the status and the master's own may ask for nothing else.
  static bool may_say(std::optional<KeyRole> role, const Envelope& frame) {
    if (!role) { return true; }
    return std::holds_alternative<StatusRequest>(frame.message) == (*role == KeyRole::kMaster);
  }

  void send(Time now) {
    std::vector<SessionId> gone;
    control_out_.flush(gone);
    // A bulk connection that is not there (yet, or any more) loses what was for it: the worker asks
    // again. Only the control connection says that a worker is gone.
    std::vector<SessionId> ignored;
    bulk_out_.flush(ignored);
    for (const Outgoing& outgoing : job_.take_outgoing()) {
      if (outgoing.channel == ChannelKind::kControl) {
        control_out_.add(outgoing, job_.key(), gone);
      } else {
        bulk_out_.add(outgoing, job_.key(), ignored);
      }
    }
    for (const SessionId& session : gone) { job_.on_gone(session, now); }
  }

  std::unique_ptr<Transport> transport_;
  Guard guard_;
  std::unique_ptr<Channel> control_;
  std::unique_ptr<Channel> bulk_;
  Outbox control_out_;
  Outbox bulk_out_;
  Timers timers_;
  RenderWatch* watch_;
  Job job_;
  WorkerProcesses children_;
  Time tick_last_{};
  Time progress_last_{};
  std::uint64_t frames_dropped_ = 0;
};

Result<void> check_options(const MasterOptions& options, const RenderSettings& settings) {
  const auto wrong = [](std::string text) { return fail(ExitCode::kUsage, std::move(text)); };
  if (options.tile_size < 1 || options.tile_size > kTileSizeMax) {
    return wrong(fmt::format("tile size {} is not from 1 to {}", options.tile_size, kTileSizeMax));
  }
  const TileGrid grid{settings.width, settings.height, options.tile_size};
  const std::uint64_t tiles = std::uint64_t{grid.columns()} * grid.rows();
  if (tiles > kTilesMax) {
    return wrong(
        fmt::format("{} tiles are more than {}: choose a larger tile size", tiles, kTilesMax));
  }
  if (options.threads_per_worker < 1 || options.threads_per_worker > kThreadsMax) {
    return wrong(fmt::format("{} threads per worker are not from 1 to {}",
                             options.threads_per_worker, kThreadsMax));
  }
  return {};
}

Result<Channels> open_channels(Transport& transport, const Endpoint& listen) {
  auto control = transport.listen(listen.text(), ChannelKind::kControl);
  if (!control) { return tl::unexpected(control.error()); }
  // Beside a port that the user chose, so that both can be let through a firewall.
  Endpoint beside = listen;
  if (beside.port == 65535) {
    return fail(ExitCode::kUsage, "port 65535 leaves no port for bulk data, which is one above");
  }
  if (beside.port != 0) { ++beside.port; }
  auto bulk = transport.listen(beside.text(), ChannelKind::kBulk);
  if (!bulk) { return tl::unexpected(bulk.error()); }
  return Channels{std::move(*control), std::move(*bulk)};
}

JobOptions job_options(const MasterOptions& options, const RenderSettings& settings,
                       const Channels& channels) {
  JobOptions job;
  job.key = {random_bits(), random_bits()};
  job.settings = settings;
  job.tile_size = options.tile_size;
  job.count_accesses = options.count_accesses;
  job.paths_per_thread = options.paths_per_thread;
  job.cache = options.cache;
  job.bulk_port = parse_endpoint(channels.bulk->endpoint())->port;
  job.wait_workers = options.wait_workers;
  job.wait = from_seconds(options.wait_workers == 0 ? 0.0 : options.wait_seconds / time_scale());
  job.address = channels.control->endpoint();
  job.build = build_version();
  job.isa = tracing_isa();
  job.self_test = numeric_self_test();
  job.timers = Timers{}.scaled(time_scale());
  job.seed = random_bits();
  job.watch = options.watch;
  job.peers = options.peers;
  job.reach_settled = options.security.reach_settled();
  return job;
}

// `planner` and `store` outlive the scene.
JobScene job_scene(const Store& store, Planner& planner, std::vector<double> fetches) {
  const std::size_t voxel_count = store.tables().voxels.size();
  return {store.tables_bytes(),
          content_hash(store.tables_bytes()),
          VoxelServer{store.tables_bytes(), voxel_count,
                      [&store](VoxelId voxel) { return store.block(voxel); }},
          [&store, voxel_count](VoxelId voxel) {
            return index_of(voxel) >= voxel_count || store.block_is_intact(voxel);
          },
          [&planner](const CacheSize& size) { return planner.plan(size); },
          store.tables().voxels,
          std::move(fetches)};
}

// Every voxel is worth a home, also where nothing was predicted.
std::vector<double> fetches_of(const Store& store, const Prediction& prediction,
                               const RenderSettings& settings, const MasterOptions& options) {
  std::vector<double> rays(store.tables().voxels.size());
  for (std::size_t voxel = 0; voxel < rays.size(); ++voxel) {
    rays[voxel] = 1.0 + prediction.rays(voxel);
  }
  const double in_flight =
      static_cast<double>(options.paths_per_thread * options.threads_per_worker) *
      static_cast<double>(std::max(1U, std::max(options.workers_to_start, options.wait_workers)));
  return expected_fetches(rays, std::max(1.0, sample_count(settings) / in_flight));
}

}  // namespace

Result<MasterResult> run_master(const Store& store, const RenderSettings& settings,
                                const Prediction& prediction, const MasterOptions& options,
                                const std::atomic<int>& stop_signal,
                                const std::function<void(const MasterProgress&)>& progress) {
  if (auto fine = check_options(options, settings); !fine) { return tl::unexpected(fine.error()); }
  std::ofstream ledger;
  if (!options.ledger_file.empty()) {
    ledger.open(options.ledger_file);
    if (!ledger) {
      return fail(ExitCode::kOutputUnwritable,
                  fmt::format("cannot write the ledger {}", options.ledger_file));
    }
  }
  Result<SecureTransport> opened =
      open_transport(options.listen, options.security, KeyRole::kMaster);
  if (!opened) { return tl::unexpected(opened.error()); }
  Result<Channels> channels = open_channels(*opened->transport, opened->endpoint);
  if (!channels) { return tl::unexpected(channels.error()); }
  Guard guard{options.security.keys_folder, opened->allowed, options.reload_keys};

  const std::size_t sharers =
      options.peers ? std::max(options.workers_to_start, options.wait_workers) : 0;
  Planner planner{store, prediction, options.preload_share, sharers};
  JobOptions job = job_options(options, settings, *channels);
  if (ledger.is_open()) {
    job.ledger = [&ledger](const std::string& line) { ledger << line << std::endl; };
  }
  // Where nobody is started, somebody must be told where to go.
  spdlog::log(options.workers_to_start == 0 ? spdlog::level::warn : spdlog::level::info,
              "event=listening control={} bulk={}", job.address, channels->bulk->endpoint());
  if (auto told = write_endpoint(options.endpoint_file, job.address); !told) {
    return tl::unexpected(told.error());
  }
  MasterLoop loop{std::move(opened->transport), std::move(guard), *std::move(channels),
                  std::move(job),
                  job_scene(store, planner, fetches_of(store, prediction, settings, options))};
  if (auto started = loop.start_workers(options); !started) {
    return tl::unexpected(started.error());
  }
  return loop.run(stop_signal, progress);
}

}  // namespace preheat
