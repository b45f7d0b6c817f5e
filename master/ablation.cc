#include "master/ablation.h"

#include <algorithm>
#include <array>

namespace preheat {
namespace {

constexpr std::array kTerms = {SceneTerm::kShadowRays,        SceneTerm::kEmitters,
                               SceneTerm::kPointLights,       SceneTerm::kSpotLights,
                               SceneTerm::kDirectionalLights, SceneTerm::kEnvironment,
                               SceneTerm::kSpecular,          SceneTerm::kRefraction};

bool has_light(const SceneTables& tables, PunctualLightKind kind) {
  return std::any_of(tables.lights.begin(), tables.lights.end(),
                     [&](const PunctualLight& light) { return light.kind == kind; });
}

bool is_transmitting(const Material& material) {
  return material.metallic < 1.0F && material.transmission > 0.0F;
}

// Glass reflects as well, but that goes with its transmission.
bool is_specular(const Material& material) {
  return material.metallic > 0.0F ||
         (!is_transmitting(material) && material.specular_color != Vec3(0.0F));
}

bool has_material(const SceneTables& tables, bool (*is)(const Material&)) {
  return std::any_of(tables.materials.begin(), tables.materials.end(), is);
}

bool has_term(SceneTerm term, const SceneTables& tables, const RenderSettings& settings) {
  switch (term) {
    case SceneTerm::kShadowRays:
      return !tables.emissive_triangles.empty() || !tables.lights.empty() ||
             settings.sky != Vec3(0.0F);
    case SceneTerm::kEmitters:
      return !tables.emissive_triangles.empty();
    case SceneTerm::kPointLights:
      return has_light(tables, PunctualLightKind::kPoint);
    case SceneTerm::kSpotLights:
      return has_light(tables, PunctualLightKind::kSpot);
    case SceneTerm::kDirectionalLights:
      return has_light(tables, PunctualLightKind::kDirectional);
    case SceneTerm::kEnvironment:
      return settings.sky != Vec3(0.0F);
    case SceneTerm::kSpecular:
      return has_material(tables, is_specular);
    case SceneTerm::kRefraction:
      return has_material(tables, is_transmitting);
  }
  return false;
}

void put_out_emitters(SceneTables& tables) {
  tables.emissive_triangles.clear();
  for (Material& material : tables.materials) { material.emission = Vec3(0.0F); }
}

void remove_lights(SceneTables& tables, PunctualLightKind kind) {
  std::erase_if(tables.lights, [&](const PunctualLight& light) { return light.kind == kind; });
}

void make_diffuse(Material& material) {
  if (!is_specular(material)) { return; }
  material.metallic = 0.0F;
  if (!is_transmitting(material)) { material.specular_color = Vec3(0.0F); }
}

}  // namespace

const char* name_of(SceneTerm term) {
  switch (term) {
    case SceneTerm::kShadowRays:
      return "shadow_rays";
    case SceneTerm::kEmitters:
      return "emitters";
    case SceneTerm::kPointLights:
      return "point_lights";
    case SceneTerm::kSpotLights:
      return "spot_lights";
    case SceneTerm::kDirectionalLights:
      return "directional_lights";
    case SceneTerm::kEnvironment:
      return "environment";
    case SceneTerm::kSpecular:
      return "specular";
    case SceneTerm::kRefraction:
      return "refraction";
  }
  return "";
}

std::vector<SceneTerm> terms_of(const SceneTables& tables, const RenderSettings& settings) {
  std::vector<SceneTerm> terms;
  for (const SceneTerm term : kTerms) {
    if (has_term(term, tables, settings)) { terms.push_back(term); }
  }
  return terms;
}

AblatedScene without(SceneTerm term, const SceneTables& tables, const RenderSettings& settings) {
  AblatedScene scene{tables, settings};
  switch (term) {
    case SceneTerm::kShadowRays:
      put_out_emitters(scene.tables);
      scene.tables.lights.clear();
      scene.settings.sky = Vec3(0.0F);
      break;
    case SceneTerm::kEmitters:
      put_out_emitters(scene.tables);
      break;
    case SceneTerm::kPointLights:
      remove_lights(scene.tables, PunctualLightKind::kPoint);
      break;
    case SceneTerm::kSpotLights:
      remove_lights(scene.tables, PunctualLightKind::kSpot);
      break;
    case SceneTerm::kDirectionalLights:
      remove_lights(scene.tables, PunctualLightKind::kDirectional);
      break;
    case SceneTerm::kEnvironment:
      scene.settings.sky = Vec3(0.0F);
      break;
    case SceneTerm::kSpecular:
      for (Material& material : scene.tables.materials) { make_diffuse(material); }
      break;
    case SceneTerm::kRefraction:
      for (Material& material : scene.tables.materials) { material.transmission = 0.0F; }
      break;
  }
  return scene;
}

}  // namespace preheat
