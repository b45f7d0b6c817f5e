// Expected against counted rays: how well the one tells the other, as numbers.
//
// Pure mathematics over two arrays of equal length, e the estimates and r the counts, one pair for
// each voxel (or leaf, or node: whatever was counted). Every sum is compensated and second moments
// are taken about the means, so that the order of the voxels moves a result by rounding only, and
// no count is too large for it. What the data cannot tell is absent, never NaN.
#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <vector>

namespace preheat {

// R squared of fewer pairs says little; it is not given.
inline constexpr std::size_t kPairsForR2Min = 64;

struct Evaluation {
  std::size_t count = 0;
  // [P] section 8: the least squares line e = alpha + beta r. Absent where all r are equal, as then
  // any slope is as good.
  std::optional<double> alpha{};
  std::optional<double> beta{};
  // [P] section 8: the root of the mean square of e about that line. Where all r are equal every
  // line through the means leaves the same residuals, so this is absent only without pairs.
  std::optional<double> sigma{};
  std::optional<double> sigma_over_mean{};  // over the mean of r; absent where that is 0
  // sigma^2 / sum (r - mean r)^2, the variance of the slope's estimate. It is what the rows named
  // sigma in Tables 2 and 3 of [P] hold, as Table 4 shows; it has no unit.
  std::optional<double> slope_variance{};
  std::optional<double> pearson{};   // absent where all e or all r are equal
  std::optional<double> r2{};        // pearson^2; absent under kPairsForR2Min pairs as well
  std::optional<double> spearman{};  // Pearson's of the ranks; equal values share their mean rank
  std::optional<double> total_ratio{};  // sum e / sum r; absent where no ray was counted
};

// Requires: equal lengths, finite values.
[[nodiscard]] Evaluation evaluate(std::span<const double> estimated,
                                  std::span<const double> counted);

// Indices by descending rays per byte, equal ones by index. What has rays and no bytes comes first,
// what has neither last.
[[nodiscard]] std::vector<std::size_t> hottest_first(std::span<const double> rays,
                                                     std::span<const double> bytes);

// The share of all counted accesses that falls in the voxels taken in this order within a share of
// all bytes; the last voxel counts in part. 0 where nothing was counted. No order captures more
// than hottest_first(counted, bytes) does, the oracle's.
//
// Requires: `order` holds every index once, share in [0,1], nothing is negative.
[[nodiscard]] double capture(std::span<const std::size_t> order, std::span<const double> counted,
                             std::span<const double> bytes, double share);

struct CapturePoint {
  double bytes_share = 0.0;
  double accesses_share = 0.0;
};

// capture() as a function of the share: the corners of a line from (0, 0) to (1, 1).
[[nodiscard]] std::vector<CapturePoint> capture_curve(std::span<const std::size_t> order,
                                                      std::span<const double> counted,
                                                      std::span<const double> bytes);

}  // namespace preheat
