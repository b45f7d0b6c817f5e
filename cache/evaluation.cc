#include "cache/evaluation.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "common/check.h"
#include "common/compensated_sum.h"

namespace preheat {
namespace {

double sum_of(std::span<const double> values) {
  CompensatedSum sum;
  for (const double value : values) { sum.add(value); }
  return sum.value();
}

bool is_constant(std::span<const double> values) {
  return std::all_of(values.begin(), values.end(),
                     [&](double value) { return value == values.front(); });
}

// Of two arrays of equal length, at least one pair. A constant array has the value itself for a
// mean, not what rounding makes of sum / n, so that its second moments are exactly 0.
struct Moments {
  Moments(std::span<const double> e, std::span<const double> r)
      : e_mean(mean_of(e)), r_mean(mean_of(r)) {
    CompensatedSum sum_ee;
    CompensatedSum sum_er;
    CompensatedSum sum_rr;
    for (std::size_t i = 0; i < e.size(); ++i) {
      const double e_off = e[i] - e_mean;
      const double r_off = r[i] - r_mean;
      sum_ee.add(e_off * e_off);
      sum_er.add(e_off * r_off);
      sum_rr.add(r_off * r_off);
    }
    ee = sum_ee.value();
    er = sum_er.value();
    rr = sum_rr.value();
  }
  static double mean_of(std::span<const double> values) {
    return is_constant(values) ? values.front()
                               : sum_of(values) / static_cast<double>(values.size());
  }

  double e_mean;
  double r_mean;
  double ee = 0.0;  // sum (e - mean e)^2
  double er = 0.0;
  double rr = 0.0;
};

std::optional<double> correlation(const Moments& moments) {
  const double scale = std::sqrt(moments.ee) * std::sqrt(moments.rr);
  if (!(scale > 0.0)) { return std::nullopt; }
  return std::clamp(moments.er / scale, -1.0, 1.0);
}

// 1 for the smallest; equal values share the mean of their ranks.
std::vector<double> ranks_of(std::span<const double> values) {
  std::vector<std::size_t> order(values.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::sort(order.begin(), order.end(),
            [&](std::size_t a, std::size_t b) { return values[a] < values[b]; });
  std::vector<double> ranks(values.size());
  for (std::size_t begin = 0; begin < order.size();) {
    std::size_t end = begin + 1;
    while (end < order.size() && values[order[end]] == values[order[begin]]) { ++end; }
    const double rank = 0.5 * static_cast<double>(begin + 1 + end);
    for (; begin < end; ++begin) { ranks[order[begin]] = rank; }
  }
  return ranks;
}

double root_mean_square_residual(std::span<const double> e, std::span<const double> r,
                                 const Moments& moments, double slope) {
  CompensatedSum squares;
  for (std::size_t i = 0; i < e.size(); ++i) {
    const double residual = (e[i] - moments.e_mean) - slope * (r[i] - moments.r_mean);
    squares.add(residual * residual);
  }
  return std::sqrt(squares.value() / static_cast<double>(e.size()));
}

}  // namespace

Evaluation evaluate(std::span<const double> estimated, std::span<const double> counted) {
  CHECK(estimated.size() == counted.size());
  Evaluation evaluation;
  evaluation.count = counted.size();
  if (counted.empty()) { return evaluation; }
  const Moments moments(estimated, counted);
  const bool has_slope = moments.rr > 0.0;
  const double slope = has_slope ? moments.er / moments.rr : 0.0;
  evaluation.sigma = root_mean_square_residual(estimated, counted, moments, slope);
  if (has_slope) {
    evaluation.beta = slope;
    evaluation.alpha = moments.e_mean - slope * moments.r_mean;
    evaluation.slope_variance = *evaluation.sigma * (*evaluation.sigma / moments.rr);
  }
  if (moments.r_mean != 0.0) {
    evaluation.sigma_over_mean = *evaluation.sigma / moments.r_mean;
    evaluation.total_ratio = sum_of(estimated) / sum_of(counted);
  }
  evaluation.pearson = correlation(moments);
  if (evaluation.pearson && counted.size() >= kPairsForR2Min) {
    evaluation.r2 = *evaluation.pearson * *evaluation.pearson;
  }
  evaluation.spearman = correlation(Moments(ranks_of(estimated), ranks_of(counted)));
  return evaluation;
}

std::vector<std::size_t> hottest_first(std::span<const double> rays,
                                       std::span<const double> bytes) {
  CHECK(rays.size() == bytes.size());
  std::vector<double> heat(rays.size());
  for (std::size_t i = 0; i < rays.size(); ++i) {
    const double without_bytes = rays[i] > 0.0 ? std::numeric_limits<double>::infinity() : 0.0;
    heat[i] = bytes[i] > 0.0 ? rays[i] / bytes[i] : without_bytes;
  }
  std::vector<std::size_t> order(rays.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return heat[a] > heat[b]; });
  return order;
}

double capture(std::span<const std::size_t> order, std::span<const double> counted,
               std::span<const double> bytes, double share) {
  CHECK(order.size() == counted.size() && order.size() == bytes.size());
  const double all = sum_of(counted);
  if (!(all > 0.0)) { return 0.0; }
  double room = share * sum_of(bytes);
  CompensatedSum captured;
  for (const std::size_t i : order) {
    const double part = bytes[i] > 0.0 ? std::min(1.0, room / bytes[i]) : 1.0;
    captured.add(part * counted[i]);
    room = std::max(0.0, room - part * bytes[i]);
  }
  return captured.value() / all;
}

std::vector<CapturePoint> capture_curve(std::span<const std::size_t> order,
                                        std::span<const double> counted,
                                        std::span<const double> bytes) {
  CHECK(order.size() == counted.size() && order.size() == bytes.size());
  const double all_counted = sum_of(counted);
  const double all_bytes = sum_of(bytes);
  std::vector<CapturePoint> curve{{0.0, 0.0}};
  if (!(all_counted > 0.0) || !(all_bytes > 0.0)) { return curve; }
  CompensatedSum captured;
  CompensatedSum taken;
  for (const std::size_t i : order) {
    captured.add(counted[i]);
    taken.add(bytes[i]);
    curve.push_back({taken.value() / all_bytes, captured.value() / all_counted});
  }
  return curve;
}

}  // namespace preheat
