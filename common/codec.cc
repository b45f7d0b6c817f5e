#include "common/codec.h"

#include <xxhash.h>

#include <algorithm>
#include <array>
#include <limits>
#include <new>
#include <utility>

#include "common/bounded.h"
#include "common/check.h"
#include "common/home_plan.h"
#include "common/peer_address_codec.h"

namespace preheat {
namespace {

constexpr std::uint32_t kMagic = 0x54484850;  // "PHHT"
constexpr std::size_t kChecksumOffset = 32;
constexpr std::size_t kBodyBytesMax = kControlFrameBytesMax - kFrameHeaderBytes;

template <class Integer>
void put(std::byte* to, Integer value) {
  for (std::size_t i = 0; i < sizeof(Integer); ++i) {
    to[i] = static_cast<std::byte>((value >> (8 * i)) & 0xFFU);
  }
}

template <class Integer>
Integer get(const std::byte* from) {
  std::uint64_t value = 0;
  for (std::size_t i = 0; i < sizeof(Integer); ++i) {
    value |= std::to_integer<std::uint64_t>(from[i]) << (8 * i);
  }
  return static_cast<Integer>(value);
}

std::uint64_t checksum(const std::byte* header, std::span<const std::byte> body) {
  const XXH64_hash_t of_header = XXH3_64bits(header, kChecksumOffset);
  return XXH3_64bits_withSeed(body.data(), body.size(), of_header);
}

}  // namespace

// Found by cereal through argument-dependent lookup, hence in the types' own namespace.

// Any value of an id's type may be an id; who uses it knows how many there are.
template <class Id>
EnumUpTo<Id> id(Id& value) {
  return enum_up_to(value, static_cast<Id>(std::numeric_limits<std::underlying_type_t<Id>>::max()));
}

template <class Archive>
void serialize(Archive& archive, RayStats& rays) {
  archive(rays.camera, rays.scatter, rays.shadow, rays.samples_invalid);
}

template <class Archive>
void serialize(Archive& archive, CacheStats& cache) {
  archive(cache.limit_bytes, cache.peak_bytes, cache.build_peak_bytes, cache.accesses, cache.misses,
          cache.remote_fetches, cache.remote_bytes, cache.rebuilds, cache.evictions,
          cache.stall_seconds);
}

template <class Archive>
void serialize(Archive& archive, PreloadStats& preload) {
  archive(preload.voxels, preload.bytes, preload.seconds);
}

template <class Archive>
void serialize(Archive& archive, SourceStats& sources) {
  archive(sources.preload_peer_bytes, sources.preload_origin_bytes, sources.remote_peer_fetches,
          sources.remote_peer_bytes, sources.remote_origin_bytes, sources.home_bytes,
          sources.sent_peer_bytes, sources.home_hits, sources.peer_timeouts, sources.peer_lies);
}

template <class Archive>
void serialize(Archive& archive, WorkerStats& stats) {
  archive(stats.tiles, stats.rays, stats.cache, stats.preload, stats.sources);
}

template <class Archive>
void serialize(Archive& archive, RenderSettings& settings) {
  View& view = settings.view;
  archive(view.origin, view.forward, view.right, view.up, view.orthographic, settings.sky,
          settings.width, settings.height, settings.spp, settings.bounces, settings.seed);
}

template <class Archive, class T, std::size_t kCountMax>
void serialize(Archive& archive, BoundedVector<T, kCountMax>& vector) {
  static_assert(kCountMax * sizeof(T) <= kControlFrameBytesMax);
  archive(at_most(vector.items, kCountMax));
}

template <class Archive, std::size_t kBytesMax>
void serialize(Archive& archive, BoundedString<kBytesMax>& string) {
  archive(at_most(string.text, kBytesMax));
}

template <class Archive>
void serialize(Archive& archive, Hello& hello) {
  archive(hello.session, hello.build, hello.isa, hello.self_test, hello.threads,
          enum_up_to(hello.cache_kind, CacheRequestKind::kBytes), hello.cache_share,
          hello.cache_bytes, hello.process_id, hello.peer_endpoint);
}

template <class Archive>
void serialize(Archive& archive, Welcome& welcome) {
  archive(id(welcome.worker), welcome.bulk_port, welcome.settings, welcome.tile_size,
          enum_up_to(welcome.count_accesses, AccessCounting::kExact), welcome.paths_per_thread,
          welcome.cache_limit_bytes, welcome.tables_bytes, welcome.tables_hash, welcome.plan_bytes,
          welcome.plan_hash, welcome.home_bytes, welcome.parent);
}

template <class Archive>
void serialize(Archive& archive, Refuse& refuse) {
  archive(refuse.exit_code, refuse.text);
}

template <class Archive>
void serialize(Archive& archive, Ready& ready) {
  archive(ready.preload);
}

template <class Archive>
void serialize(Archive& archive, Lease& lease) {
  archive(id(lease.id), id(lease.tile));
}

template <class Archive>
void serialize(Archive& archive, Grant& grant) {
  archive(grant.leases);
}

template <class Archive>
void serialize(Archive& archive, Cancel& cancel) {
  archive(cancel.leases);
}

template <class Archive>
void serialize(Archive& archive, ResultAck& ack) {
  archive(id(ack.lease));
}

template <class Archive>
void serialize(Archive& archive, WorkerHeartbeat& heartbeat) {
  archive(heartbeat.progress, heartbeat.stats, heartbeat.held, heartbeat.homes_version);
}

template <class Archive>
void serialize(Archive& archive, MasterHeartbeat& heartbeat) {
  archive(heartbeat.tiles_done, heartbeat.tiles_total);
}

template <class Archive>
void serialize(Archive& archive, Fault& fault) {
  archive(enum_up_to(fault.kind, FaultKind::kVoxelDamaged), id(fault.voxel), fault.text);
}

template <class Archive>
void serialize(Archive& archive, Goodbye& goodbye) {
  archive(goodbye.stats);
}

template <class Archive>
void serialize(Archive& archive, RangeRequest& request) {
  archive(enum_up_to(request.object, BulkObject::kHomes), id(request.voxel), request.offset,
          request.bytes);
}

template <class Archive>
void serialize(Archive& archive, RangeReply& reply) {
  archive(enum_up_to(reply.object, BulkObject::kHomes), id(reply.voxel), reply.offset);
}

template <class Archive>
void serialize(Archive& archive, TileChunk& chunk) {
  archive(id(chunk.lease), id(chunk.tile), chunk.offset, chunk.total_bytes, chunk.hash);
}

template <class Archive>
void serialize(Archive& archive, TileChunkAck& ack) {
  archive(id(ack.lease), ack.offset);
}

template <class Archive>
void serialize(Archive& archive, VoxelAccesses& told) {
  archive(told.first, told.counts);
}

template <class Archive>
void serialize(Archive& archive, Status& status) {
  archive(status.build, enum_up_to(status.phase, JobPhase::kOver), status.tiles_done,
          status.tiles_total, status.workers, status.workers_ready, status.workers_lost,
          status.leases_expired, status.rays, status.accesses, status.misses,
          status.waiting_seconds, status.rendering_seconds);
}

template <class Archive>
void serialize(Archive& archive, PeersChanged& changed) {
  archive(changed.version, changed.bytes, changed.hash);
}

template <class Archive>
void serialize(Archive& archive, VoxelAbsent& absent) {
  archive(id(absent.voxel), id(absent.holder));
}

namespace {

bool valid(const RenderSettings& settings) {
  const std::uint64_t pixels = std::uint64_t{settings.width} * settings.height;
  return settings.width >= 1 && settings.width <= kImageSideMax && settings.height >= 1 &&
         settings.height <= kImageSideMax && pixels <= kImagePixelsMax && settings.spp >= 1 &&
         settings.spp <= kSppMax && settings.bounces <= kBouncesMax;
}

// Foreign text ends up in our log: only printable ASCII passes.
bool printable(const std::string& text) {
  return std::all_of(text.begin(), text.end(), [](char c) { return c >= ' ' && c <= '~'; });
}

bool valid(const Hello& hello) {
  return hello.threads >= 1 && hello.threads <= kThreadsMax && hello.cache_share >= 0.0 &&
         hello.cache_share <= 1.0 && printable(hello.build.text) && printable(hello.isa.text) &&
         printable(hello.peer_endpoint.text);
}

bool valid(const Welcome& welcome) {
  if (!valid(welcome.settings) || welcome.tile_size < 1 || welcome.tile_size > kTileSizeMax) {
    return false;
  }
  const TileGrid grid{welcome.settings.width, welcome.settings.height, welcome.tile_size};
  return std::uint64_t{grid.columns()} * grid.rows() <= kTilesMax && welcome.bulk_port >= 1 &&
         welcome.bulk_port <= 65535 && welcome.tables_bytes <= kTablesBytesMax &&
         welcome.paths_per_thread >= kPathsPerThreadMin &&
         welcome.paths_per_thread <= kPathsPerThreadMax &&
         welcome.plan_bytes <= (kVoxelCountMax + 1) * 4 && welcome.plan_bytes % 4 == 0 &&
         welcome.home_bytes <= welcome.cache_limit_bytes && printable(welcome.parent.endpoint.text);
}

bool valid(const Refuse& refuse) { return printable(refuse.text.text); }

bool valid(const RangeRequest& request) {
  return request.bytes >= 1 && request.bytes <= kChunkBytesMax && request.offset <= kTablesBytesMax;
}

bool valid(const PeersChanged& changed) {
  return changed.version >= 1 && changed.bytes >= 1 && changed.bytes <= kHomePlanBytesMax;
}

bool valid(const Fault& fault) { return printable(fault.text.text); }

bool valid(const TileChunk& chunk) {
  constexpr std::uint64_t kTileBytesMax = std::uint64_t{kTileSizeMax} * kTileSizeMax * 16;
  return chunk.total_bytes <= kTileBytesMax && chunk.offset <= chunk.total_bytes;
}

bool valid(const Status& status) {
  return printable(status.build.text) && status.tiles_done <= status.tiles_total;
}

// Messages whose every bit pattern means something.
template <class T>
bool valid(const T&) {
  return true;
}

template <std::size_t kIndex>
bool decode_alternative(std::size_t type, BoundedInput& archive, Message& message) {
  if (type != kIndex) { return false; }
  auto& body = message.emplace<kIndex>();
  archive(body);
  if (!valid(body)) { throw cereal::Exception("value"); }
  return true;
}

template <std::size_t... kIndices>
bool decode_any(std::size_t type, BoundedInput& archive, Message& message,
                std::index_sequence<kIndices...>) {
  return (decode_alternative<kIndices>(type, archive, message) || ...);
}

bool decode_body(std::size_t type, std::span<const std::byte> body, Message& message) {
  try {
    BoundedInput archive{body};
    return decode_any(type, archive, message,
                      std::make_index_sequence<std::variant_size_v<Message>>{}) &&
           archive.remaining() == 0;
  } catch (const cereal::Exception&) { return false; } catch (const std::bad_alloc&) {
    return false;
  }
}

}  // namespace

std::vector<std::byte> encode_frame(const JobKey& job, const Message& message) {
  BoundedOutput archive;
  archive.write(std::array<std::byte, kFrameHeaderBytes>{}.data(), kFrameHeaderBytes);
  std::visit([&archive](const auto& body) { archive(body); }, message);
  std::vector<std::byte> frame = archive.take();
  const std::span<const std::byte> body = std::span(frame).subspan(kFrameHeaderBytes);
  CHECK(body.size() <= kBodyBytesMax);
  std::byte* header = frame.data();
  put<std::uint32_t>(header, kMagic);
  put<std::uint16_t>(header + 4, kProtocolVersion);
  put<std::uint16_t>(header + 6, static_cast<std::uint16_t>(message.index()));
  put<std::uint64_t>(header + 8, job.job);
  put<std::uint64_t>(header + 16, job.epoch);
  put<std::uint32_t>(header + 24, static_cast<std::uint32_t>(body.size()));
  put<std::uint32_t>(header + 28, 0);
  put<std::uint64_t>(header + kChecksumOffset, checksum(header, body));
  return frame;
}

tl::expected<Envelope, FrameError> decode_frame(std::span<const std::byte> bytes) {
  const auto error = [](FrameFault fault, std::uint16_t version = 0) {
    return tl::unexpected<FrameError>(FrameError{fault, version});
  };
  if (bytes.size() < kFrameHeaderBytes) { return error(FrameFault::kNotOurs); }
  const std::byte* header = bytes.data();
  if (get<std::uint32_t>(header) != kMagic) { return error(FrameFault::kNotOurs); }
  const auto version = get<std::uint16_t>(header + 4);
  if (version != kProtocolVersion) { return error(FrameFault::kVersion, version); }
  const std::span<const std::byte> body = bytes.subspan(kFrameHeaderBytes);
  if (body.size() > kBodyBytesMax || get<std::uint32_t>(header + 24) != body.size() ||
      get<std::uint32_t>(header + 28) != 0 ||
      get<std::uint64_t>(header + kChecksumOffset) != checksum(header, body)) {
    return error(FrameFault::kDamaged);
  }
  Envelope frame;
  frame.job = {get<std::uint64_t>(header + 8), get<std::uint64_t>(header + 16)};
  if (!decode_body(get<std::uint16_t>(header + 6), body, frame.message)) {
    return error(FrameFault::kMalformed);
  }
  return frame;
}

}  // namespace preheat
