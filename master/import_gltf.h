// glTF 2.0 and GLB -> Scene. See master/import.h for what an importer promises.
//
// Read: the default scene's nodes, triangles of every mode, cameras, metallic-roughness materials,
// KHR_materials_{emissive_strength, ior, pbrSpecularGlossiness, specular, transmission, volume},
// KHR_lights_punctual, KHR_mesh_quantization. Skins and morph targets stay in their base pose.
#pragma once

#include <filesystem>

#include "common/result.h"
#include "common/scene.h"

namespace preheat {

[[nodiscard]] Result<Scene> import_gltf(const std::filesystem::path& file);

}  // namespace preheat
