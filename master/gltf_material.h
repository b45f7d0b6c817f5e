// glTF materials -> ours.
#pragma once

#include <tiny_gltf.h>

#include <string>
#include <vector>

#include "common/scene.h"

namespace preheat {

// One material for each of the model's, in order, and one sentence for each kind of thing that was
// left out, with how many materials it concerns.
struct GltfMaterials {
  std::vector<Material> materials{};
  std::vector<std::string> notes{};
};

[[nodiscard]] GltfMaterials convert_gltf_materials(const tinygltf::Model& model);

// The number at `key` of an extension object; `otherwise` where there is none.
[[nodiscard]] double gltf_number(const tinygltf::Value& object, const std::string& key,
                                 double otherwise);

}  // namespace preheat
