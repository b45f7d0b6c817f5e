#include "worker/worker_session.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cstring>

#include "common/scene_tables_codec.h"
#include "common/voxel_block.h"

namespace preheat {
namespace {

constexpr ObjectKey kTablesKey{BulkObject::kTables, VoxelId{0}};
constexpr ObjectKey kPlanKey{BulkObject::kPlan, VoxelId{0}};

}  // namespace

WorkerSession::WorkerSession(Hello hello, const Timers& timers, Duration give_up, Time now)
    : hello_(std::move(hello)),
      timers_(timers),
      give_up_(give_up),
      heard_last_(now),
      tick_last_(now),
      waiting_told_(now),
      fetcher_(timers),
      server_(timers),
      results_(timers.fetch, timers.fetch_max) {
  say_hello(now);
}

void WorkerSession::send(ChannelKind channel, Message message, Payload data) {
  outgoing_.push_back({channel, hello_.session, std::move(message), std::move(data)});
}

void WorkerSession::finish(ExitCode code, std::string text, bool next_master) {
  if (phase_ == Phase::kOver) { return; }
  phase_ = Phase::kOver;
  actions_.emplace_back(Finish{code, std::move(text), next_master});
}

void WorkerSession::on_handshakes(const Handshakes& handshakes) {
  handshakes_broken_ = handshakes.broken;
  if (!handshakes.refused.empty()) {
    finish(
        ExitCode::kMasterGone,
        fmt::format("the master and this worker do not trust each other: {}", handshakes.refused));
  }
}

void WorkerSession::fault(FaultKind kind, VoxelId voxel, const std::string& text) {
  send(ChannelKind::kControl, Fault{kind, voxel, {text}});
}

void WorkerSession::say_hello(Time now) {
  hello_last_ = now;
  send(ChannelKind::kControl, hello_);
}

void WorkerSession::on_other_version(std::uint16_t version) {
  finish(ExitCode::kMismatch,
         fmt::format("the master speaks protocol version {}, this worker ({}) speaks version {}",
                     version, hello_.build.text, kProtocolVersion));
}

void WorkerSession::on_control(const Envelope& frame, Time now) {
  if (phase_ == Phase::kOver) { return; }
  if (const auto* welcome = std::get_if<Welcome>(&frame.message)) {
    heard_last_ = now;
    handle(*welcome, frame.job, now);
    return;
  }
  // Before a Welcome nothing is known of the job; a stranger's or an older master's words are
  // dropped.
  const bool of_any_job = std::holds_alternative<Unknown>(frame.message) ||
                          std::holds_alternative<Refuse>(frame.message);
  if (!of_any_job && frame.job != job_) { return; }
  heard_last_ = now;
  std::visit(
      [&](const auto& message) {
        if constexpr (!std::is_same_v<std::decay_t<decltype(message)>, Welcome>) {
          handle(message, now);
        }
      },
      frame.message);
}

void WorkerSession::handle(const Welcome& welcome, const JobKey& job, Time now) {
  if (phase_ != Phase::kGreeting) { return; }
  if (job == job_ && welcome.tables_hash == welcome_.tables_hash) {
    phase_ = hot_ready_ ? Phase::kRendering : Phase::kPreparing;
    if (hot_ready_) { send(ChannelKind::kControl, Ready{preload_}); }
    results_.restart();
  } else {
    begin_job(welcome, job);
  }
  send_heartbeat(now);
}

void WorkerSession::begin_job(const Welcome& welcome, const JobKey& job) {
  spdlog::info("event=welcome worker={} cache_bytes={} tables_bytes={} plan_voxels={}",
               index_of(welcome.worker), welcome.cache_limit_bytes, welcome.tables_bytes,
               welcome.plan_bytes / 4);
  phase_ = Phase::kPreparing;
  job_ = job;
  welcome_ = welcome;
  hot_ready_ = false;
  counts_ = {};
  for (const auto& [peer, connected] : std::map(connected_)) { disconnect_peer(peer); }
  fetcher_.reset();
  server_.reset();
  results_.reset();
  voxels_.clear();
  hot_known_ = false;
  hot_missing_.clear();
  hot_missing_count_ = 0;
  hot_arrived_bytes_ = 0;
  preparing_bytes_peak_ = 0;
  needed_.clear();
  sources_ = {};
  remote_fetches_ = 0;
  homes_ = {};
  homes_version_ = 0;
  homes_announced_.reset();
  peers_.clear();
  peer_by_session_.clear();
  std::erase_if(early_, [&job](const EarlyRequest& early) { return early.job != job; });
  leases_.clear();
  orphans_.clear();
  actions_.emplace_back(ConnectBulk{static_cast<std::uint16_t>(welcome.bulk_port)});
  fetcher_.want(kTablesKey, welcome.tables_bytes, welcome.tables_hash);
}

void WorkerSession::handle(const Unknown& /*unknown*/, Time now) {
  if (phase_ == Phase::kGreeting && now - hello_last_ < timers_.hello_retry) { return; }
  spdlog::info("event=forgotten_by_master leases={}", leases_.size());
  orphans_ = std::exchange(leases_, {});
  for (const auto& [tile, lease] : orphans_) { actions_.emplace_back(CancelTile{tile}); }
  phase_ = Phase::kGreeting;
  say_hello(now);
}

void WorkerSession::handle(const Grant& grant, Time /*now*/) {
  if (phase_ != Phase::kRendering) { return; }
  const TileGrid grid{welcome_.settings.width, welcome_.settings.height, welcome_.tile_size};
  const std::vector<Lease> sending = results_.leases();
  for (const Lease& lease : grant.leases.items) {
    if (index_of(lease.tile) >= grid.count()) { continue; }
    const auto known = leases_.find(lease.tile);
    if (known != leases_.end() && known->second == lease) { continue; }
    if (std::find(sending.begin(), sending.end(), lease) != sending.end()) { continue; }
    leases_[lease.tile] = lease;
    orphans_.erase(lease.tile);
    actions_.emplace_back(AddTile{lease.tile});
  }
}

void WorkerSession::handle(const Cancel& cancel, Time /*now*/) {
  for (const Lease& lease : cancel.leases.items) {
    const auto known = leases_.find(lease.tile);
    if (known == leases_.end() || known->second.id != lease.id) { continue; }
    orphans_[lease.tile] = lease;
    leases_.erase(known);
    actions_.emplace_back(CancelTile{lease.tile});
  }
}

void WorkerSession::handle(const ResultAck& ack, Time now) {
  results_.on_result_ack(ack.lease, now);
}

void WorkerSession::handle(const Refuse& refuse, Time /*now*/) {
  const bool known = refuse.exit_code == static_cast<int>(ExitCode::kMismatch) ||
                     refuse.exit_code == static_cast<int>(ExitCode::kUsage) ||
                     refuse.exit_code == static_cast<int>(ExitCode::kFailed);
  finish(known ? static_cast<ExitCode>(refuse.exit_code) : ExitCode::kMasterGone,
         fmt::format("refused by the master: {}", refuse.text.text));
}

void WorkerSession::handle(const JobDone& /*done*/, Time /*now*/) {
  if (phase_ == Phase::kRendering && welcome_.count_accesses != AccessCounting::kNone) {
    actions_.emplace_back(TellAccesses{});
    return;
  }
  part();
}

void WorkerSession::on_accesses(std::span<const CellAccesses> accesses) {
  if (phase_ == Phase::kOver) { return; }
  for (std::size_t first = 0; first < accesses.size(); first += kVoxelAccessesMax) {
    VoxelAccesses told{static_cast<std::uint32_t>(first), {}};
    for (const CellAccesses& voxel :
         accesses.subspan(first, std::min(kVoxelAccessesMax, accesses.size() - first))) {
      told.counts.items.push_back(voxel.total());
    }
    send(ChannelKind::kControl, std::move(told));
  }
  part();
}

void WorkerSession::part() {
  send(ChannelKind::kControl, Goodbye{counts_.stats});
  finish(ExitCode::kDone, "the job is done", /*next_master=*/true);
}

void WorkerSession::on_bulk(const Envelope& frame, const Payload& data, Time now) {
  if (frame.job != job_ || phase_ == Phase::kOver) { return; }
  if (const auto* reply = std::get_if<RangeReply>(&frame.message)) {
    fetcher_.on_reply(kOrigin, *reply, data.bytes, now);
    take_fetched(now);
  } else if (const auto* ack = std::get_if<TileChunkAck>(&frame.message)) {
    results_.on_chunk_ack(*ack, now);
  }
}

void WorkerSession::take_fetched(Time now) {
  for (const FetchedObject& object : fetcher_.take_done()) {
    switch (object.key.object) {
      case BulkObject::kTables:
        take_tables(object, now);
        break;
      case BulkObject::kPlan:
        take_plan(object, now);
        break;
      case BulkObject::kHomes:
        take_homes(object, now);
        break;
      case BulkObject::kVoxel:
        take_voxel(object);
        break;
    }
  }
  for (const ObjectKey& key : fetcher_.take_damaged()) {
    if (key.object == BulkObject::kVoxel) {
      server_.on_not_coming(key.voxel);
      fault(FaultKind::kVoxelDamaged, key.voxel, "its hash was wrong twice");
    } else if (key.object == BulkObject::kHomes) {
      spdlog::warn("event=home_plan_damaged version={}", index_of(key.voxel));
    } else {
      fault(FaultKind::kWorkerFailed, {}, "the scene tables or the plan came damaged twice");
      finish(ExitCode::kFailed, "the scene tables or the plan came damaged twice");
    }
  }
}

void WorkerSession::take_tables(const FetchedObject& object, Time now) {
  Result<SceneTables> tables = decode_scene_tables(object.bytes);
  if (!tables) {
    fault(FaultKind::kWorkerFailed, {}, "the scene tables cannot be read");
    finish(ExitCode::kMismatch, "the scene tables cannot be read: " + tables.error().message);
    return;
  }
  voxels_.reserve(tables->voxels.size());
  for (const VoxelEntry& voxel : tables->voxels) {
    voxels_.push_back({voxel.block_bytes, voxel.hot_bytes(), voxel.hash});
  }
  RendererOptions options;
  options.threads = hello_.threads;
  options.cache_limit_bytes = welcome_.cache_limit_bytes - welcome_.home_bytes;
  options.tile_size = welcome_.tile_size;
  options.count_accesses = welcome_.count_accesses;
  options.paths_per_thread = welcome_.paths_per_thread;
  if (options.cache_limit_bytes < tables->resident_bytes_min()) {
    finish(ExitCode::kUsage, fmt::format("a cache of {} bytes is below one voxel of {} bytes",
                                         options.cache_limit_bytes, tables->resident_bytes_min()));
    return;
  }
  hot_missing_.assign(voxels_.size(), false);
  actions_.emplace_back(StartRenderer{std::move(*tables), welcome_.settings, options});
  want_homes();
  if (welcome_.plan_bytes > 0) {
    fetcher_.want(kPlanKey, welcome_.plan_bytes, welcome_.plan_hash);
  } else {
    begin_preload({}, now);
  }
}

void WorkerSession::take_plan(const FetchedObject& object, Time now) {
  SetHotVoxels hot;
  std::vector<bool> seen(voxels_.size());
  std::vector<VoxelId>* part = &hot.voxels;
  for (std::size_t at = 0; at < object.bytes.size(); at += sizeof(std::uint32_t)) {
    std::uint32_t voxel = 0;
    std::memcpy(&voxel, object.bytes.data() + at, sizeof voxel);
    if (voxel == kPlanDivider) { part = &hot.warm; }
    // A bad plan may cost time, nothing else.
    if (voxel >= voxels_.size() || seen[voxel]) { continue; }
    seen[voxel] = true;
    part->push_back(VoxelId{voxel});
  }
  begin_preload(std::move(hot), now);
}

void WorkerSession::begin_preload(SetHotVoxels hot, Time now) {
  hot_known_ = true;
  hot_missing_count_ = hot.voxels.size();
  hot_resident_bytes_ = hot.voxels.empty() ? 0 : kBvhBytesFixed;
  std::uint64_t block_bytes = 0;
  for (const VoxelId voxel : hot.voxels) {
    hot_missing_[index_of(voxel)] = true;
    hot_resident_bytes_ += voxels_[index_of(voxel)].hot_bytes;
    block_bytes += voxels_[index_of(voxel)].block_bytes;
  }
  // Until the hot BVH is built its bytes are free for blocks to pass on.
  if (serves_peers()) {
    const std::uint64_t limit = welcome_.cache_limit_bytes;
    server_.shelf().set_budget(limit - std::min(limit, block_bytes));
  }
  know_peers(now);
  for (const VoxelId voxel : hot.voxels) { want_voxel(voxel, {welcome_.parent.worker}); }
  actions_.emplace_back(std::move(hot));
  for (const VoxelId voxel : server_.waited_for()) {
    if (!hot_missing_[index_of(voxel)]) { server_.on_not_coming(voxel); }
  }
  for (const EarlyRequest& early : std::exchange(early_, {})) {
    answer_peer(early.from, early.range, now);
  }
}

void WorkerSession::take_voxel(const FetchedObject& object) {
  const VoxelId voxel = object.key.voxel;
  const Payload block{object.bytes, object.owner};
  if (hot_missing_[index_of(voxel)]) {
    count_voxel(object, false);
    take_hot_voxel(voxel, block);
  } else {
    if (is_own_home(voxel) && homes_.is_kept(voxel)) { server_.shelf().put(voxel, block); }
    const auto needed = needed_.find(voxel);
    const bool is_needed = needed != needed_.end();
    count_voxel(object, is_needed ? std::optional{needed->second} : std::nullopt);
    if (is_needed) {
      needed_.erase(needed);
      server_.shelf().lend(voxel, block);
      actions_.emplace_back(DeliverVoxel{voxel, {block.bytes, block.owner}});
    }
  }
  server_.on_block(voxel, block);
}

void WorkerSession::take_hot_voxel(VoxelId voxel, const Payload& block) {
  hot_missing_[index_of(voxel)] = false;
  hot_arrived_bytes_ += block.bytes.size();
  BlockShelf& shelf = server_.shelf();
  shelf.put(voxel, block);
  preparing_bytes_peak_ = std::max(preparing_bytes_peak_, hot_arrived_bytes_ + shelf.bytes());
  actions_.emplace_back(DeliverVoxel{voxel, {block.bytes, block.owner}});
  if (--hot_missing_count_ > 0) { return; }
  const std::uint64_t limit = welcome_.cache_limit_bytes;
  shelf.set_budget(std::min(shelf.budget(), limit - std::min(limit, hot_resident_bytes_)));
  shelf.reset_peak();
  preparing_bytes_peak_ = std::max(preparing_bytes_peak_, hot_resident_bytes_ + shelf.bytes());
}

void WorkerSession::count_voxel(const FetchedObject& object, std::optional<bool> needed) {
  const bool from_peer = object.source != kOrigin;
  const std::uint64_t bytes = object.bytes.size();
  if (!needed) {
    sources_.home_bytes += bytes;
    return;
  }
  if (!*needed) {
    (from_peer ? sources_.preload_peer_bytes : sources_.preload_origin_bytes) += bytes;
    return;
  }
  ++remote_fetches_;
  sources_.remote_peer_fetches += from_peer ? 1 : 0;
  (from_peer ? sources_.remote_peer_bytes : sources_.remote_origin_bytes) += bytes;
}

void WorkerSession::on_voxel_needed(const VoxelNeeded& wanted) {
  const VoxelId voxel = wanted.voxel;
  if (const std::optional<Payload> kept = server_.shelf().find(voxel)) {
    ++sources_.home_hits;
    server_.shelf().lend(voxel, *kept);
    actions_.emplace_back(DeliverVoxel{voxel, {kept->bytes, kept->owner}});
    return;
  }
  needed_[voxel] = wanted.waited_for;
  if (is_own_home(voxel)) {
    want_voxel(voxel, {server_.holder(voxel)});
  } else if (const PeerAddress* const home = homes_.home_of(voxel)) {
    want_voxel(voxel, {home->worker});
  } else {
    want_voxel(voxel, {});
  }
}

void WorkerSession::want_voxel(VoxelId voxel, std::vector<WorkerId> peers) {
  std::erase_if(peers, [this](WorkerId peer) { return !peers_.contains(peer); });
  const VoxelName& name = voxels_.at(index_of(voxel));
  fetcher_.want({BulkObject::kVoxel, voxel}, name.block_bytes, name.hash, std::move(peers));
}

void WorkerSession::on_voxel_malformed(VoxelId voxel, const std::string& reason) {
  spdlog::error("event=voxel_malformed voxel={} reason=\"{}\"", index_of(voxel), reason);
  fault(FaultKind::kVoxelDamaged, voxel, "its block is malformed");
}

void WorkerSession::on_hot_set_ready(const PreloadStats& preload) {
  hot_ready_ = true;
  preload_ = preload;
  if (serves_peers()) { server_.shelf().set_budget(welcome_.home_bytes); }
  server_.shelf().reset_peak();
  if (phase_ != Phase::kPreparing) { return; }
  phase_ = Phase::kRendering;
  send(ChannelKind::kControl, Ready{preload_});
}

void WorkerSession::on_tile_done(const TileDone& done, Time /*now*/) {
  for (auto* from : {&leases_, &orphans_}) {
    const auto lease = from->find(done.tile);
    if (lease == from->end()) { continue; }
    results_.add(lease->second, done.pixels);
    from->erase(lease);
    tile_done_since_heartbeat_ = true;
    return;
  }
}

void WorkerSession::on_renderer_failed(const Error& error) {
  spdlog::error("event=renderer_failed reason=\"{}\"", error.message);
  fault(FaultKind::kWorkerFailed, {}, "the renderer failed");
  finish(error.code, error.message);
}

void WorkerSession::leave(ExitCode code) {
  if (phase_ != Phase::kGreeting) { send(ChannelKind::kControl, Goodbye{counts_.stats}); }
  finish(code, "ended by a signal");
}

void WorkerSession::send_heartbeat(Time now) {
  heartbeat_last_ = now;
  tile_done_since_heartbeat_ = false;
  WorkerHeartbeat heartbeat{counts_.progress, counts_.stats, {}};
  heartbeat.held.items = results_.leases();
  for (const auto& [tile, lease] : leases_) { heartbeat.held.items.push_back(lease); }
  heartbeat.homes_version = homes_version_;
  heartbeat.held.items.resize(std::min(heartbeat.held.items.size(), kLeasesPerWorkerMax));
  send(ChannelKind::kControl, std::move(heartbeat));
}

void WorkerSession::tick(Time now) {
  if (phase_ == Phase::kOver) { return; }
  // This process was stopped: the master was not silent all that time.
  if (now - tick_last_ > timers_.tick_gap) { heard_last_ += now - tick_last_; }
  tick_last_ = now;
  if (now - heard_last_ >= give_up_) {
    std::string text = fmt::format("no word from the master for {:.0f} seconds", seconds(give_up_));
    if (handshakes_broken_ > 0) {
      text += fmt::format(
          ": {} connections ended before it had proven that its key is the one in master.pub",
          handshakes_broken_);
    }
    finish(ExitCode::kMasterGone, std::move(text), /*next_master=*/true);
    return;
  }
  if (now - heard_last_ >= timers_.waiting_notice &&
      now - waiting_told_ >= timers_.waiting_notice) {
    waiting_told_ = now;
    spdlog::info("event=waiting_for_master seconds={:.0f}", seconds(now - heard_last_));
  }
  if (phase_ == Phase::kGreeting) {
    if (now - hello_last_ >= timers_.hello_retry) { say_hello(now); }
    return;
  }
  const Duration sooner = timers_.heartbeat / 5;
  if (now - heartbeat_last_ >= (tile_done_since_heartbeat_ ? sooner : timers_.heartbeat)) {
    send_heartbeat(now);
  }
  for (const auto& [source, range] : fetcher_.take_requests(now)) {
    if (source == kOrigin) {
      send(ChannelKind::kBulk, range);
    } else {
      ask_peer(source, range, now);
    }
  }
  disconnect_liars();
  serve_peers(now);
  for (auto& [chunk, data] : results_.take_chunks(now)) {
    send(ChannelKind::kBulk, chunk, std::move(data));
  }
}

}  // namespace preheat
