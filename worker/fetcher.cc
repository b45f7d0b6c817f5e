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

void Fetcher::want(ObjectKey key, std::uint64_t bytes, const Hash128& hash) {
  CHECK(bytes > 0);
  const auto same = [&key](const Wanted& wanted) { return wanted.key == key; };
  // A renderer wants a voxel once, so this list is searched only where it is short; the thousands
  // of a preload come while nothing renders.
  const bool known =
      in_flight_.contains(key) || (waiting_.size() <= kObjectsInFlightMax &&
                                   std::any_of(waiting_.begin(), waiting_.end(), same));
  if (!known) { waiting_.push_back({key, bytes, hash, false}); }
}

void Fetcher::begin_waiting() {
  while (!waiting_.empty() && in_flight_.size() < kObjectsInFlightMax) {
    const Wanted& wanted = waiting_.front();
    if (!in_flight_.empty() && in_flight_bytes_ + wanted.bytes > kInFlightBytesMax) { return; }
    if (!in_flight_.contains(wanted.key)) {
      in_flight_bytes_ += wanted.bytes;
      order_.push_back(wanted.key);
      // operator new aligns to 16 bytes, as blocks must be.
      static_assert(__STDCPP_DEFAULT_NEW_ALIGNMENT__ >= 16);
      in_flight_[wanted.key] = {wanted, std::shared_ptr<std::byte[]>(new std::byte[wanted.bytes]),
                                0, 0};
    }
    waiting_.pop_front();
  }
}

void Fetcher::ask(const RangeRequest& range, Time now, std::vector<RangeRequest>& requests) {
  requests_[sequence_next_++] = {range, now};
  bytes_requested_ += range.bytes;
  requests.push_back(range);
}

void Fetcher::ask_again_for_lost(Time now, std::vector<RangeRequest>& requests) {
  if (requests_.empty()) { return; }
  std::vector<RangeRequest> again;
  const bool silent = now - std::max(reply_last_, requests_.begin()->second.sent) >= deadline_;
  if (silent) { deadline_ = std::min(deadline_ * 2, deadline_max_); }
  for (auto request = requests_.begin(); request != requests_.end();) {
    const bool overtaken = request->first + kOvertakenMax < sequence_answered_;
    if (!silent && !overtaken) {
      ++request;
      continue;
    }
    again.push_back(request->second.range);
    bytes_requested_ -= request->second.range.bytes;
    request = requests_.erase(request);
  }
  retries_ += again.size();
  for (const RangeRequest& range : again) { ask(range, now, requests); }
}

std::vector<RangeRequest> Fetcher::take_requests(Time now) {
  std::vector<RangeRequest> requests;
  ask_again_for_lost(now, requests);
  begin_waiting();
  for (const ObjectKey& key : order_) {
    InFlight& object = in_flight_.at(key);
    while (object.next < object.wanted.bytes) {
      const std::uint32_t bytes = range_bytes(object.next, object.wanted.bytes);
      if (bytes_requested_ + bytes > kWindowBytes) { return requests; }
      ask({key.object, key.voxel, object.next, bytes}, now, requests);
      object.next += bytes;
    }
  }
  return requests;
}

void Fetcher::on_reply(const RangeReply& reply, std::span<const std::byte> data, Time now) {
  const auto matches = [&](const auto& entry) {
    const RangeRequest& range = entry.second.range;
    return range.object == reply.object && range.voxel == reply.voxel &&
           range.offset == reply.offset && range.bytes == data.size();
  };
  const auto request = std::find_if(requests_.begin(), requests_.end(), matches);
  if (request == requests_.end()) {
    ++replies_dropped_;
    return;
  }
  reply_last_ = now;
  deadline_ = deadline_first_;
  sequence_answered_ = std::max(sequence_answered_, request->first);
  bytes_requested_ -= request->second.range.bytes;
  requests_.erase(request);
  const auto object = in_flight_.find({reply.object, reply.voxel});
  CHECK(object != in_flight_.end());
  std::memcpy(object->second.bytes.get() + reply.offset, data.data(), data.size());
  object->second.received += data.size();
  if (object->second.received == object->second.wanted.bytes) { complete(object); }
}

void Fetcher::complete(std::map<ObjectKey, InFlight>::iterator object) {
  const InFlight whole = std::move(object->second);
  const ObjectKey key = object->first;
  in_flight_.erase(object);
  std::erase(order_, key);
  in_flight_bytes_ -= whole.wanted.bytes;
  const std::span<const std::byte> bytes{whole.bytes.get(), whole.wanted.bytes};
  if (content_hash(bytes) == whole.wanted.hash) {
    done_.push_back({key, bytes, whole.bytes});
    return;
  }
  ++hash_mismatches_;
  if (whole.wanted.failed_once) {
    damaged_.push_back(key);
    return;
  }
  waiting_.push_front(whole.wanted);
  waiting_.front().failed_once = true;
}

std::vector<FetchedObject> Fetcher::take_done() { return std::exchange(done_, {}); }
std::vector<ObjectKey> Fetcher::take_damaged() { return std::exchange(damaged_, {}); }

void Fetcher::reset() { *this = Fetcher(deadline_first_, deadline_max_); }

}  // namespace preheat
