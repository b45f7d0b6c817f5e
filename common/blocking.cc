#include "common/blocking.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace preheat {
namespace {

// In [0,1]; what is not a number blocks nothing.
[[nodiscard]] double as_probability(double value) {
  return value > 0.0 ? std::min(value, 1.0) : 0.0;
}

// Of the three faces that meet in a corner.
[[nodiscard]] double corner_area(const Vec3d& extent) {
  return extent.x * extent.y + extent.y * extent.z + extent.z * extent.x;
}

// sum of i p (1-p)^(i-1) over i = 1..n, which is (1 - (1 + n p) (1-p)^n) / p. Where n p is small
// that difference loses its digits; then the terms of the sum are expanded in powers of p, which
// gives sum over k of (-1)^k p^(k+1) (k+1) C(n+1, k+2).
[[nodiscard]] double cells_before_stop(double p, double n) {
  constexpr double kSeriesMax = 0.25;
  const double mean = n * p;
  if (mean > kSeriesMax) {
    const double exponent = n * std::log1p(-p);
    constexpr double kNothing = -745.0;  // exp of less is 0
    if (exponent < kNothing) { return 1.0 / p; }
    return (-std::expm1(exponent) - mean * std::exp(exponent)) / p;
  }
  double term = mean * ((n + 1.0) / 2.0);
  double sum = term;
  for (double k = 0.0; std::abs(term) > 1e-18 * sum; ++k) {
    term *= -(k + 2.0) / ((k + 1.0) * (k + 3.0)) * (mean - p * (k + 1.0));
    sum += term;
  }
  return sum;
}

}  // namespace

double pass_probability(double blocking, double cells) {
  const double p = as_probability(blocking);
  if (!(cells > 0.0)) { return 1.0; }  // before the product of 0 and an infinite logarithm
  return std::exp(cells * std::log1p(-p));
}

double stop_probability(double blocking, double cells) {
  const double p = as_probability(blocking);
  if (!(cells > 0.0)) { return 0.0; }
  return -std::expm1(cells * std::log1p(-p));
}

double traversal_cost(double depth_mean, double blocking_mean) {
  const double p = as_probability(blocking_mean);
  const double cells = std::exp2(depth_mean > 0.0 ? std::min(depth_mean, 1000.0) : 0.0);
  if (p >= 1.0) { return 1.0; }  // every ray ends in its first cell
  const double whole_cells = std::floor(cells);
  const double part = cells - whole_cells;
  return cells_before_stop(p, whole_cells) + cells * part * p * pass_probability(p, part) +
         cells * pass_probability(p, cells);
}

BlockingFactor::BlockingFactor(const Aabb& cell)
    : cell_(cell), cell_area_(corner_area(Vec3d(cell.high) - Vec3d(cell.low))) {}

void BlockingFactor::add(const Aabb& box) {
  Vec3d extent(0.0);
  bool reaches = true;
  for (int axis = 0; axis < 3; ++axis) {
    const double low = static_cast<double>(std::max(box.low[axis], cell_.low[axis]));
    const double high = static_cast<double>(std::min(box.high[axis], cell_.high[axis]));
    // Negative along an axis where only the cell's margin is touched.
    extent[axis] = high > low ? high - low : 0.0;
    reaches = reaches && high >= low;
  }
  area_ += corner_area(extent);
  is_reached_ = is_reached_ || reaches;
}

double BlockingFactor::sum() const {
  if (cell_area_ > 0.0) { return area_ / cell_area_; }
  return is_reached_ ? std::numeric_limits<double>::infinity() : 0.0;
}

double BlockingFactor::probability() const { return as_probability(sum()); }

}  // namespace preheat
