#include "common/home_plan.h"

#include <fmt/format.h>

#include <algorithm>

#include "common/bounded.h"
#include "common/peer_address_codec.h"

namespace preheat {

template <class Archive>
void serialize(Archive& archive, HomePlan& plan) {
  archive(at_most(plan.peers, kPeersMax), at_most(plan.homes, kVoxelCountMax));
}

std::vector<std::byte> encode_home_plan(const HomePlan& plan) { return encode(plan); }

Result<HomePlan> decode_home_plan(std::span<const std::byte> bytes, std::size_t voxel_count) {
  Result<HomePlan> plan = decode<HomePlan>(bytes, "the plan of homes", ExitCode::kMismatch);
  if (!plan) { return plan; }
  if (plan->homes.size() != voxel_count) {
    return fail(ExitCode::kMismatch, fmt::format("the plan of homes is for {} voxels, not {}",
                                                 plan->homes.size(), voxel_count));
  }
  const bool sound = std::all_of(plan->homes.begin(), plan->homes.end(), [&](std::uint16_t home) {
    return home == HomePlan::kNoHome || HomePlan::index(home) < plan->peers.size();
  });
  if (!sound) {
    return fail(ExitCode::kMismatch, fmt::format("the plan of homes names a home that is not one "
                                                 "of its {} peers",
                                                 plan->peers.size()));
  }
  return plan;
}

}  // namespace preheat
