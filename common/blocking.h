// The formulas of [P] section 2: how likely a cell stops a ray, and how many cells a ray crosses.
//
// Every probability stays in [0,1], where the paper's sums exceed it, and no argument, however
// large, small or not a number, makes a result that is not finite.
#pragma once

#include "common/aabb.h"

namespace preheat {

// (1 - p)^n: the probability that a ray passes n cells, each of which stops it with probability
// `blocking`. Computed as exp(n log(1 - p)), as 1 - p loses the digits of a small p: in single
// precision (1 - 1e-8)^(2^30) is 1 instead of 2.2e-5. Relative error below 1e-16 (1 + n p).
// Any `cells` >= 0 up to 2^1000, whole or not.
[[nodiscard]] double pass_probability(double blocking, double cells);

// What does not pass, with the digits of a small result.
[[nodiscard]] double stop_probability(double blocking, double cells);

// [P] section 2, C_t as printed, with 2^depth_mean leaves along a ray and the chance blocking_mean
// that one of them stops it. The sum over the leaves is taken in closed form, so that a depth of
// 1000 takes no longer than one of 2.
[[nodiscard]] double traversal_cost(double depth_mean, double blocking_mean);

// [P] section 2, p_i: the surface of the boxes of a cell's objects over that of the cell. A box
// counts as far as it lies in the cell.
class BlockingFactor {
 public:
  explicit BlockingFactor(const Aabb& cell);

  void add(const Aabb& box);

  // The paper's sum, which exceeds 1 where boxes hide one another; infinite where a cell without
  // surface holds a box.
  [[nodiscard]] double sum() const;
  // The sum as a probability: at most 1. A cell without surface blocks with certainty if a box
  // reaches it, and not at all otherwise. Never sinks when a box is added.
  [[nodiscard]] double probability() const;

 private:
  Aabb cell_;
  double cell_area_;
  double area_ = 0.0;
  bool is_reached_ = false;
};

}  // namespace preheat
