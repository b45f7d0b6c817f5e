#include "cache/seen_sides.h"

namespace preheat {
namespace {

// Less than a handful of sights says nothing.
constexpr double kFrontMin = 2.0;

// Closed bodies, a golf ball and a helmet, show backs by up to 0.08 of what they show of their
// fronts, by their outlines; where windings disagree it is mostly 0.4 and more.
constexpr double kBackShareMax = 0.2;

}  // namespace

void SeenSides::add(std::size_t material, float cosine) {
  const auto weight = static_cast<double>(cosine);
  if (weight > 0.0) {
    seen_[material].front += weight;
  } else {
    seen_[material].back -= weight;
  }
}

void SeenSides::add(const SeenSides& other) {
  for (std::size_t material = 0; material < seen_.size(); ++material) {
    seen_[material].front += other.seen_[material].front;
    seen_[material].back += other.seen_[material].back;
  }
}

std::vector<std::uint8_t> SeenSides::one_sided() const {
  std::vector<std::uint8_t> flags;
  flags.reserve(seen_.size());
  for (const Seen& seen : seen_) {
    const bool is_known = seen.front >= kFrontMin && seen.back <= kBackShareMax * seen.front;
    flags.push_back(is_known ? 1 : 0);
  }
  return flags;
}

}  // namespace preheat
