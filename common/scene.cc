#include "common/scene.h"

#include <cmath>

namespace preheat {

Vec3d scene_from_file(const Frame& frame, const Vec3d& point_file) {
  const double scale = std::ldexp(1.0, frame.scale_exponent);
  return (point_file - frame.centre) * scale;
}

}  // namespace preheat
