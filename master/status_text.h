// A moment of a render as JSON for programs and as metrics for Prometheus. Pure. The keys and the
// names of the metrics are a contract: tools read them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>

#include "master/render_watch.h"

namespace preheat {

// Of more workers the first ones are told apart and the rest is summed, so that no answer grows
// without bound.
inline constexpr std::size_t kStatusWorkersMax = 1024;

// What does not change while a render runs.
struct StatusFacts {
  std::string version{};
  std::string scene{};
  std::string isa{};
  std::uint32_t width = 0;
  std::uint32_t height = 0;
  std::uint32_t spp = 0;
  std::uint32_t bounces = 0;
};

[[nodiscard]] nlohmann::ordered_json make_status_json(const StatusFacts& facts,
                                                      const RenderSnapshot& snapshot,
                                                      std::uint64_t image_version);

// The text exposition format, version 0.0.4.
[[nodiscard]] std::string make_metrics(const StatusFacts& facts, const RenderSnapshot& snapshot);

}  // namespace preheat
