// Answers range requests from the mapped store, without a copy: the origin of every voxel.
//
// Threads: one owner.
#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "common/messages.h"
#include "common/transport.h"

namespace preheat {

// A plan as it travels: what a worker of one cache size is to hold (see Welcome::plan_bytes), or
// the homes of all workers' cold voxels (home_plan.h).
struct EncodedPlan {
  std::size_t hot_count = 0;
  std::vector<std::byte> bytes{};
  Hash128 hash{};
  [[nodiscard]] std::vector<VoxelId> hot_voxels() const;
};

class VoxelServer {
 public:
  // What is served outlives the server and every message: it lies in the mapping.
  VoxelServer(std::span<const std::byte> tables, std::size_t voxel_count,
              std::function<std::span<const std::byte>(VoxelId)> block)
      : tables_(tables), voxel_count_(voxel_count), block_(std::move(block)) {}

  // The plan of homes that is followed from now on.
  void set_homes(std::uint32_t version, std::shared_ptr<const EncodedPlan> homes) {
    homes_version_ = version;
    homes_ = std::move(homes);
  }

  // The bytes asked for; nothing if there are none such.
  [[nodiscard]] std::optional<Payload> answer(const RangeRequest& request,
                                              const std::shared_ptr<const EncodedPlan>& plan) const;

 private:
  std::span<const std::byte> tables_;
  std::size_t voxel_count_;
  std::uint32_t homes_version_ = 0;
  std::shared_ptr<const EncodedPlan> homes_{};
  std::function<std::span<const std::byte>(VoxelId)> block_;
};

}  // namespace preheat
