// The part of a session that deals with other workers.
#include <spdlog/spdlog.h>

#include <algorithm>
#include <set>
#include <utility>

#include "worker/worker_session.h"

namespace preheat {

void WorkerSession::handle(const PeersChanged& changed, Time /*now*/) {
  const std::uint32_t newest =
      homes_announced_ ? std::max(homes_version_, homes_announced_->version) : homes_version_;
  if (changed.version <= newest) { return; }
  if (homes_announced_) {
    fetcher_.forget({BulkObject::kHomes, VoxelId{homes_announced_->version}});
  }
  homes_announced_ = changed;
  want_homes();
}

// The plan cannot be read before the tables say how many voxels there are.
void WorkerSession::want_homes() {
  if (!homes_announced_ || voxels_.empty()) { return; }
  fetcher_.want({BulkObject::kHomes, VoxelId{homes_announced_->version}}, homes_announced_->bytes,
                homes_announced_->hash);
}

void WorkerSession::take_homes(const FetchedObject& object, Time now) {
  if (!homes_announced_ || homes_announced_->version != index_of(object.key.voxel)) { return; }
  Result<HomePlan> homes = decode_home_plan(object.bytes, voxels_.size());
  if (!homes) {
    // The master is asked as before; its next plan may be better.
    spdlog::warn("event=home_plan_refused reason=\"{}\"", homes.error().message);
  } else {
    homes_ = std::move(*homes);
  }
  homes_version_ = homes_announced_->version;
  homes_announced_.reset();
  server_.keep_holders([this](VoxelId voxel) { return is_own_home(voxel); });
  know_peers(now);
}

// Those of the plan, and the parent until the hot set is here.
void WorkerSession::know_peers(Time now) {
  peers_.clear();
  peer_by_session_.clear();
  std::set<WorkerId> present;
  const auto know = [&](const PeerAddress& peer) {
    if (peer.worker == kNoWorker || peer.worker == welcome_.worker || peer.endpoint.text.empty()) {
      return;
    }
    peers_[peer.worker] = peer;
    peer_by_session_[{peer.session.low, peer.session.high}] = peer.worker;
    present.insert(peer.worker);
  };
  for (const PeerAddress& peer : homes_.peers) { know(peer); }
  if (!hot_ready_) { know(welcome_.parent); }
  fetcher_.keep_peers(present, now);
  for (const auto& [peer, connected] : std::map(connected_)) {
    if (!peers_.contains(peer)) { disconnect_peer(peer); }
  }
}

bool WorkerSession::is_own_home(VoxelId voxel) const {
  const PeerAddress* const home = homes_.home_of(voxel);
  return home != nullptr && home->worker == welcome_.worker;
}

void WorkerSession::ask_peer(WorkerId id, const RangeRequest& range, Time now) {
  const auto peer = peers_.find(id);
  // Not to be reached any more: its silence sends the request elsewhere.
  if (peer == peers_.end()) { return; }
  if (!connected_.contains(id)) {
    if (connected_.size() == kPeersConnectedMax) {
      disconnect_peer(
          std::min_element(connected_.begin(), connected_.end(), [](const auto& a, const auto& b) {
            return a.second.asked_last < b.second.asked_last;
          })->first);
    }
    actions_.emplace_back(ConnectPeer{peer->second});
  }
  connected_[id] = {peer->second.session, now};
  outgoing_.push_back({ChannelKind::kPeer, peer->second.session, range, {}});
}

void WorkerSession::disconnect_peer(WorkerId peer) {
  const auto connected = connected_.find(peer);
  actions_.emplace_back(DisconnectPeer{connected->second.session});
  connected_.erase(connected);
}

void WorkerSession::disconnect_liars() {
  for (const auto& [peer, connected] : std::map(connected_)) {
    if (fetcher_.is_banned(peer)) {
      spdlog::warn("event=peer_distrusted worker={}", index_of(peer));
      disconnect_peer(peer);
    }
  }
}

void WorkerSession::on_peer_answer(const SessionId& from, const Envelope& frame,
                                   const Payload& data, Time now) {
  if (frame.job != job_ || phase_ == Phase::kOver) { return; }
  const auto peer = peer_by_session_.find({from.low, from.high});
  if (peer == peer_by_session_.end()) { return; }
  if (const auto* reply = std::get_if<RangeReply>(&frame.message)) {
    fetcher_.on_reply(peer->second, *reply, data.bytes, now);
  } else if (const auto* absent = std::get_if<VoxelAbsent>(&frame.message)) {
    const bool can_be_asked = peers_.contains(absent->holder);
    fetcher_.on_absent(peer->second, {BulkObject::kVoxel, absent->voxel},
                       can_be_asked ? absent->holder : kNoWorker, now);
  } else if (std::holds_alternative<VoxelLater>(frame.message)) {
    fetcher_.on_later(peer->second, now);
  } else {
    fetcher_.on_nonsense(peer->second, now);
  }
  take_fetched(now);
}

void WorkerSession::on_peer_nonsense(const SessionId& from, Time now) {
  const auto peer = peer_by_session_.find({from.low, from.high});
  if (peer != peer_by_session_.end()) { fetcher_.on_nonsense(peer->second, now); }
}

void WorkerSession::on_peer_request(const SessionId& from, const Envelope& frame, Time now) {
  const auto* const range = std::get_if<RangeRequest>(&frame.message);
  if (range == nullptr || phase_ == Phase::kOver) { return; }
  // Others may hear of a job, and of this worker, before it has heard itself.
  const bool job_known = job_ != JobKey{};
  if (job_known && frame.job != job_) { return; }
  if (!job_known || !hot_known_) {
    if (early_.size() < kEarlyRequestsMax) { early_.push_back({from, frame.job, *range}); }
    return;
  }
  answer_peer(from, *range, now);
}

PeerServer::Standing WorkerSession::standing(VoxelId voxel) const {
  if (hot_missing_[index_of(voxel)] ||
      fetcher_.is_coming_from_origin({BulkObject::kVoxel, voxel})) {
    return PeerServer::Standing::kComing;
  }
  if (!is_own_home(voxel)) { return PeerServer::Standing::kNone; }
  return hot_ready_ && homes_.is_kept(voxel) ? PeerServer::Standing::kHome
                                             : PeerServer::Standing::kHomeNoRoom;
}

void WorkerSession::answer_peer(const SessionId& from, const RangeRequest& range, Time now) {
  const VoxelId voxel = range.voxel;
  const bool exists = index_of(voxel) < voxels_.size();
  const auto asker = peer_by_session_.find({from.low, from.high});
  const bool fetch =
      server_.on_request(from, asker == peer_by_session_.end() ? kNoWorker : asker->second, range,
                         exists ? voxels_[index_of(voxel)].block_bytes : 0,
                         exists ? standing(voxel) : PeerServer::Standing::kNone, now);
  if (fetch) { want_voxel(voxel, {}); }
}

void WorkerSession::serve_peers(Time now) {
  server_.tick(now);
  if (early_.empty() || now - early_told_ < timers_.peer / 3) { return; }
  early_told_ = now;
  for (const EarlyRequest& early : early_) { server_.say_later(early.from); }
}

void WorkerSession::set_counts(const RendererCounts& counts) {
  counts_ = counts;
  WorkerStats& stats = counts_.stats;
  stats.cache.limit_bytes = welcome_.cache_limit_bytes;
  stats.cache.peak_bytes =
      std::max(preparing_bytes_peak_, stats.cache.peak_bytes + server_.shelf().bytes_peak());
  stats.cache.remote_fetches = remote_fetches_;
  stats.cache.remote_bytes = sources_.remote_peer_bytes + sources_.remote_origin_bytes;
  stats.sources = sources_;
  stats.sources.sent_peer_bytes = server_.bytes_sent();
  stats.sources.peer_timeouts = fetcher_.peer_timeouts();
  stats.sources.peer_lies = fetcher_.peer_lies();
}

}  // namespace preheat
