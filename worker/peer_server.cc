#include "worker/peer_server.h"

#include <algorithm>

namespace preheat {

bool PeerServer::on_request(const SessionId& from, WorkerId asker, const RangeRequest& request,
                            std::uint64_t block_bytes, Standing standing, Time now) {
  if (request.object != BulkObject::kVoxel || request.offset >= block_bytes ||
      request.bytes > block_bytes - request.offset) {
    ++refused_;
    return false;
  }
  const bool is_home = standing == Standing::kHome || standing == Standing::kHomeNoRoom;
  WorkerId holder = kNoWorker;
  if (is_home) {
    if (const auto known = holders_.find(request.voxel);
        known != holders_.end() && known->second != asker) {
      holder = known->second;
    }
    if (asker != kNoWorker) { holders_[request.voxel] = asker; }
  }
  if (const std::optional<Payload> block = shelf_.find(request.voxel)) {
    send_range(from, request, *block);
    return false;
  }
  // A voxel's first range decides where the asker goes for all of it.
  const bool is_coming = standing == Standing::kComing || waiting_.contains(request.voxel);
  const bool fetch =
      !is_coming && standing == Standing::kHome && holder == kNoWorker && request.offset == 0;
  if ((fetch || is_coming) && keep_waiting(from, request, now)) {
    answers_.push_back({from, VoxelLater{}, {}});
    return fetch;
  }
  answers_.push_back({from, VoxelAbsent{request.voxel, holder}, {}});
  return false;
}

void PeerServer::send_range(const SessionId& to, const RangeRequest& range, const Payload& block) {
  bytes_sent_ += range.bytes;
  answers_.push_back({to,
                      RangeReply{range.object, range.voxel, range.offset},
                      {block.bytes.subspan(range.offset, range.bytes), block.owner}});
}

bool PeerServer::keep_waiting(const SessionId& from, const RangeRequest& request, Time now) {
  const auto known = waiting_by_session_.find({from.low, from.high});
  const std::size_t of_session = known == waiting_by_session_.end() ? 0 : known->second;
  if (of_session >= kWaitingPerPeerMax || waiting_count_ >= kWaitingMax) {
    ++refused_;
    return false;
  }
  waiting_by_session_[{from.low, from.high}] = of_session + 1;
  ++waiting_count_;
  waiting_[request.voxel].push_back({from, request, now});
  return true;
}

void PeerServer::no_longer_waiting(const Waiting& waiting) {
  const auto of_session = waiting_by_session_.find({waiting.from.low, waiting.from.high});
  if (--of_session->second == 0) { waiting_by_session_.erase(of_session); }
  --waiting_count_;
}

void PeerServer::on_block(VoxelId voxel, const Payload& block) {
  const auto waiting = waiting_.find(voxel);
  if (waiting == waiting_.end()) { return; }
  for (const Waiting& one : waiting->second) {
    send_range(one.from, one.range, block);
    no_longer_waiting(one);
  }
  waiting_.erase(waiting);
}

void PeerServer::on_not_coming(VoxelId voxel) {
  const auto waiting = waiting_.find(voxel);
  if (waiting == waiting_.end()) { return; }
  for (const Waiting& one : waiting->second) {
    answers_.push_back({one.from, VoxelAbsent{voxel, kNoWorker}, {}});
    no_longer_waiting(one);
  }
  waiting_.erase(waiting);
}

WorkerId PeerServer::holder(VoxelId voxel) const {
  const auto known = holders_.find(voxel);
  return known == holders_.end() ? kNoWorker : known->second;
}

std::vector<VoxelId> PeerServer::waited_for() const {
  std::vector<VoxelId> voxels;
  for (const auto& [voxel, waiting] : waiting_) { voxels.push_back(voxel); }
  std::sort(voxels.begin(), voxels.end());
  return voxels;
}

void PeerServer::tick(Time now) {
  // Who waits so long has gone elsewhere.
  for (auto entry = waiting_.begin(); entry != waiting_.end();) {
    std::erase_if(entry->second, [&](const Waiting& one) {
      if (now - one.since < timers_.fetch) { return false; }
      no_longer_waiting(one);
      return true;
    });
    entry = entry->second.empty() ? waiting_.erase(entry) : std::next(entry);
  }
  // Three times within the asker's patience.
  if (waiting_by_session_.empty() || now - later_last_ < timers_.peer / 3) { return; }
  later_last_ = now;
  for (const auto& [session, count] : waiting_by_session_) {
    answers_.push_back({{session.first, session.second}, VoxelLater{}, {}});
  }
}

void PeerServer::keep_holders(const std::function<bool(VoxelId)>& is_home) {
  std::erase_if(holders_, [&is_home](const auto& entry) { return !is_home(entry.first); });
}

void PeerServer::reset() { *this = PeerServer(timers_); }

}  // namespace preheat
