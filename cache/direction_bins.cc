#include "cache/direction_bins.h"

#include <algorithm>
#include <cmath>

#include "common/check.h"
#include "common/math.h"

namespace preheat {

DirectionBins::DirectionBins(unsigned polar, unsigned azimuth) : polar_(polar), azimuth_(azimuth) {
  CHECK(polar >= 1 && polar <= kBinsPolarMax && azimuth >= 1 && azimuth <= kBinsAzimuthMax);
  const double turn = 2.0 * kPiDouble / azimuth;
  for (unsigned row = 0; row < polar; ++row) {
    const double upper = kPiDouble * row / polar;
    const double lower = kPiDouble * (row + 1) / polar;
    solid_angles_.push_back(turn * (std::cos(upper) - std::cos(lower)));
    // The integrals of sin^2 and of sin cos over the row's polar angles.
    const double across = 0.5 * (lower - upper) - 0.5 * (std::sin(lower) * std::cos(lower) -
                                                         std::sin(upper) * std::cos(upper));
    const double along =
        0.5 * (std::sin(lower) * std::sin(lower) - std::sin(upper) * std::sin(upper));
    for (unsigned column = 0; column < azimuth; ++column) {
      const double from = turn * column;
      const double to = turn * (column + 1);
      fluxes_.emplace_back(across * (std::sin(to) - std::sin(from)),
                           across * (std::cos(from) - std::cos(to)), along * turn);
    }
  }
}

std::optional<std::uint32_t> DirectionBins::bin_of(const Vec3d& direction) const {
  const double largest =
      std::max({std::abs(direction.x), std::abs(direction.y), std::abs(direction.z)});
  // NaN beside a finite number may pass max(); their sum does not.
  if (!(largest > 0.0) || !std::isfinite(direction.x + direction.y + direction.z)) {
    return std::nullopt;
  }
  const Vec3d d = direction / largest;  // so that squares neither overflow nor vanish

  // From the nearer pole, as both hemispheres shall be cut alike; an arc tangent needs no unit
  // vector and is sharp near the poles, where an arc cosine is not.
  const double from_pole = std::atan2(std::sqrt(d.x * d.x + d.y * d.y), std::abs(d.z));
  const auto row_from_pole =
      std::min(polar_ - 1, static_cast<unsigned>(from_pole / kPiDouble * polar_));
  const unsigned row = d.z < 0.0 ? polar_ - 1 - row_from_pole : row_from_pole;

  // The quadrant by comparisons and the rest of the turn inside it, so that quarter turns are
  // exact. Comparisons do not see the sign of a zero.
  double along = d.x;
  double across = d.y;
  unsigned quadrant = 0;
  if (d.x <= 0.0 && d.y > 0.0) {
    quadrant = 1;
    along = d.y;
    across = -d.x;
  } else if (d.x < 0.0 && d.y <= 0.0) {
    quadrant = 2;
    along = -d.x;
    across = -d.y;
  } else if (d.x >= 0.0 && d.y < 0.0) {
    quadrant = 3;
    along = -d.y;
    across = d.x;
  }
  const double quarter = azimuth_ / 4.0;
  const double inside = std::atan2(std::abs(across), std::abs(along)) / (0.5 * kPiDouble) * quarter;
  const double first = quarter * quadrant;
  // The quadrant ends where the next one begins, whatever rounding says.
  const double last = std::ceil(first + quarter) - 1.0;
  const auto column = static_cast<unsigned>(std::min(std::floor(first + inside), last));
  return row * azimuth_ + column;
}

BoxInBins::BoxInBins(const DirectionBins& bins) : bins_(bins), place_(bins.size(), 0) {}

void BoxInBins::add(std::uint32_t bin, double solid_angle) {
  if (place_[bin] == 0) {
    shares_.push_back({bin, 0.0});
    place_[bin] = static_cast<std::uint32_t>(shares_.size());
  }
  shares_[place_[bin] - 1].weight += solid_angle;
}

void BoxInBins::add_face(const Vec3d& from, const Vec3d& low, const Vec3d& high, int axis,
                         bool upper) {
  constexpr double kPatchesMax = 32.0;
  const double height = std::abs((upper ? high[axis] : low[axis]) - from[axis]);
  const int u = (axis + 1) % 3;
  const int v = (axis + 2) % 3;
  // From the point to the face: no patch is seen under a wider angle than its size over this.
  const Vec3d nearest = glm::clamp(from, low, high);
  const double distance = std::max(height, glm::length(nearest - from));
  const double narrowest =
      0.5 * std::min(kPiDouble / bins_.polar(), 2.0 * kPiDouble / bins_.azimuth());
  const auto patches = [&](int side) {
    return std::clamp(std::ceil((high[side] - low[side]) / (distance * narrowest)), 1.0,
                      kPatchesMax);
  };
  const double count_u = patches(u);
  const double count_v = patches(v);
  const double step_u = (high[u] - low[u]) / count_u;
  const double step_v = (high[v] - low[v]) / count_v;
  Vec3d to(0.0);
  to[axis] = (upper ? high[axis] : low[axis]) - from[axis];
  for (double i = 0.5; i < count_u; ++i) {
    to[u] = low[u] + i * step_u - from[u];
    for (double j = 0.5; j < count_v; ++j) {
      to[v] = low[v] + j * step_v - from[v];
      const double squared = glm::dot(to, to);
      const std::optional<std::uint32_t> bin = bins_.bin_of(to);
      if (bin) { add(*bin, step_u * step_v * height / (squared * std::sqrt(squared))); }
    }
  }
}

std::span<const BoxInBins::Share> BoxInBins::look(const Vec3d& from, const Aabb& box) {
  for (const Share& share : shares_) { place_[share.bin] = 0; }
  shares_.clear();
  const Vec3d low(box.low);
  const Vec3d high(box.high);
  bool is_inside = true;
  for (int axis = 0; axis < 3; ++axis) {
    const bool below = from[axis] < low[axis];
    const bool above = from[axis] > high[axis];
    if (below || above) { add_face(from, low, high, axis, above); }
    is_inside = is_inside && !below && !above;
  }
  if (is_inside) {
    for (std::uint32_t bin = 0; bin < bins_.size(); ++bin) { add(bin, bins_.solid_angle(bin)); }
  }
  for (Share& share : shares_) {
    share.weight = std::min(1.0, share.weight / bins_.solid_angle(share.bin));
  }
  return shares_;
}

}  // namespace preheat
