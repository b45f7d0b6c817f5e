#include "master/mtl_material.h"

#include <fmt/format.h>
#include <tiny_obj_loader.h>

#include <algorithm>
#include <cmath>
#include <sstream>

#include "master/reflectance.h"

namespace preheat {

namespace {

constexpr float kRadianceMax = 1e30F;
constexpr float kShininessSharp = 1000.0F;
constexpr float kReflectancePerSpecular = 0.08F;
constexpr float kDiffuseShareOfMetalMax = 0.1F;

// NaN becomes 0.
float clamped(float value, float low, float high) {
  return value > low ? std::min(value, high) : low;
}

Vec3 color(const tinyobj::real_t (&values)[3], float high = 1.0F) {
  return {clamped(values[0], 0.0F, high), clamped(values[1], 0.0F, high),
          clamped(values[2], 0.0F, high)};
}

float brightest(const Vec3& value) { return std::max({value.x, value.y, value.z}); }

float roughness_from_shininess(float shininess) {
  const float exponent = clamped(shininess, 0.0F, kShininessSharp);
  if (exponent >= kShininessSharp) { return 0.0F; }
  return std::sqrt(std::sqrt(2.0F / (exponent + 2.0F)));
}

bool is_glass(const tinyobj::material_t& source) {
  switch (source.illum) {
    case 6:
    case 7:
      return true;
    case 4:
    case 9:
      return source.dissolve < 1.0F || brightest(color(source.transmittance)) > 0.0F;
    default:
      return false;
  }
}

void make_glass(const tinyobj::material_t& source, Material& material) {
  const Vec3 filter = color(source.transmittance);
  const float level = brightest(filter);
  material.base_color = level > 0.0F ? filter / level : Vec3(1.0F);
  material.transmission = 1.0F;
  material.thin_walled = false;
  material.roughness = clamped(source.roughness, 0.0F, 1.0F);
  // 1 is what a file without Ni reads as; a solid of that index could not be seen.
  material.ior = source.ior > 1.0F ? std::min(source.ior, 100.0F) : 1.5F;
}

Material convert(const tinyobj::material_t& source) {
  Material material;
  material.name = trim(source.name);
  material.base_color = color(source.diffuse);
  material.emission = color(source.emission, kRadianceMax);
  material.roughness = roughness_from_shininess(source.shininess);
  if (is_glass(source)) {
    make_glass(source, material);
    return material;
  }
  const Vec3 specular = color(source.specular);
  if (source.metallic > 0.0F || source.roughness > 0.0F) {
    material.metallic = clamped(source.metallic, 0.0F, 1.0F);
    material.roughness = clamped(source.roughness, 0.0F, 1.0F);
  } else if (brightest(material.base_color) < kDiffuseShareOfMetalMax * brightest(specular)) {
    material.metallic = 1.0F;
    material.base_color = specular;
  } else {
    set_specular_reflectance(specular * kReflectancePerSpecular, material);
  }
  if (source.dissolve < 1.0F) {
    material.transmission = 1.0F - clamped(source.dissolve, 0.0F, 1.0F);
    material.roughness = 0.0F;
  }
  return material;
}

}  // namespace

std::string_view trim(std::string_view text) {
  constexpr std::string_view kSpace = " \t\r\n\f\v";
  const std::size_t first = text.find_first_not_of(kSpace);
  if (first == std::string_view::npos) { return {}; }
  return text.substr(first, text.find_last_not_of(kSpace) - first + 1);
}

bool MtlLibrary::add(std::string_view mtl_text) {
  constexpr std::string_view kBegin = "newmtl";
  std::size_t count = 0;
  for (std::size_t at = mtl_text.find(kBegin); at != std::string_view::npos;
       at = mtl_text.find(kBegin, at + kBegin.size())) {
    if (++count > kMaterialsMax) { return false; }
  }
  std::istringstream stream{std::string(mtl_text)};
  std::map<std::string, int> ignored_names;
  std::vector<tinyobj::material_t> sources;
  std::string warning;
  std::string error;
  tinyobj::LoadMtl(&ignored_names, &sources, &stream, &warning, &error);
  for (const tinyobj::material_t& source : sources) {
    Material material = convert(source);
    if (!index_by_name_.try_emplace(material.name, materials_.size()).second) { continue; }
    if (!source.diffuse_texname.empty()) { ++colour_textures_; }
    for (const std::string* name :
         {&source.specular_texname, &source.specular_highlight_texname, &source.bump_texname,
          &source.displacement_texname, &source.alpha_texname, &source.reflection_texname,
          &source.roughness_texname, &source.metallic_texname, &source.emissive_texname,
          &source.normal_texname}) {
      if (!name->empty()) { ++other_textures_; }
    }
    materials_.push_back(std::move(material));
  }
  return true;
}

std::size_t MtlLibrary::find(std::string_view name) const {
  const auto found = index_by_name_.find(name);
  return found == index_by_name_.end() ? materials_.size() : found->second;
}

std::vector<std::string> MtlLibrary::notes() const {
  std::vector<std::string> notes;
  if (colour_textures_ > 0) {
    notes.push_back(
        fmt::format("{} base colour textures left out: their factors are used", colour_textures_));
  }
  if (other_textures_ > 0) {
    notes.push_back(fmt::format("{} other textures left out", other_textures_));
  }
  return notes;
}

}  // namespace preheat
