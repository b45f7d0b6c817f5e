#include "master/gltf_material.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cstddef>
#include <string_view>

#include "master/reflectance.h"

namespace preheat {

namespace {

// Keeps what a hostile file may say inside the range of float.
constexpr double kRadianceMax = 1e30;

float in_unit(double value) { return static_cast<float>(std::clamp(value, 0.0, 1.0)); }

Vec3 color(const std::vector<double>& values, const Vec3& otherwise) {
  if (values.size() < 3) { return otherwise; }
  return {in_unit(values[0]), in_unit(values[1]), in_unit(values[2])};
}

Vec3 color(const tinygltf::Value& object, const std::string& key, const Vec3& otherwise) {
  if (!object.Has(key)) { return otherwise; }
  const tinygltf::Value& array = object.Get(key);
  if (!array.IsArray() || array.ArrayLen() < 3) { return otherwise; }
  Vec3 result = otherwise;
  const auto& values = array.Get<tinygltf::Value::Array>();
  for (int axis = 0; axis < 3; ++axis) {
    const tinygltf::Value& value = values[static_cast<std::size_t>(axis)];
    if (value.IsNumber()) { result[axis] = in_unit(value.GetNumberAsDouble()); }
  }
  return result;
}

// Nullptr where the material does not have it.
const tinygltf::Value* extension(const tinygltf::Material& material, const char* name) {
  const auto found = material.extensions.find(name);
  return found != material.extensions.end() && found->second.IsObject() ? &found->second : nullptr;
}

void apply_specular_glossiness(const tinygltf::Value& source, Material& material) {
  material.base_color = color(source, "diffuseFactor", Vec3(1.0F));
  material.metallic = 0.0F;
  material.roughness = 1.0F - in_unit(gltf_number(source, "glossinessFactor", 1.0));
  set_specular_reflectance(color(source, "specularFactor", Vec3(1.0F)), material);
}

void apply_extensions(const tinygltf::Material& source, Material& material) {
  if (const auto* found = extension(source, "KHR_materials_pbrSpecularGlossiness")) {
    apply_specular_glossiness(*found, material);
  }
  if (const auto* found = extension(source, "KHR_materials_ior")) {
    material.ior = static_cast<float>(std::clamp(gltf_number(*found, "ior", 1.5), 1.0, 100.0));
  }
  if (const auto* found = extension(source, "KHR_materials_transmission")) {
    material.transmission = in_unit(gltf_number(*found, "transmissionFactor", 0.0));
  }
  if (const auto* found = extension(source, "KHR_materials_volume")) {
    material.thin_walled = !(gltf_number(*found, "thicknessFactor", 0.0) > 0.0);
  }
  if (const auto* found = extension(source, "KHR_materials_specular")) {
    material.specular_color = color(*found, "specularColorFactor", Vec3(1.0F)) *
                              in_unit(gltf_number(*found, "specularFactor", 1.0));
  }
  if (const auto* found = extension(source, "KHR_materials_emissive_strength")) {
    const double strength = gltf_number(*found, "emissiveStrength", 1.0);
    material.emission *= static_cast<float>(std::clamp(strength, 0.0, kRadianceMax));
  }
}

Material convert(const tinygltf::Material& source) {
  const tinygltf::PbrMetallicRoughness& pbr = source.pbrMetallicRoughness;
  Material material;
  material.name = source.name;
  material.base_color = color(pbr.baseColorFactor, Vec3(1.0F));
  material.metallic = in_unit(pbr.metallicFactor);
  material.roughness = in_unit(pbr.roughnessFactor);
  material.emission = color(source.emissiveFactor, Vec3(0.0F));
  material.double_sided = source.doubleSided;
  apply_extensions(source, material);
  return material;
}

struct LeftOut {
  std::string_view what;  // completes "<count> ..."
  bool (*is_in)(const tinygltf::Material&);
};

bool has_texture_in_extension(const tinygltf::Material& material) {
  for (const auto& [name, value] : material.extensions) {
    for (const std::string& key : value.Keys()) {
      if (key.ends_with("Texture")) { return true; }
    }
  }
  return false;
}

bool has_absorption(const tinygltf::Material& material) {
  const auto* volume = extension(material, "KHR_materials_volume");
  return volume != nullptr && volume->Has("attenuationDistance");
}

constexpr std::array kLeftOut{
    LeftOut{"base colour textures left out: their factors are used",
            [](const tinygltf::Material& material) {
              return material.pbrMetallicRoughness.baseColorTexture.index >= 0;
            }},
    LeftOut{"metallic-roughness textures left out: their factors are used",
            [](const tinygltf::Material& material) {
              return material.pbrMetallicRoughness.metallicRoughnessTexture.index >= 0;
            }},
    LeftOut{"emissive textures left out: their factors are used",
            [](const tinygltf::Material& material) { return material.emissiveTexture.index >= 0; }},
    LeftOut{"normal textures left out",
            [](const tinygltf::Material& material) { return material.normalTexture.index >= 0; }},
    LeftOut{
        "occlusion textures left out: light transport has its own",
        [](const tinygltf::Material& material) { return material.occlusionTexture.index >= 0; }},
    LeftOut{"materials have textures in extensions left out: their factors are used",
            has_texture_in_extension},
    LeftOut{"materials are cut out by alpha (MASK): they are opaque here",
            [](const tinygltf::Material& material) { return material.alphaMode == "MASK"; }},
    LeftOut{"materials are blended by alpha (BLEND): they are opaque here",
            [](const tinygltf::Material& material) { return material.alphaMode == "BLEND"; }},
    LeftOut{"materials absorb light inside their volume: it is left out", has_absorption},
};

}  // namespace

double gltf_number(const tinygltf::Value& object, const std::string& key, double otherwise) {
  if (!object.Has(key)) { return otherwise; }
  const tinygltf::Value& value = object.Get(key);
  return value.IsNumber() ? value.GetNumberAsDouble() : otherwise;
}

GltfMaterials convert_gltf_materials(const tinygltf::Model& model) {
  GltfMaterials result;
  std::array<std::size_t, kLeftOut.size()> counts{};
  for (const tinygltf::Material& material : model.materials) {
    result.materials.push_back(convert(material));
    for (std::size_t i = 0; i < kLeftOut.size(); ++i) {
      if (kLeftOut[i].is_in(material)) { ++counts[i]; }
    }
  }
  for (std::size_t i = 0; i < kLeftOut.size(); ++i) {
    if (counts[i] > 0) {
      result.notes.push_back(fmt::format("{} {}", counts[i], kLeftOut[i].what));
    }
  }
  return result;
}

}  // namespace preheat
