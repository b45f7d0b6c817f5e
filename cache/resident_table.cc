#include "cache/resident_table.h"

#include <algorithm>

#include "common/check.h"

namespace preheat {

ResidentTable::ResidentTable(std::size_t voxel_count, unsigned tracer_count)
    : meshes_(voxel_count), announcements_(tracer_count) {}

// Sequential consistency of all four accesses orders "announce, then read the pointer" here against
// "clear the pointer, then read the announcements" in withdraw and is_quiescent: one of the two
// sees the other.
ResidentTable::Guard::Guard(ResidentTable& table, unsigned tracer)
    : announced_(table.announcements_[tracer].epoch) {
  announced_.store(table.epoch_.load(std::memory_order_seq_cst), std::memory_order_seq_cst);
}

ResidentTable::Guard::~Guard() { announced_.store(kIdle, std::memory_order_release); }

void ResidentTable::publish(VoxelId voxel, const VoxelMesh* mesh) {
  CHECK(mesh != nullptr);
  meshes_[index_of(voxel)].store(mesh, std::memory_order_release);
}

std::uint64_t ResidentTable::withdraw(VoxelId voxel) {
  meshes_[index_of(voxel)].store(nullptr, std::memory_order_seq_cst);
  return epoch_.fetch_add(1, std::memory_order_seq_cst);
}

bool ResidentTable::is_quiescent(std::uint64_t epoch) const {
  return std::all_of(announcements_.begin(), announcements_.end(),
                     [epoch](const Announcement& announcement) {
                       return announcement.epoch.load(std::memory_order_seq_cst) > epoch;
                     });
}

}  // namespace preheat
