#include "common/codec.h"

#include <xxhash.h>

#include <algorithm>
#include <cereal/archives/portable_binary.hpp>
#include <cereal/cereal.hpp>
#include <cmath>
#include <istream>
#include <new>
#include <ostream>
#include <streambuf>
#include <type_traits>
#include <utility>

#include "common/check.h"

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

// Reads a span in place; cereal then fails at its end instead of reading on.
class SpanReader : public std::streambuf {
 public:
  explicit SpanReader(std::span<const std::byte> bytes) {
    // The get area is never written through.
    char* begin = const_cast<char*>(reinterpret_cast<const char*>(bytes.data()));
    setg(begin, begin, begin + bytes.size());
  }
  [[nodiscard]] std::size_t bytes_left() const {
    return static_cast<std::size_t>(egptr() - gptr());
  }
};

class VectorWriter : public std::streambuf {
 public:
  explicit VectorWriter(std::vector<std::byte>& bytes) : bytes_(bytes) {}

 protected:
  std::streamsize xsputn(const char* from, std::streamsize count) override {
    const auto* begin = reinterpret_cast<const std::byte*>(from);
    bytes_.insert(bytes_.end(), begin, begin + count);
    return count;
  }
  int_type overflow(int_type value) override {
    bytes_.push_back(static_cast<std::byte>(value));
    return value;
  }

 private:
  std::vector<std::byte>& bytes_;
};

}  // namespace

// Found by cereal through argument-dependent lookup, hence in the types' own namespace.

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
void serialize(Archive& archive, WorkerStats& stats) {
  archive(stats.tiles, stats.rays, stats.cache, stats.preload);
}

template <class Archive>
void save(Archive& archive, const RenderSettings& settings) {
  const View& view = settings.view;
  for (const Vec3& v : {view.origin, view.forward, view.right, view.up, settings.sky}) {
    archive(v.x, v.y, v.z);
  }
  archive(static_cast<std::uint8_t>(view.orthographic), settings.width, settings.height,
          settings.spp, settings.bounces, settings.seed);
}

template <class Archive>
void load(Archive& archive, RenderSettings& settings) {
  View& view = settings.view;
  for (Vec3* v : {&view.origin, &view.forward, &view.right, &view.up, &settings.sky}) {
    archive(v->x, v->y, v->z);
  }
  std::uint8_t orthographic = 0;
  archive(orthographic, settings.width, settings.height, settings.spp, settings.bounces,
          settings.seed);
  if (orthographic > 1) { throw cereal::Exception("bool"); }
  view.orthographic = orthographic == 1;
}

template <class Archive, class T, std::size_t kCountMax>
void save(Archive& archive, const BoundedVector<T, kCountMax>& vector) {
  CHECK(vector.items.size() <= kCountMax);
  archive(static_cast<std::uint32_t>(vector.items.size()));
  for (const T& item : vector.items) { archive(item); }
}

template <class Archive, class T, std::size_t kCountMax>
void load(Archive& archive, BoundedVector<T, kCountMax>& vector) {
  static_assert(kCountMax * sizeof(T) <= kControlFrameBytesMax);
  std::uint32_t count = 0;
  archive(count);
  if (count > kCountMax) { throw cereal::Exception("count"); }
  vector.items.resize(count);
  for (T& item : vector.items) { archive(item); }
}

template <class Archive, std::size_t kBytesMax>
void save(Archive& archive, const BoundedString<kBytesMax>& string) {
  const std::size_t bytes = std::min(string.text.size(), kBytesMax);
  archive(static_cast<std::uint32_t>(bytes), cereal::binary_data(string.text.data(), bytes));
}

// Foreign text ends up in our log: only printable ASCII passes.
template <class Archive, std::size_t kBytesMax>
void load(Archive& archive, BoundedString<kBytesMax>& string) {
  std::uint32_t bytes = 0;
  archive(bytes);
  if (bytes > kBytesMax) { throw cereal::Exception("length"); }
  string.text.resize(bytes);
  archive(cereal::binary_data(string.text.data(), bytes));
  const auto printable = [](char c) { return c >= ' ' && c <= '~'; };
  if (!std::all_of(string.text.begin(), string.text.end(), printable)) {
    throw cereal::Exception("text");
  }
}

namespace {

bool in_range(double value, double low, double high) { return value >= low && value <= high; }

bool valid(const WorkerStats& stats) {
  return std::isfinite(stats.cache.stall_seconds) && std::isfinite(stats.preload.seconds);
}

bool valid(const RenderSettings& settings) {
  const View& view = settings.view;
  for (const Vec3& v : {view.origin, view.forward, view.right, view.up, settings.sky}) {
    if (!std::isfinite(v.x) || !std::isfinite(v.y) || !std::isfinite(v.z)) { return false; }
  }
  const std::uint64_t pixels = std::uint64_t{settings.width} * settings.height;
  return settings.width >= 1 && settings.width <= kImageSideMax && settings.height >= 1 &&
         settings.height <= kImageSideMax && pixels <= (std::uint64_t{1} << 31) &&
         settings.spp >= 1 && settings.spp <= kSamplesMax && settings.bounces <= kBouncesMax;
}

bool valid(const Hello& hello) {
  return hello.threads >= 1 && hello.threads <= kThreadsMax &&
         hello.cache_kind <= CacheRequestKind::kBytes && in_range(hello.cache_share, 0.0, 1.0);
}

bool valid(const Welcome& welcome) {
  if (!valid(welcome.settings) || welcome.tile_size < 1 || welcome.tile_size > kTileSizeMax) {
    return false;
  }
  const TileGrid grid{welcome.settings.width, welcome.settings.height, welcome.tile_size};
  return std::uint64_t{grid.columns()} * grid.rows() <= kTilesMax && welcome.bulk_port >= 1 &&
         welcome.bulk_port <= 65535 && welcome.count_accesses <= AccessCounting::kExact &&
         welcome.tables_bytes <= kTablesBytesMax && welcome.plan_bytes <= kVoxelsMax * 4 &&
         welcome.plan_bytes % 4 == 0;
}

bool valid(const Ready& ready) { return std::isfinite(ready.preload.seconds); }
bool valid(const WorkerHeartbeat& heartbeat) { return valid(heartbeat.stats); }
bool valid(const Goodbye& goodbye) { return valid(goodbye.stats); }

bool valid(const RangeRequest& request) {
  return request.object <= BulkObject::kVoxel && request.bytes >= 1 &&
         request.bytes <= kChunkBytesMax && request.offset <= kTablesBytesMax;
}

bool valid(const Fault& fault) { return fault.kind <= FaultKind::kVoxelDamaged; }
bool valid(const RangeReply& reply) { return reply.object <= BulkObject::kVoxel; }

bool valid(const TileChunk& chunk) {
  constexpr std::uint64_t kTileBytesMax = std::uint64_t{kTileSizeMax} * kTileSizeMax * 16;
  return chunk.total_bytes <= kTileBytesMax && chunk.offset <= chunk.total_bytes;
}

// Messages whose every bit pattern means something.
template <class T>
bool valid(const T&) {
  return true;
}

template <std::size_t kIndex>
bool decode_alternative(std::size_t type, cereal::PortableBinaryInputArchive& archive,
                        Message& message) {
  if (type != kIndex) { return false; }
  auto& body = message.emplace<kIndex>();
  archive(body);
  if (!valid(body)) { throw cereal::Exception("value"); }
  return true;
}

template <std::size_t... kIndices>
bool decode_any(std::size_t type, cereal::PortableBinaryInputArchive& archive, Message& message,
                std::index_sequence<kIndices...>) {
  return (decode_alternative<kIndices>(type, archive, message) || ...);
}

bool decode_body(std::size_t type, std::span<const std::byte> body, Message& message) {
  SpanReader reader{body};
  std::istream stream{&reader};
  try {
    cereal::PortableBinaryInputArchive archive{stream};
    return decode_any(type, archive, message,
                      std::make_index_sequence<std::variant_size_v<Message>>{}) &&
           reader.bytes_left() == 0;
  } catch (const cereal::Exception&) { return false; } catch (const std::bad_alloc&) {
    return false;
  }
}

}  // namespace

std::vector<std::byte> encode_frame(const JobKey& job, const Message& message) {
  std::vector<std::byte> frame(kFrameHeaderBytes);
  {
    VectorWriter writer{frame};
    std::ostream stream{&writer};
    cereal::PortableBinaryOutputArchive archive{stream};
    std::visit([&archive](const auto& body) { archive(body); }, message);
  }
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

Hash128 content_hash(std::span<const std::byte> bytes) {
  const XXH128_hash_t hash = XXH3_128bits(bytes.data(), bytes.size());
  return {hash.low64, hash.high64};
}

}  // namespace preheat
