// Three floats or doubles: glm's types under our names, so that only this file knows the library.
#pragma once

#define GLM_FORCE_CTOR_INIT
#include <glm/geometric.hpp>
#include <glm/vec3.hpp>

namespace preheat {

using Vec3 = glm::vec3;
using Vec3d = glm::dvec3;

}  // namespace preheat
