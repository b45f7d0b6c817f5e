// Scene -> store: octree, voxels, tables, proxy, statistics.
//
// The file's bytes are a function of the scene, the source's name and hash, and the options but
// `threads`: two compilations of one scene can be compared with cmp.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>

#include "common/octree.h"
#include "common/result.h"
#include "common/scene.h"
#include "common/scene_tables.h"

namespace preheat {

struct CompileOptions {
  std::uint64_t voxel_size_bytes = 0;  // 0 = by the scene's size, see default_voxel_size
  OctreeLimits octree{};               // its `threads` is not read
  unsigned threads = 0;                // 0 = all cores; changes the time only
};

// Writes the store under its name once it is complete; a failure leaves no file and what was there
// before untouched. kSceneRejected if the scene exceeds a limit of the store, kOutputUnwritable if
// the file cannot be written.
[[nodiscard]] Result<void> compile_scene(const Scene& scene, const std::string& source_file,
                                         Hash128 source_hash, const CompileOptions& options,
                                         const std::filesystem::path& store_file);

}  // namespace preheat
