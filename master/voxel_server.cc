#include "master/voxel_server.h"

#include <cstring>

namespace preheat {

std::vector<VoxelId> EncodedPlan::hot_voxels() const {
  std::vector<VoxelId> ids(hot_count);
  if (!ids.empty()) { std::memcpy(ids.data(), bytes.data(), ids.size() * sizeof(VoxelId)); }
  return ids;
}

std::optional<Payload> VoxelServer::answer(const RangeRequest& request,
                                           const std::shared_ptr<const EncodedPlan>& plan) const {
  Payload whole;
  switch (request.object) {
    case BulkObject::kTables:
      whole.bytes = tables_;
      break;
    case BulkObject::kPlan:
      whole = {plan->bytes, plan};
      break;
    case BulkObject::kVoxel:
      if (index_of(request.voxel) >= voxel_count_) { return std::nullopt; }
      whole.bytes = block_(request.voxel);
      break;
    case BulkObject::kHomes:
      if (!homes_ || index_of(request.voxel) != homes_version_) { return std::nullopt; }
      whole = {homes_->bytes, homes_};
      break;
  }
  if (request.offset >= whole.bytes.size() || request.bytes > whole.bytes.size() - request.offset) {
    return std::nullopt;
  }
  whole.bytes = whole.bytes.subspan(request.offset, request.bytes);
  return whole;
}

}  // namespace preheat
