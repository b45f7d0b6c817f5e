#include "common/scene_tables.h"

#include <algorithm>

#include "common/voxel_block.h"

namespace preheat {

std::uint64_t VoxelEntry::hot_bytes() const {
  return block_bytes + kBvhBytesPerTriangle * triangle_count;
}

std::uint64_t SceneTables::resident_bytes() const {
  std::uint64_t sum = 0;
  for (const VoxelEntry& voxel : voxels) { sum += voxel.resident_bytes; }
  return sum;
}

std::uint64_t SceneTables::resident_bytes_min() const {
  std::uint64_t largest = 0;
  for (const VoxelEntry& voxel : voxels) { largest = std::max(largest, voxel.resident_bytes); }
  return largest;
}

Features detect_features(const SceneTables& tables) {
  Features features;
  features.emitters = !tables.emissive_triangles.empty();
  features.point_lights = !tables.lights.empty();
  for (const Material& material : tables.materials) {
    const bool metal_only = material.metallic >= 1.0F;
    const bool transmits = !metal_only && material.transmission > 0.0F;
    features.diffuse |= !metal_only && material.transmission < 1.0F;
    features.specular |=
        material.metallic > 0.0F || transmits || material.specular_color != Vec3(0.0F);
    features.transmission |= transmits;
    features.rough_transmission |= transmits && material.roughness > 0.0F;
  }
  return features;
}

namespace {

struct NamedFeature {
  const char* name;
  bool present;
};

std::vector<NamedFeature> named(const Features& features) {
  return {{"emitters", features.emitters},
          {"point_lights", features.point_lights},
          {"environment", features.environment},
          {"diffuse", features.diffuse},
          {"specular", features.specular},
          {"transmission", features.transmission},
          {"rough_transmission", features.rough_transmission}};
}

std::vector<std::string> names_where(const Features& features, bool present) {
  std::vector<std::string> names;
  for (const NamedFeature& feature : named(features)) {
    if (feature.present == present) { names.emplace_back(feature.name); }
  }
  return names;
}

}  // namespace

std::vector<std::string> Features::modelled() const { return names_where(*this, true); }
std::vector<std::string> Features::left_out() const { return names_where(*this, false); }

}  // namespace preheat
