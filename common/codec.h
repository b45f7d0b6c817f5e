// A message <-> one checked frame. The only place of the wire that knows cereal.
//
// Frame: a header of 40 bytes, little-endian, laid out by hand and the same for ever:
//   magic u32, protocol version u16, type u16, job u64, epoch u64, body bytes u32, zero u32,
//   XXH3-64 of the first 32 bytes and the body u64
// then the body. Decoding checks all of it before cereal sees a byte, reads containers only up to
// the bound in their type, wants every byte used, and then every value in its range.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <tl/expected.hpp>
#include <vector>

#include "common/messages.h"

namespace preheat {

inline constexpr std::size_t kFrameHeaderBytes = 40;

// Which job of which master run a frame belongs to. Zero before a Welcome.
struct JobKey {
  std::uint64_t job = 0;
  std::uint64_t epoch = 0;
  friend bool operator==(const JobKey&, const JobKey&) = default;
};

struct Envelope {
  JobKey job{};
  Message message{};
};

enum class FrameFault : std::uint8_t {
  kNotOurs,   // too short, or another magic
  kVersion,   // ours, but of another protocol version
  kDamaged,   // length or checksum
  kMalformed  // a sound frame whose body breaks a rule
};

struct FrameError {
  FrameFault fault = FrameFault::kNotOurs;
  std::uint16_t version = 0;  // of kVersion: theirs
};

[[nodiscard]] std::vector<std::byte> encode_frame(const JobKey& job, const Message& message);

[[nodiscard]] tl::expected<Envelope, FrameError> decode_frame(std::span<const std::byte> bytes);

}  // namespace preheat
