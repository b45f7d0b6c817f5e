// A sum whose error does not grow with the number of terms (Neumaier 1974): the part of each term
// that rounding drops is kept and added at the end. Needs arithmetic as written, without
// contraction or reassociation, which the build guarantees.
#pragma once

#include <cmath>

namespace preheat {

class CompensatedSum {
 public:
  void add(double term) {
    const double sum = sum_ + term;
    dropped_ += std::abs(sum_) >= std::abs(term) ? (sum_ - sum) + term : (term - sum) + sum_;
    sum_ = sum;
  }
  [[nodiscard]] double value() const { return sum_ + dropped_; }

 private:
  double sum_ = 0.0;
  double dropped_ = 0.0;
};

}  // namespace preheat
