// A scene without one of its features, for asking what modelling that feature is worth: a model
// predicts the scene as it would be without it, and is judged by the rays of the scene as it is.
//
// The models themselves know nothing of this: they get other tables and settings. Pure.
#pragma once

#include <cstdint>
#include <vector>

#include "common/render_settings.h"
#include "common/scene_tables.h"

namespace preheat {

enum class SceneTerm : std::uint8_t {
  kShadowRays,  // every light: nothing is lit, so no vertex samples one
  kEmitters,    // each class of lights by itself
  kPointLights,
  kSpotLights,
  kDirectionalLights,
  kEnvironment,
  kSpecular,   // metals and coats, diffuse instead
  kRefraction  // transmission, opaque instead
};

struct AblatedScene {
  SceneTables tables{};
  RenderSettings settings{};
};

// "shadow_rays", "emitters" and so on.
[[nodiscard]] const char* name_of(SceneTerm term);

// Those that this scene has, in the order of SceneTerm.
[[nodiscard]] std::vector<SceneTerm> terms_of(const SceneTables& tables,
                                              const RenderSettings& settings);

[[nodiscard]] AblatedScene without(SceneTerm term, const SceneTables& tables,
                                   const RenderSettings& settings);

}  // namespace preheat
