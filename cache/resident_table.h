// Which cold voxels can be traced right now: one pointer a voxel, read by every tracer thread
// without a lock, with a safe moment to free what was taken out.
//
// Epochs (Fraser 2004, section 5.2.3): a tracer announces the current epoch before it reads
// pointers and withdraws it after its batch. A mesh taken out at epoch e is unreachable for batches
// that begin later, so it may be freed once no tracer announces an epoch <= e. Tracers never wait.
// Threads: lookup under a Guard by any tracer; publish, withdraw and is_quiescent by one owner at a
// time.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <vector>

#include "common/ids.h"

namespace preheat {

class VoxelMesh;

class ResidentTable {
 public:
  ResidentTable(std::size_t voxel_count, unsigned tracer_count);

  // Announces that `tracer` reads pointers until destruction.
  class Guard {
   public:
    Guard(ResidentTable& table, unsigned tracer);
    ~Guard();
    Guard(const Guard&) = delete;
    Guard& operator=(const Guard&) = delete;

   private:
    std::atomic<std::uint64_t>& announced_;
  };

  // nullptr where absent. Requires: a live Guard of the calling thread.
  [[nodiscard]] const VoxelMesh* lookup(VoxelId voxel) const {
    return meshes_[index_of(voxel)].load(std::memory_order_seq_cst);
  }

  void publish(VoxelId voxel, const VoxelMesh* mesh);

  // Takes the mesh out; the returned epoch is for is_quiescent.
  [[nodiscard]] std::uint64_t withdraw(VoxelId voxel);

  // True once no batch that could have seen a mesh withdrawn at `epoch` runs any more.
  [[nodiscard]] bool is_quiescent(std::uint64_t epoch) const;

 private:
  static constexpr std::uint64_t kIdle = UINT64_MAX;
  struct alignas(64) Announcement {
    std::atomic<std::uint64_t> epoch{kIdle};
  };
  std::vector<std::atomic<const VoxelMesh*>> meshes_;
  std::vector<Announcement> announcements_;
  std::atomic<std::uint64_t> epoch_{1};
};

}  // namespace preheat
