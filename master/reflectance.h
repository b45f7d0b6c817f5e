// Reflectance at normal incidence of a dielectric in air, and back: F0 = ((n - 1) / (n + 1))^2.
#pragma once

#include <algorithm>
#include <cmath>

#include "common/scene.h"
#include "common/vec3.h"

namespace preheat {

[[nodiscard]] inline float ior_from_reflectance(float reflectance) {
  const float root = std::sqrt(std::clamp(reflectance, 0.0F, 0.9F));
  return (1.0F + root) / (1.0F - root);
}

// Makes a non-metal reflect `reflectance` at normal incidence: the brightest channel gives the
// index, the others tint. Not for materials that refract, whose index is given.
inline void set_specular_reflectance(const Vec3& reflectance, Material& material) {
  const float brightest = std::max({reflectance.x, reflectance.y, reflectance.z});
  if (!(brightest > 0.0F)) {
    material.specular_color = Vec3(0.0F);
    return;
  }
  material.ior = ior_from_reflectance(brightest);
  material.specular_color = reflectance / brightest;
}

}  // namespace preheat
