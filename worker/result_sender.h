// Finished tiles on their way to the master: chunks under a credit window, kept until the master
// has said that it has the tile or does not want it.
//
// Pure: time is an argument, chunks are taken and sent by the owner.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <utility>
#include <vector>

#include "common/clock.h"
#include "common/film.h"
#include "common/messages.h"
#include "common/transport.h"

namespace preheat {

class ResultSender {
 public:
  static constexpr std::size_t kChunksInFlightMax = 8;

  ResultSender(Duration deadline, Duration deadline_max)
      : deadline_first_(deadline), deadline_max_(deadline_max), deadline_(deadline) {}

  void add(const Lease& lease, const TilePixels& pixels);
  void on_chunk_ack(const TileChunkAck& ack, Time now);
  void on_result_ack(LeaseId lease, Time now);

  // Chunks to send now, among them those whose acknowledgement did not come.
  [[nodiscard]] std::vector<std::pair<TileChunk, Payload>> take_chunks(Time now);

  // The master has forgotten what it had: everything again.
  void restart();
  void reset() { *this = ResultSender(deadline_first_, deadline_max_); }

  // Leases whose results wait for their acknowledgement.
  [[nodiscard]] std::vector<Lease> leases() const;
  [[nodiscard]] bool idle() const { return results_.empty(); }

 private:
  enum class ChunkState : std::uint8_t { kUnsent, kInFlight, kArrived };
  struct Outbound {
    Lease lease{};
    std::shared_ptr<const std::vector<std::byte>> bytes{};
    Hash128 hash{};
    std::vector<ChunkState> chunks{};
  };

  Duration deadline_first_;
  Duration deadline_max_;
  Duration deadline_;
  Time last_news_{};
  std::size_t in_flight_ = 0;
  std::deque<Outbound> results_;
};

}  // namespace preheat
