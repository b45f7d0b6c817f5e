#include "master/job.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>

#include "cache/tracer.h"
#include "common/check.h"
#include "common/content_hash.h"
#include "common/tile_codec.h"
#include "master/home_assignment.h"

namespace preheat {
namespace {

std::pair<std::uint64_t, std::uint64_t> key_of(const SessionId& session) {
  return {session.low, session.high};
}

std::uint64_t number(LeaseId lease) { return index_of(lease); }

const char* name_of(ResultOutcome outcome) {
  switch (outcome) {
    case ResultOutcome::kCommitted:
      return "commit";
    case ResultOutcome::kReplaced:
      return "replace";
    case ResultOutcome::kDuplicate:
      return "duplicate";
    case ResultOutcome::kMismatch:
      return "mismatch";
    case ResultOutcome::kUnknown:
      return "unknown";
  }
  return "unknown";
}

}  // namespace

Job::Job(JobOptions options, JobScene scene, Time now)
    : options_(std::move(options)),
      scene_(std::move(scene)),
      grid_{options_.settings.width, options_.settings.height, options_.tile_size},
      leases_(grid_, options_.timers.lease_min, options_.seed),
      film_(options_.settings.width, options_.settings.height),
      begin_(now),
      tick_last_(now),
      heartbeat_last_(now),
      waiting_since_(now),
      waiting_told_(now) {}

template <class... Values>
void Job::note(const char* format, const Values&... values) {
  if (options_.ledger) { options_.ledger(fmt::format(fmt::runtime(format), values...)); }
}

void Job::send(const Worker& worker, ChannelKind channel, Message message, Payload data) {
  outgoing_.push_back({channel, worker.session, std::move(message), std::move(data)});
}

Job::Worker* Job::find(const SessionId& session) {
  const auto entry = by_session_.find(key_of(session));
  return entry == by_session_.end() ? nullptr : workers_[index_of(entry->second)].get();
}

std::size_t Job::present() const {
  return static_cast<std::size_t>(
      std::count_if(workers_.begin(), workers_.end(),
                    [](const auto& worker) { return worker->presence != Presence::kAbsent; }));
}

void Job::on_other_version(const SessionId& from, std::uint16_t version) {
  spdlog::warn("event=worker_refused reason=\"it speaks protocol version {}, this master {}\"",
               version, kProtocolVersion);
  // The worker reads our version from the frame's header, whatever it makes of the rest.
  outgoing_.push_back(
      {ChannelKind::kControl,
       from,
       Refuse{static_cast<std::uint8_t>(ExitCode::kMismatch),
              {fmt::format("protocol version {} is not {}", version, kProtocolVersion)}},
       {}});
}

void Job::on_control(const SessionId& from, const Envelope& frame, Time now) {
  if (phase_ == Phase::kOver) { return; }
  if (const auto* hello = std::get_if<Hello>(&frame.message)) {
    handle_hello(from, *hello, now);
    return;
  }
  if (std::holds_alternative<StatusRequest>(frame.message)) {
    outgoing_.push_back({ChannelKind::kControl, from, status(now), {}});
    return;
  }
  Worker* worker = find(from);
  if (worker == nullptr || worker->presence == Presence::kAbsent || frame.job != options_.key) {
    const bool leaves = std::holds_alternative<Goodbye>(frame.message);
    if (!leaves && phase_ != Phase::kFarewell) {
      outgoing_.push_back({ChannelKind::kControl, from, Unknown{}, {}});
    }
    return;
  }
  worker->heard_last = now;
  std::visit([&](const auto& message) { handle(*worker, message, now); }, frame.message);
}

std::optional<Refuse> Job::objection(const Hello& hello) const {
  const auto refuse = [](ExitCode code, std::string text) {
    return Refuse{static_cast<std::uint8_t>(code), {std::move(text)}};
  };
  if (hello.build.text != options_.build) {
    return refuse(ExitCode::kMismatch,
                  fmt::format("the worker is version {}, the master is version {}",
                              hello.build.text, options_.build));
  }
  if (hello.isa.text != options_.isa) {
    return refuse(ExitCode::kMismatch,
                  fmt::format("the worker traces with {}, the master's job wants {}",
                              hello.isa.text, options_.isa));
  }
  if (hello.self_test != options_.self_test) {
    return refuse(ExitCode::kMismatch,
                  "the worker's arithmetic gives other bits than the master's");
  }
  if (present() >= kWorkersMax || workers_.size() >= kSessionsMax) {
    return refuse(ExitCode::kMasterGone, fmt::format("there are {} workers already", present()));
  }
  return std::nullopt;
}

void Job::handle_hello(const SessionId& from, const Hello& hello, Time now) {
  if (phase_ == Phase::kFarewell || hello.session != from) { return; }
  CacheSize cache = options_.cache;
  if (hello.cache_kind == CacheRequestKind::kShare) { cache = {hello.cache_share, 0}; }
  if (hello.cache_kind == CacheRequestKind::kBytes) { cache = {0.0, hello.cache_bytes}; }
  std::optional<Refuse> refusal = objection(hello);
  Result<WorkerPlan> plan = WorkerPlan{};
  if (!refusal) {
    plan = scene_.plan(cache);
    if (!plan) {
      refusal = Refuse{static_cast<std::uint8_t>(plan.error().code), {plan.error().message}};
    }
  }
  if (refusal) {
    spdlog::warn("event=worker_refused reason=\"{}\"", refusal->text.text);
    outgoing_.push_back({ChannelKind::kControl, from, *refusal, {}});
    return;
  }
  Worker* worker = find(from);
  if (worker == nullptr) {
    const WorkerId id{static_cast<std::uint32_t>(workers_.size())};
    workers_.push_back(std::make_unique<Worker>());
    worker = workers_.back().get();
    worker->id = id;
    worker->session = from;
    by_session_[key_of(from)] = id;
  }
  // One that comes back holds nothing: what it still sends is compared.
  leases_.remove_worker(worker->id);
  leases_.add_worker(worker->id);
  worker->presence = Presence::kPreparing;
  worker->process_id = hello.process_id;
  worker->threads = hello.threads;
  worker->plan = std::move(*plan);
  worker->stalled = false;
  worker->heard_last = now;
  worker->assemblies.clear();
  const bool is_new = worker->peer.worker == kNoWorker;
  worker->peer = peer_address(*worker, hello);
  worker->homes_version = 0;
  homes_stale_ = true;
  // One that comes back may have children of its own, who must not become its parents.
  if (Worker* const parent = is_new ? find_parent(*worker) : nullptr) {
    worker->parent = parent->id;
    ++parent->children;
  }
  if (!first_worker_) { first_worker_ = now; }
  spdlog::info("event=worker_joined worker={} pid={} threads={} cache_bytes={} hot_voxels={}",
               index_of(worker->id), hello.process_id, hello.threads,
               worker->plan.cache_limit_bytes, worker->plan.hot->hot_count);
  note(R"({{"event":"join","time":{:.6f},"worker":{},"pid":{}}})", seconds(now - begin_),
       index_of(worker->id), hello.process_id);
  welcome(*worker);
}

void Job::welcome(const Worker& worker) {
  Welcome welcome;
  welcome.worker = worker.id;
  welcome.bulk_port = options_.bulk_port;
  welcome.settings = options_.settings;
  welcome.tile_size = options_.tile_size;
  welcome.count_accesses = options_.count_accesses;
  welcome.paths_per_thread = options_.paths_per_thread;
  welcome.cache_limit_bytes = worker.plan.cache_limit_bytes;
  welcome.tables_bytes = scene_.tables.size();
  welcome.tables_hash = scene_.tables_hash;
  welcome.plan_bytes = worker.plan.hot->bytes.size();
  welcome.plan_hash = worker.plan.hot->hash;
  welcome.home_bytes = worker.peer.endpoint.text.empty() ? 0 : worker.plan.home_bytes;
  if (worker.parent != kNoWorker) { welcome.parent = workers_[index_of(worker.parent)]->peer; }
  send(worker, ChannelKind::kControl, welcome);
}

void Job::handle(Worker& worker, const Ready& ready, Time now) {
  if (worker.presence != Presence::kPreparing) { return; }
  worker.presence = Presence::kReady;
  worker.stats.preload = ready.preload;
  history_.worker_ready(worker.id, worker.threads, now);
  spdlog::info("event=worker_ready worker={} voxels={} bytes={} seconds={:.3f}",
               index_of(worker.id), ready.preload.voxels, ready.preload.bytes,
               ready.preload.seconds);
  grant_to(worker, ready_count(), now);
}

void Job::handle(Worker& worker, const WorkerHeartbeat& heartbeat, Time now) {
  worker.stats = heartbeat.stats;
  history_.counted(worker.id, worker.stats, now);
  worker.homes_version = heartbeat.homes_version;
  if (worker.homes_version != homes_version_ &&
      now - worker.homes_told >= 2 * options_.timers.heartbeat) {
    tell_homes(worker, now);
  }
  if (heartbeat.progress != worker.progress) {
    worker.progress = heartbeat.progress;
    worker.stalled = false;
    leases_.progress(worker.id, now);
  }
  // Leases that were granted long ago and that the worker does not know of got lost on their way.
  std::vector<LeaseId> held;
  for (const Lease& lease : heartbeat.held.items) { held.push_back(lease.id); }
  std::sort(held.begin(), held.end());
  Grant again;
  for (const Lease& lease : leases_.held_by(worker.id)) {
    const bool known = std::binary_search(held.begin(), held.end(), lease.id);
    const bool old = now - *leases_.granted_at(lease.id) >= 2 * options_.timers.heartbeat;
    if (!known && old) { again.leases.items.push_back(lease); }
  }
  if (!again.leases.items.empty()) { send(worker, ChannelKind::kControl, std::move(again)); }
}

void Job::handle(Worker& worker, const Fault& fault, Time now) {
  spdlog::warn("event=worker_fault worker={} reason=\"{}\"", index_of(worker.id), fault.text.text);
  if (fault.kind == FaultKind::kWorkerFailed) {
    lose(worker, Loss::kDied, "it failed", now);
    return;
  }
  const std::uint32_t voxel = index_of(fault.voxel);
  if (!scene_.block_is_intact(fault.voxel)) {
    fail_job({ExitCode::kStoreDamaged,
              fmt::format("the store is damaged: voxel {} does not match its hash", voxel)},
             now);
    return;
  }
  expel(worker,
        Refuse{static_cast<std::uint8_t>(ExitCode::kFailed),
               {fmt::format("voxel {} is sound here and damaged there", voxel)}},
        now);
}

void Job::handle(Worker& worker, const Goodbye& goodbye, Time now) {
  worker.stats = goodbye.stats;
  history_.counted(worker.id, worker.stats, now);
  history_.worker_gone(worker.id, /*lost=*/false, now);
  worker.presence = Presence::kAbsent;
  homes_stale_ = true;
  worker.assemblies.clear();
  leases_.remove_worker(worker.id);
  spdlog::info("event=worker_left worker={} tiles={}", index_of(worker.id), goodbye.stats.tiles);
  note(R"({{"event":"leave","time":{:.6f},"worker":{}}})", seconds(now - begin_),
       index_of(worker.id));
}

void Job::handle(Worker& worker, const VoxelAccesses& told, Time /*now*/) {
  const std::size_t left = scene_.voxels.size() - worker.accesses.size();
  if (told.first != worker.accesses.size() || told.counts.items.size() > left) { return; }
  worker.accesses.insert(worker.accesses.end(), told.counts.items.begin(), told.counts.items.end());
}

std::vector<double> Job::accesses_by_voxel() const {
  if (options_.count_accesses == AccessCounting::kNone) { return {}; }
  const double scale = Tracer::accesses_per_count(options_.count_accesses);
  std::vector<double> sums(scene_.voxels.size(), 0.0);
  for (const auto& worker : workers_) {
    if (worker->stats.tiles > 0 && worker->accesses.size() != sums.size()) { return {}; }
    for (std::size_t voxel = 0; voxel < worker->accesses.size(); ++voxel) {
      sums[voxel] += scale * static_cast<double>(worker->accesses[voxel]);
    }
  }
  return sums;
}

void Job::expel(Worker& worker, const Refuse& reason, Time now) {
  send(worker, ChannelKind::kControl, reason);
  lose(worker, Loss::kSilent, "it was sent away", now);
}

void Job::lose(Worker& worker, Loss loss, const char* why, Time now) {
  if (worker.presence == Presence::kAbsent) { return; }
  spdlog::warn("event=worker_lost worker={} leases={} reason=\"{}\"", index_of(worker.id),
               leases_.held_count(worker.id), why);
  note(R"({{"event":"lost","time":{:.6f},"worker":{},"leases":{}}})", seconds(now - begin_),
       index_of(worker.id), leases_.held_count(worker.id));
  worker.presence = Presence::kAbsent;
  homes_stale_ = true;
  ++workers_lost_;
  history_.worker_gone(worker.id, /*lost=*/true, now);
  worker.assemblies.clear();
  if (loss == Loss::kSilent) {
    leases_.remove_worker(worker.id);
    return;
  }
  for (const TileId tile : leases_.worker_died(worker.id)) {
    spdlog::error(
        "event=tile_given_up tile={} reason=\"several workers died on it, two with no other\"",
        index_of(tile));
    note(R"({{"event":"poison","time":{:.6f},"tile":{}}})", seconds(now - begin_), index_of(tile));
  }
}

void Job::on_gone(const SessionId& session, Time now) {
  if (Worker* worker = find(session)) { lose(*worker, Loss::kDied, "its connection is gone", now); }
}

void Job::on_child_ended(std::uint32_t process_id, const std::string& how, std::size_t left,
                         Time now) {
  children_left_ = left;
  if (phase_ == Phase::kFarewell || phase_ == Phase::kOver) { return; }
  spdlog::warn("event=child_ended pid={} how=\"{}\" left={}", process_id, how, left);
  for (const auto& worker : workers_) {
    if (worker->process_id == process_id) {
      lose(*worker, Loss::kDied, "its process has ended", now);
    }
  }
}

void Job::on_bulk(const SessionId& from, const Envelope& frame, const Payload& data, Time now) {
  Worker* worker = find(from);
  if (worker == nullptr || worker->presence == Presence::kAbsent || frame.job != options_.key) {
    return;
  }
  worker->heard_last = now;
  if (const auto* request = std::get_if<RangeRequest>(&frame.message)) {
    if (std::optional<Payload> bytes = scene_.server.answer(*request, worker->plan.hot)) {
      if (request->object == BulkObject::kVoxel) {
        (worker->presence == Presence::kReady ? origin_.remote_bytes : origin_.preload_bytes) +=
            bytes->bytes.size();
      }
      send(*worker, ChannelKind::kBulk,
           RangeReply{request->object, request->voxel, request->offset}, std::move(*bytes));
    }
  } else if (const auto* chunk = std::get_if<TileChunk>(&frame.message)) {
    take_chunk(*worker, *chunk, data.bytes, now);
  }
}

void Job::take_chunk(Worker& worker, const TileChunk& chunk, std::span<const std::byte> data,
                     Time now) {
  const std::optional<TileId> tile = leases_.tile_of(worker.id, chunk.lease);
  send(worker, ChannelKind::kBulk, TileChunkAck{chunk.lease, chunk.offset});
  if (!tile) {
    note(R"({{"event":"discard","time":{:.6f},"worker":{},"tile":{},"lease":"{:016x}"}})",
         seconds(now - begin_), index_of(worker.id), index_of(chunk.tile), number(chunk.lease));
    send(worker, ChannelKind::kControl, ResultAck{chunk.lease});
    return;
  }
  const std::uint64_t total = tile_bytes(grid_.rect(*tile));
  const bool fits = *tile == chunk.tile && chunk.total_bytes == total &&
                    chunk.offset % kChunkBytesMax == 0 && chunk.offset < total &&
                    data.size() == std::min<std::uint64_t>(kChunkBytesMax, total - chunk.offset);
  if (!fits) {
    expel(worker, Refuse{static_cast<std::uint8_t>(ExitCode::kFailed), {"a tile of a wrong shape"}},
          now);
    return;
  }
  Assembly& assembly = worker.assemblies[chunk.lease];
  if (assembly.bytes.empty()) {
    assembly.bytes.resize(total);
    assembly.missing = (total + kChunkBytesMax - 1) / kChunkBytesMax;
    assembly.arrived.resize(assembly.missing);
  }
  const std::size_t index = chunk.offset / kChunkBytesMax;
  if (assembly.arrived[index]) { return; }
  assembly.arrived[index] = true;
  std::copy(data.begin(), data.end(),
            assembly.bytes.begin() + static_cast<std::ptrdiff_t>(chunk.offset));
  if (--assembly.missing > 0) { return; }
  const Assembly whole = std::move(assembly);
  worker.assemblies.erase(chunk.lease);
  take_tile(worker, chunk, whole, now);
}

void Job::take_tile(Worker& worker, const TileChunk& chunk, const Assembly& assembly, Time now) {
  if (content_hash(assembly.bytes) != chunk.hash) {
    // Not acknowledged, so it comes again.
    spdlog::warn("event=tile_damaged_in_flight worker={} tile={}", index_of(worker.id),
                 index_of(chunk.tile));
    return;
  }
  const TileRect rect = grid_.rect(chunk.tile);
  const Result<TilePixels> pixels = decode_tile(assembly.bytes, rect);
  if (!pixels) {
    expel(worker, Refuse{static_cast<std::uint8_t>(ExitCode::kFailed), {pixels.error().message}},
          now);
    return;
  }
  const std::optional<Time> leased = leases_.granted_at(chunk.lease);
  const LeaseVerdict verdict = leases_.result(worker.id, chunk.lease, chunk.hash, now);
  if (verdict.outcome == ResultOutcome::kCommitted || verdict.outcome == ResultOutcome::kReplaced) {
    film_.assign(rect, *pixels);
    last_commit_ = now;
    history_.tile_done(worker.id, chunk.tile, leased.value_or(now), now);
    if (options_.watch != nullptr) { options_.watch->tile_done(rect, *pixels); }
  }
  if (verdict.outcome == ResultOutcome::kMismatch || verdict.outcome == ResultOutcome::kReplaced) {
    spdlog::error("event=tile_mismatch worker={} tile={} outcome={}", index_of(worker.id),
                  index_of(chunk.tile), name_of(verdict.outcome));
  }
  note(R"({{"event":"{}","time":{:.6f},"worker":{},"tile":{},"lease":"{:016x}"}})",
       name_of(verdict.outcome), seconds(now - begin_), index_of(worker.id), index_of(chunk.tile),
       number(chunk.lease));
  for (const auto& [other, lease] : verdict.cancelled) {
    send(*workers_[index_of(other)], ChannelKind::kControl, Cancel{{{lease}}});
  }
  send(worker, ChannelKind::kControl, ResultAck{chunk.lease});
  grant_to(worker, ready_count(), now);
}

std::size_t Job::ready_count() const {
  return static_cast<std::size_t>(
      std::count_if(workers_.begin(), workers_.end(),
                    [](const auto& worker) { return worker->presence == Presence::kReady; }));
}

std::size_t Job::leases_wanted(const Worker& worker, std::size_t ready) const {
  const std::size_t least = 2 * worker.threads + 1;
  const std::uint64_t samples_per_tile =
      std::uint64_t{options_.tile_size} * options_.tile_size * options_.settings.spp;
  const std::uint64_t deep =
      least + 2 * worker.threads * options_.paths_per_thread / samples_per_tile;
  const std::uint64_t open = grid_.count() - leases_.tiles_committed();
  const std::uint64_t fair = open / (2 * std::max<std::uint64_t>(1, ready));
  return std::max<std::size_t>(least, std::min({deep, fair, std::uint64_t{kLeasesPerWorkerMax}}));
}

bool Job::may_be_granted(const Worker& worker, Time now) const {
  return phase_ == Phase::kRendering && worker.presence == Presence::kReady && !worker.stalled &&
         now - worker.heard_last < options_.timers.suspect;
}

void Job::grant_to(Worker& worker, std::size_t ready, Time now) {
  if (!may_be_granted(worker, now)) { return; }
  Grant grant;
  const std::size_t wanted = leases_wanted(worker, ready);
  while (leases_.held_count(worker.id) < wanted) {
    const std::optional<Lease> lease = leases_.grant(worker.id, now);
    if (!lease) { break; }
    grant.leases.items.push_back(*lease);
    note(R"({{"event":"lease","time":{:.6f},"worker":{},"tile":{},"lease":"{:016x}"}})",
         seconds(now - begin_), index_of(worker.id), index_of(lease->tile), number(lease->id));
  }
  send_grant(worker, std::move(grant), now);
}

void Job::send_grant(const Worker& worker, Grant grant, Time now) {
  if (grant.leases.items.empty()) { return; }
  if (!first_lease_) { first_lease_ = now; }
  history_.begin(now);
  send(worker, ChannelKind::kControl, std::move(grant));
}

void Job::grant_to_all(Time now) {
  const std::size_t ready = ready_count();
  for (const auto& worker : workers_) { grant_to(*worker, ready, now); }
  double_last_tiles(now);
}

void Job::double_last_tiles(Time now) {
  const auto is_idle = [&](const Worker& worker) {
    return may_be_granted(worker, now) && leases_.held_count(worker.id) < worker.threads;
  };
  if (std::none_of(workers_.begin(), workers_.end(),
                   [&](const auto& worker) { return is_idle(*worker); })) {
    return;
  }
  const std::vector<TileId> last = leases_.last_tiles(now);
  for (const auto& worker : workers_) {
    Grant grant;
    for (std::size_t at = 0; at < last.size() && is_idle(*worker); ++at) {
      const std::optional<Lease> lease = leases_.grant_second(worker->id, last[at], now);
      if (!lease) { continue; }
      grant.leases.items.push_back(*lease);
      note(R"({{"event":"double","time":{:.6f},"worker":{},"tile":{},"lease":"{:016x}"}})",
           seconds(now - begin_), index_of(worker->id), index_of(lease->tile), number(lease->id));
    }
    send_grant(*worker, std::move(grant), now);
  }
}

void Job::tick(Time now) {
  if (phase_ == Phase::kOver) { return; }
  const Duration gap = now - tick_last_;
  tick_last_ = now;
  if (gap > options_.timers.tick_gap) {
    // This process stood still; so, perhaps, did everybody. Nobody's silence counts.
    spdlog::warn("event=master_stood_still seconds={:.1f}", seconds(gap));
    leases_.extend_all(gap);
    for (const auto& worker : workers_) { worker->heard_last += gap; }
    waiting_since_ += gap;
  }
  watch_workers(now);
  watch_leases(now);
  watch_phase(now);
  grant_to_all(now);
  plan_homes(now);
}

PeerAddress Job::peer_address(const Worker& worker, const Hello& hello) const {
  PeerAddress peer{worker.id, worker.session, {}};
  const std::string& endpoint = hello.peer_endpoint.text;
  if (!options_.peers || endpoint.empty()) { return peer; }
  if (const auto fine = check_endpoint(endpoint, options_.reach_settled); fine) {
    peer.endpoint.text = endpoint;
  } else {
    spdlog::warn("event=peer_address_refused worker={} reason=\"{}\"", index_of(worker.id),
                 fine.error().message);
  }
  return peer;
}

Job::Worker* Job::find_parent(const Worker& child) {
  if (child.plan.hot->bytes.empty()) { return nullptr; }
  for (const auto& other : workers_) {
    const bool passes_on = other->presence == Presence::kPreparing &&
                           other->plan.hot == child.plan.hot &&
                           !other->peer.endpoint.text.empty() && other->children < kChildrenMax;
    if (passes_on && other->id != child.id) { return other.get(); }
  }
  return nullptr;
}

void Job::plan_homes(Time now) {
  if (!homes_stale_ || phase_ != Phase::kRendering ||
      now - homes_planned_ < options_.timers.plan_gap) {
    return;
  }
  homes_stale_ = false;
  homes_planned_ = now;
  HomePlan plan;
  std::vector<HomeCandidate> candidates;
  // What everybody holds already needs no home.
  std::vector<std::size_t> hot_count(scene_.voxels.size());
  std::map<const EncodedPlan*, std::size_t> holders;
  for (const auto& worker : workers_) {
    if (worker->presence == Presence::kAbsent || worker->peer.endpoint.text.empty()) { continue; }
    plan.peers.push_back(worker->peer);
    candidates.push_back({worker->id, worker->plan.home_bytes});
    ++holders[worker->plan.hot.get()];
  }
  for (const auto& [hot, count] : holders) {
    for (const VoxelId voxel : hot->hot_voxels()) { hot_count[index_of(voxel)] += count; }
  }
  std::vector<double> fetches = scene_.fetches;
  for (std::size_t voxel = 0; voxel < fetches.size(); ++voxel) {
    if (candidates.size() < 2 || hot_count[voxel] == candidates.size()) { fetches[voxel] = 0.0; }
  }
  plan.homes = assign_homes(candidates, fetches, scene_.voxels, home_of_);
  home_of_.assign(scene_.voxels.size(), kNoWorker);
  for (std::size_t voxel = 0; voxel < plan.homes.size(); ++voxel) {
    if (plan.homes[voxel] == HomePlan::kNoHome) { continue; }
    home_of_[voxel] = plan.peers[HomePlan::index(plan.homes[voxel])].worker;
  }
  auto encoded = std::make_shared<EncodedPlan>();
  encoded->bytes = encode_home_plan(plan);
  encoded->hash = content_hash(encoded->bytes);
  homes_ = std::move(encoded);
  scene_.server.set_homes(++homes_version_, homes_);
  for (const auto& worker : workers_) {
    if (worker->presence != Presence::kAbsent) { tell_homes(*worker, now); }
  }
}

void Job::tell_homes(Worker& worker, Time now) {
  if (!homes_) { return; }
  worker.homes_told = now;
  send(worker, ChannelKind::kControl,
       PeersChanged{homes_version_, homes_->bytes.size(), homes_->hash});
}

void Job::watch_workers(Time now) {
  for (const auto& worker : workers_) {
    if (worker->presence != Presence::kAbsent && now - worker->heard_last >= options_.timers.dead) {
      lose(*worker, Loss::kSilent, "it is silent", now);
    }
  }
  if (now - heartbeat_last_ < options_.timers.heartbeat) { return; }
  heartbeat_last_ = now;
  for (const auto& worker : workers_) {
    if (worker->presence == Presence::kAbsent) { continue; }
    send(*worker, ChannelKind::kControl, MasterHeartbeat{leases_.tiles_committed(), grid_.count()});
  }
}

void Job::watch_leases(Time now) {
  for (const auto& [id, lease] : leases_.expire(now)) {
    Worker& worker = *workers_[index_of(id)];
    spdlog::warn("event=lease_expired worker={} tile={}", index_of(id), index_of(lease.tile));
    note(R"({{"event":"expire","time":{:.6f},"worker":{},"tile":{},"lease":"{:016x}"}})",
         seconds(now - begin_), index_of(id), index_of(lease.tile), number(lease.id));
    worker.stalled = true;
    send(worker, ChannelKind::kControl, Cancel{{{lease}}});
  }
}

void Job::watch_phase(Time now) {
  if (phase_ == Phase::kFarewell) {
    if (present() == 0 || now - farewell_begin_ >= options_.timers.farewell) {
      phase_ = Phase::kOver;
    }
    return;
  }
  if (leases_.finished()) {
    begin_farewell(now);
    return;
  }
  const std::size_t here = present();
  if (children_left_ == std::size_t{0} && here == 0) {
    fail_job({ExitCode::kFailed, "every worker process that was started has ended"}, now);
    return;
  }
  // Workers that are gone for good are not waited for.
  std::size_t wanted = std::max(1U, options_.wait_workers);
  if (children_left_) { wanted = std::clamp<std::size_t>(*children_left_, 1, wanted); }
  if (phase_ == Phase::kWaiting && here >= wanted) { phase_ = Phase::kRendering; }
  if (phase_ == Phase::kRendering && here > 0) {
    waiting_since_ = now;
    return;
  }
  if (now - waiting_since_ >= options_.wait) {
    fail_job({ExitCode::kNoWorkers,
              fmt::format("no workers in time: {} of {} are at {} after {:.0f} seconds", here,
                          wanted, options_.address, seconds(options_.wait))},
             now);
    return;
  }
  if (now - waiting_since_ >= options_.timers.waiting_notice &&
      now - waiting_told_ >= options_.timers.waiting_notice) {
    waiting_told_ = now;
    spdlog::warn("event=waiting_for_workers address={} here={} wanted={} seconds={:.0f}",
                 options_.address, here, wanted, seconds(now - waiting_since_));
  }
}

void Job::begin_farewell(Time now) {
  phase_ = Phase::kFarewell;
  farewell_begin_ = now;
  for (const auto& worker : workers_) {
    if (worker->presence != Presence::kAbsent) { send(*worker, ChannelKind::kControl, JobDone{}); }
  }
}

void Job::fail_job(Error error, Time now) {
  if (phase_ == Phase::kFarewell || phase_ == Phase::kOver) { return; }
  error_ = std::move(error);
  begin_farewell(now);
}

void Job::stop(ExitCode code, Time now) { fail_job({code, "ended by a signal"}, now); }

MasterProgress Job::progress(Time now) const {
  MasterProgress progress;
  progress.tiles_done = leases_.tiles_committed();
  progress.tiles_total = grid_.count();
  progress.workers = static_cast<unsigned>(present());
  CacheStats cache;
  for (const auto& worker : workers_) {
    progress.rays += worker->stats.rays.total();
    cache.add(worker->stats.cache);
  }
  if (cache.accesses > 0) {
    progress.hit_rate =
        1.0 - static_cast<double>(cache.misses) / static_cast<double>(cache.accesses);
  }
  if (first_lease_) { progress.seconds = seconds(now - *first_lease_); }
  return progress;
}

Status Job::status(Time now) const {
  const MasterProgress so_far = progress(now);
  Status status;
  status.build.text = options_.build;
  status.phase = phase_;
  status.tiles_done = so_far.tiles_done;
  status.tiles_total = so_far.tiles_total;
  status.workers = so_far.workers;
  status.workers_lost = workers_lost_;
  status.leases_expired = leases_.stats().expired;
  status.rays = so_far.rays;
  for (const auto& worker : workers_) {
    status.workers_ready += worker->presence == Presence::kReady ? 1U : 0U;
    status.accesses += worker->stats.cache.accesses;
    status.misses += worker->stats.cache.misses;
  }
  status.waiting_seconds = seconds(first_lease_.value_or(now) - begin_);
  status.rendering_seconds = so_far.seconds;
  return status;
}

RenderSnapshot Job::snapshot(Time now) const {
  RenderSnapshot snapshot;
  snapshot.phase = phase_;
  snapshot.tiles_done = leases_.tiles_committed();
  snapshot.tiles_total = grid_.count();
  snapshot.workers_lost = workers_lost_;
  snapshot.leases = leases_.stats();
  snapshot.waiting_seconds = seconds(first_lease_.value_or(now) - begin_);
  if (first_lease_) { snapshot.rendering_seconds = seconds(now - *first_lease_); }
  for (const auto& worker : workers_) {
    const bool gone = worker->presence == Presence::kAbsent;
    const bool ready = worker->presence == Presence::kReady;
    snapshot.workers.push_back({gone    ? WorkerState::kGone
                                : ready ? WorkerState::kReady
                                        : WorkerState::kPreparing,
                                worker->threads, gone ? 0 : leases_.held_count(worker->id),
                                worker->stats});
  }
  return snapshot;
}

Result<MasterResult> Job::take_result() {
  CHECK(phase_ == Phase::kOver);
  if (error_) { return tl::unexpected(*error_); }
  MasterResult result{.film = std::move(film_)};
  result.leases = leases_.stats();
  result.origin = origin_;
  for (const auto& worker : workers_) { result.workers.push_back(worker->stats); }
  result.accesses_by_voxel = accesses_by_voxel();
  result.poisoned_tiles = leases_.poisoned();
  if (first_lease_) {
    result.preload_seconds = seconds(*first_lease_ - *first_worker_);
    const Time end = std::max(last_commit_, *first_lease_);
    result.render_seconds = seconds(end - *first_lease_);
    result.history = history_.take(end);
  }
  return result;
}

}  // namespace preheat
