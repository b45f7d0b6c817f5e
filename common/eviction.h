// Which voxel a worker's cache gives up first; see cache/eviction_policy.h.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string_view>

namespace preheat {

enum class Eviction : std::uint8_t { kLru = 0, kLfu = 1, kPrior = 2, kS3Fifo = 3 };

// As options name them, by the value of the enum.
inline constexpr std::array<std::string_view, 4> kEvictionNames{"lru", "lfu", "prior", "s3-fifo"};

inline constexpr Eviction kEvictionDefault = Eviction::kLfu;

[[nodiscard]] constexpr std::string_view name_of(Eviction eviction) {
  return kEvictionNames[static_cast<std::size_t>(eviction)];
}

// Of a worker's choices; it knows no prediction, so `prior` is none of them.
[[nodiscard]] constexpr std::optional<Eviction> eviction_of(std::string_view name) {
  for (const Eviction eviction : {Eviction::kLru, Eviction::kLfu, Eviction::kS3Fifo}) {
    if (name == name_of(eviction)) { return eviction; }
  }
  return std::nullopt;
}

}  // namespace preheat
