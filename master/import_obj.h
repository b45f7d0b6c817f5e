// Wavefront OBJ with MTL -> Scene. See master/import.h for what an importer promises.
//
// Geometry is read here and not by tinyobjloader, which turns "nan" into 0 and the index 2^32 + 1
// into 1 without a word, knows no line numbers, and holds several copies of what it reads. Its MTL
// reader is used. Coordinates are kept in double until they are rebased, so that scenes in map
// coordinates keep their detail.
#pragma once

#include <filesystem>
#include <vector>

#include "common/result.h"
#include "common/scene.h"

namespace preheat {

[[nodiscard]] Result<Scene> import_obj(const std::filesystem::path& file);

// The material libraries that exist and that import_obj would read, in order.
[[nodiscard]] Result<std::vector<std::filesystem::path>> list_obj_material_files(
    const std::filesystem::path& file);

}  // namespace preheat
