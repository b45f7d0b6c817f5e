#include "worker/result_sender.h"

#include <algorithm>
#include <span>

#include "common/content_hash.h"
#include "common/tile_codec.h"

namespace preheat {

void ResultSender::add(const Lease& lease, const TilePixels& pixels) {
  Outbound result;
  result.lease = lease;
  result.bytes = std::make_shared<const std::vector<std::byte>>(encode_tile(pixels));
  result.hash = content_hash(*result.bytes);
  result.chunks.resize((result.bytes->size() + kChunkBytesMax - 1) / kChunkBytesMax);
  results_.push_back(std::move(result));
}

void ResultSender::on_chunk_ack(const TileChunkAck& ack, Time now) {
  last_news_ = now;
  deadline_ = deadline_first_;
  for (Outbound& result : results_) {
    const std::size_t chunk = ack.offset / kChunkBytesMax;
    if (result.lease.id != ack.lease || chunk >= result.chunks.size()) { continue; }
    if (result.chunks[chunk] == ChunkState::kInFlight) { --in_flight_; }
    result.chunks[chunk] = ChunkState::kArrived;
  }
}

void ResultSender::on_result_ack(LeaseId lease, Time now) {
  last_news_ = now;
  deadline_ = deadline_first_;
  std::erase_if(results_, [&](const Outbound& result) {
    if (result.lease.id != lease) { return false; }
    in_flight_ -= static_cast<std::size_t>(
        std::count(result.chunks.begin(), result.chunks.end(), ChunkState::kInFlight));
    return true;
  });
}

void ResultSender::restart() {
  in_flight_ = 0;
  for (Outbound& result : results_) {
    std::fill(result.chunks.begin(), result.chunks.end(), ChunkState::kUnsent);
  }
}

std::vector<std::pair<TileChunk, Payload>> ResultSender::take_chunks(Time now) {
  std::vector<std::pair<TileChunk, Payload>> sent;
  if (results_.empty()) { return sent; }
  const auto unsent = [](const Outbound& result) {
    return std::find(result.chunks.begin(), result.chunks.end(), ChunkState::kUnsent) !=
           result.chunks.end();
  };
  const bool anything_unsent = std::any_of(results_.begin(), results_.end(), unsent);
  const bool waiting = in_flight_ > 0 || !anything_unsent;
  if (waiting && now - last_news_ >= deadline_) {
    deadline_ = std::min(deadline_ * 2, deadline_max_);
    restart();
  }
  for (Outbound& result : results_) {
    for (std::size_t chunk = 0; chunk < result.chunks.size(); ++chunk) {
      if (in_flight_ == kChunksInFlightMax) { return sent; }
      if (result.chunks[chunk] != ChunkState::kUnsent) { continue; }
      // Whoever begins to wait begins to count.
      if (in_flight_ == 0) { last_news_ = now; }
      result.chunks[chunk] = ChunkState::kInFlight;
      ++in_flight_;
      const std::uint64_t offset = chunk * kChunkBytesMax;
      const std::uint64_t total = result.bytes->size();
      const std::uint64_t bytes = std::min<std::uint64_t>(kChunkBytesMax, total - offset);
      sent.emplace_back(TileChunk{result.lease.id, result.lease.tile, offset, total, result.hash},
                        Payload{std::span(*result.bytes).subspan(offset, bytes), result.bytes});
    }
  }
  return sent;
}

std::vector<Lease> ResultSender::leases() const {
  std::vector<Lease> leases;
  for (const Outbound& result : results_) { leases.push_back(result.lease); }
  return leases;
}

}  // namespace preheat
