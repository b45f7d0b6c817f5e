#include "worker/fetcher.h"

#include <algorithm>
#include <cstring>
#include <utility>

#include "common/check.h"
#include "common/content_hash.h"

namespace preheat {
namespace {

constexpr std::uint64_t kOvertakenMax = 8;

std::uint32_t range_bytes(std::uint64_t offset, std::uint64_t object_bytes) {
  return static_cast<std::uint32_t>(std::min<std::uint64_t>(kChunkBytesMax, object_bytes - offset));
}

}  // namespace

void Fetcher::want(ObjectKey key, std::uint64_t bytes, const Hash128& hash,
                   std::vector<WorkerId> peers) {
  CHECK(bytes > 0);
  if (!known_.insert(key).second) { return; }
  while (peers.size() > kPeersPerObjectMax) { peers.pop_back(); }
  waiting_.push_back({key, bytes, hash, std::move(peers), 0, false});
}

void Fetcher::forget(ObjectKey key) {
  if (known_.erase(key) == 0) { return; }
  std::erase_if(waiting_, [key](const Wanted& wanted) { return wanted.key == key; });
  if (const auto object = in_flight_.find(key); object != in_flight_.end()) { remove(object); }
}

void Fetcher::remove(std::map<ObjectKey, InFlight>::iterator object) {
  erase_requests(object->first);
  std::erase(order_, object->first);
  in_flight_bytes_ -= object->second.wanted.bytes;
  in_flight_.erase(object);
}

std::map<std::uint64_t, Fetcher::Request>::iterator Fetcher::erase_request(
    std::map<std::uint64_t, Request>::iterator request) {
  bytes_requested_[request->second.source] -= request->second.range.bytes;
  return requests_.erase(request);
}

void Fetcher::erase_requests(ObjectKey key) {
  for (auto request = requests_.begin(); request != requests_.end();) {
    const RangeRequest& range = request->second.range;
    const bool is_of_key = range.object == key.object && range.voxel == key.voxel;
    request = is_of_key ? erase_request(request) : std::next(request);
  }
}

bool Fetcher::may_ask(WorkerId peer, Time now) const {
  const auto known = peers_.find(peer);
  return known == peers_.end() || (!known->second.banned && now >= known->second.paused_until);
}

bool Fetcher::is_banned(WorkerId peer) const {
  const auto known = peers_.find(peer);
  return known != peers_.end() && known->second.banned;
}

bool Fetcher::is_coming_from_origin(ObjectKey key) const {
  const auto object = in_flight_.find(key);
  return object != in_flight_.end() && object->second.source == kOrigin;
}

void Fetcher::choose_source(InFlight& object, Time now) {
  Wanted& wanted = object.wanted;
  object.source = kOrigin;
  while (wanted.peers_tried < wanted.peers.size() && object.source == kOrigin) {
    const WorkerId peer = wanted.peers[wanted.peers_tried++];
    if (peer != kOrigin && may_ask(peer, now)) { object.source = peer; }
  }
}

void Fetcher::move_on(InFlight& object, Time now) {
  erase_requests(object.wanted.key);
  object.next = 0;
  object.received = 0;
  choose_source(object, now);
}

void Fetcher::begin_waiting(Time now) {
  while (!waiting_.empty() && in_flight_.size() < kObjectsInFlightMax) {
    Wanted& wanted = waiting_.front();
    if (!in_flight_.empty() && in_flight_bytes_ + wanted.bytes > kInFlightBytesMax) { return; }
    in_flight_bytes_ += wanted.bytes;
    order_.push_back(wanted.key);
    // operator new aligns to 16 bytes, as blocks must be.
    static_assert(__STDCPP_DEFAULT_NEW_ALIGNMENT__ >= 16);
    InFlight& object = in_flight_[wanted.key];
    object.bytes = std::shared_ptr<std::byte[]>(new std::byte[wanted.bytes]);
    object.wanted = std::move(wanted);
    choose_source(object, now);
    waiting_.pop_front();
  }
}

void Fetcher::ask(WorkerId source, const RangeRequest& range, Time now,
                  std::vector<SourcedRequest>& requests) {
  requests_[sequence_next_++] = {source, range, now};
  bytes_requested_[source] += range.bytes;
  requests.push_back({source, range});
}

void Fetcher::ask_origin_again(Time now, std::vector<SourcedRequest>& requests) {
  const auto oldest = std::find_if(requests_.begin(), requests_.end(), [](const auto& entry) {
    return entry.second.source == kOrigin;
  });
  if (oldest == requests_.end()) { return; }
  std::vector<RangeRequest> again;
  const bool silent = now - std::max(reply_last_, oldest->second.sent) >= deadline_;
  if (silent) { deadline_ = std::min(deadline_ * 2, timers_.fetch_max); }
  for (auto request = oldest; request != requests_.end();) {
    const bool overtaken = request->first + kOvertakenMax < sequence_answered_;
    if (request->second.source != kOrigin || (!silent && !overtaken)) {
      ++request;
      continue;
    }
    again.push_back(request->second.range);
    request = erase_request(request);
  }
  retries_ += again.size();
  for (const RangeRequest& range : again) { ask(kOrigin, range, now, requests); }
}

void Fetcher::fail_late_peers(Time now) {
  std::set<WorkerId> failed;
  for (const auto& [sequence, request] : requests_) {
    if (request.source == kOrigin) { continue; }
    const Peer& peer = peers_.at(request.source);
    const bool silent = now - std::max(peer.heard, request.sent) >= peer.deadline;
    if (silent || now - request.sent >= timers_.fetch) { failed.insert(request.source); }
  }
  for (const WorkerId peer : failed) { fail(peer, Failure::kSlow, now); }
}

void Fetcher::fail(WorkerId id, Failure failure, Time now) {
  Peer& peer = heard_from(id, now);
  if (failure == Failure::kLie) {
    peer_lies_ += peer.banned ? 0 : 1;
    peer.banned = true;
  } else if (failure == Failure::kSlow) {
    ++peer_timeouts_;
    peer.paused_until = now + peer.pause;
    peer.pause = std::min(peer.pause * 2, timers_.peer_max);
    // It may be far away rather than dead.
    peer.deadline = std::min(peer.deadline * 2, timers_.fetch);
  }
  for (auto& [key, object] : in_flight_) {
    if (object.source == id) { move_on(object, now); }
  }
  if (failure != Failure::kGone) { return; }
  if (!peer.banned) { peers_.erase(id); }
  bytes_requested_.erase(id);
}

Fetcher::Peer& Fetcher::heard_from(WorkerId id, Time now) {
  const auto [peer, is_new] = peers_.try_emplace(id);
  if (is_new) {
    peer->second.deadline = timers_.peer;
    peer->second.pause = 2 * timers_.peer;
  }
  peer->second.heard = now;
  return peer->second;
}

std::vector<SourcedRequest> Fetcher::take_requests(Time now) {
  std::vector<SourcedRequest> requests;
  fail_late_peers(now);
  ask_origin_again(now, requests);
  begin_waiting(now);
  for (const ObjectKey& key : order_) {
    InFlight& object = in_flight_.at(key);
    while (object.next < object.wanted.bytes) {
      const std::uint32_t bytes = range_bytes(object.next, object.wanted.bytes);
      if (bytes_requested_[object.source] + bytes > kWindowBytes) { break; }
      if (object.source != kOrigin && !peers_.contains(object.source)) {
        heard_from(object.source, now);
      }
      ask(object.source, {key.object, key.voxel, object.next, bytes}, now, requests);
      object.next += bytes;
    }
  }
  return requests;
}

void Fetcher::drop_reply(WorkerId source, Time now) {
  ++replies_dropped_;
  const auto peer = peers_.find(source);
  if (source == kOrigin || peer == peers_.end()) { return; }
  if (++peer->second.unasked > kUnaskedMax) { fail(source, Failure::kLie, now); }
}

void Fetcher::on_reply(WorkerId source, const RangeReply& reply, std::span<const std::byte> data,
                       Time now) {
  const auto matches = [&](const auto& entry) {
    const RangeRequest& range = entry.second.range;
    return entry.second.source == source && range.object == reply.object &&
           range.voxel == reply.voxel && range.offset == reply.offset && range.bytes == data.size();
  };
  const auto request = std::find_if(requests_.begin(), requests_.end(), matches);
  if (request == requests_.end()) {
    drop_reply(source, now);
    return;
  }
  if (source == kOrigin) {
    reply_last_ = now;
    deadline_ = timers_.fetch;
    sequence_answered_ = std::max(sequence_answered_, request->first);
  } else {
    Peer& peer = heard_from(source, now);
    peer.unasked = 0;
    // A peer may be far away, or behind a slow link.
    peer.deadline = std::clamp(4 * (now - request->second.sent), timers_.peer, timers_.fetch);
  }
  erase_request(request);
  const auto object = in_flight_.find({reply.object, reply.voxel});
  CHECK(object != in_flight_.end());
  std::memcpy(object->second.bytes.get() + reply.offset, data.data(), data.size());
  object->second.received += data.size();
  if (object->second.received == object->second.wanted.bytes) { complete(object, now); }
}

void Fetcher::on_absent(WorkerId peer, ObjectKey key, WorkerId holder, Time now) {
  const auto object = in_flight_.find(key);
  if (object == in_flight_.end() || object->second.source != peer || peer == kOrigin) {
    drop_reply(peer, now);
    return;
  }
  // Of the ranges of one object each is answered so, and only the first answer still counts.
  heard_from(peer, now).unasked = 0;
  Wanted& wanted = object->second.wanted;
  // One hint is followed; a chain of hints might be a circle.
  if (holder != kNoWorker && wanted.peers_tried == 1 && holder != peer) {
    wanted.peers = {peer, holder};
  }
  move_on(object->second, now);
}

void Fetcher::on_later(WorkerId peer, Time now) {
  if (peers_.contains(peer)) { heard_from(peer, now); }
}

void Fetcher::on_nonsense(WorkerId peer, Time now) { fail(peer, Failure::kLie, now); }

void Fetcher::keep_peers(const std::set<WorkerId>& present, Time now) {
  std::set<WorkerId> gone;
  for (const auto& [id, peer] : peers_) {
    if (!present.contains(id)) { gone.insert(id); }
  }
  for (const auto& [key, object] : in_flight_) {
    if (object.source != kOrigin && !present.contains(object.source)) {
      gone.insert(object.source);
    }
  }
  for (const WorkerId id : gone) { fail(id, Failure::kGone, now); }
}

void Fetcher::complete(std::map<ObjectKey, InFlight>::iterator object, Time now) {
  const ObjectKey key = object->first;
  const WorkerId source = object->second.source;
  const std::span<const std::byte> bytes{object->second.bytes.get(), object->second.wanted.bytes};
  if (content_hash(bytes) == object->second.wanted.hash) {
    done_.push_back({key, bytes, object->second.bytes, source});
    known_.erase(key);
    remove(object);
    return;
  }
  ++hash_mismatches_;
  if (source != kOrigin) {
    fail(source, Failure::kLie, now);  // moves this object on with the peer's others
    return;
  }
  Wanted wanted = object->second.wanted;
  remove(object);
  if (wanted.failed_once) {
    damaged_.push_back(key);
    known_.erase(key);
  } else {
    wanted.failed_once = true;
    waiting_.push_front(std::move(wanted));
  }
}

std::vector<FetchedObject> Fetcher::take_done() { return std::exchange(done_, {}); }
std::vector<ObjectKey> Fetcher::take_damaged() { return std::exchange(damaged_, {}); }

std::uint64_t Fetcher::bytes_requested(WorkerId source) const {
  const auto bytes = bytes_requested_.find(source);
  return bytes == bytes_requested_.end() ? 0 : bytes->second;
}

std::uint64_t Fetcher::bytes_requested() const {
  std::uint64_t sum = 0;
  for (const auto& [source, bytes] : bytes_requested_) { sum += bytes; }
  return sum;
}

}  // namespace preheat
