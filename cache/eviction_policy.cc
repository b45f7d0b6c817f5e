#include "cache/eviction_policy.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "cache/ranked_policy.h"
#include "cache/s3_fifo_policy.h"
#include "common/check.h"

namespace preheat {
namespace {

// Periods after which a use counts half.
constexpr double kHalfLifePeriods = 64.0;
// Periods of observation that the prediction stands for.
constexpr double kPredictionPeriods = 16.0;

class LruPolicy : public RankedPolicy {
 public:
  explicit LruPolicy(std::size_t voxel_count) : RankedPolicy(voxel_count) {}

  void admitted(VoxelId voxel) override {
    RankedPolicy::admitted(voxel);
    used(voxel, 1);
  }
  void used(VoxelId voxel, std::uint64_t /*rays*/) override { set_rank(voxel, ++uses_); }
  void begin_period() override {}

 private:
  double uses_ = 0.0;
};

// The rank is log2 of the sum over the periods of use of 2^(period / half-life): all records age
// alike, so their order changes only when one is used.
class LfuPolicy : public RankedPolicy {
 public:
  // `chance_expected` as in EvictionInput.
  LfuPolicy(std::size_t voxel_count, const std::vector<double>& chance_expected)
      : RankedPolicy(voxel_count), period_used_(voxel_count) {
    for (std::uint32_t voxel = 0; voxel < voxel_count; ++voxel) {
      const double chance = chance_expected.empty() ? 0.0 : chance_expected[voxel];
      set_rank(VoxelId{voxel}, std::log2(kPredictionPeriods * chance));
    }
  }

  void used(VoxelId voxel, std::uint64_t /*rays*/) override {
    std::uint64_t& period_used = period_used_[index_of(voxel)];
    if (period_used == period_) { return; }
    period_used = period_;
    const double weight = static_cast<double>(period_) / kHalfLifePeriods;
    const double record = rank(voxel);
    const double larger = std::max(weight, record);
    const double smaller = std::min(weight, record);
    set_rank(voxel, larger + std::log2(1.0 + std::exp2(smaller - larger)));
  }
  void begin_period() override { ++period_; }

 private:
  std::uint64_t period_ = 1;
  std::vector<std::uint64_t> period_used_;
};

}  // namespace

std::unique_ptr<EvictionPolicy> make_eviction_policy(Eviction eviction, EvictionInput input) {
  const std::size_t voxel_count = input.bytes.size();
  CHECK(input.chance_expected.empty() || input.chance_expected.size() == voxel_count);
  switch (eviction) {
    case Eviction::kLru:
      return std::make_unique<LruPolicy>(voxel_count);
    case Eviction::kLfu:
      return std::make_unique<LfuPolicy>(voxel_count, std::vector<double>{});
    case Eviction::kPrior:
      return std::make_unique<LfuPolicy>(voxel_count, input.chance_expected);
    case Eviction::kS3Fifo:
      return std::make_unique<S3FifoPolicy>(std::move(input.bytes));
  }
  CHECK(false);
}

std::vector<double> chance_per_period(std::span<const double> rays_expected, double periods) {
  std::vector<double> chances;
  chances.reserve(rays_expected.size());
  for (const double rays : rays_expected) { chances.push_back(-std::expm1(-rays / periods)); }
  return chances;
}

}  // namespace preheat
