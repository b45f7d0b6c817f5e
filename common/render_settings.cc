#include "common/render_settings.h"

#include <cmath>

#include "common/math.h"

namespace preheat {

View make_view(const Camera& camera, const Frame& frame, std::uint32_t width,
               std::uint32_t height) {
  const double aspect = static_cast<double>(width) / static_cast<double>(height);
  // Not std::tan, whose last bit differs between C libraries: the view reaches every pixel.
  const double half_fov = camera.vertical_fov_rad * 0.5;
  const double half_height = camera.orthographic
                                 ? std::ldexp(camera.height_file * 0.5, frame.scale_exponent)
                                 : sin_of(half_fov) / cos_of(half_fov);
  View view;
  view.origin = Vec3(scene_from_file(frame, camera.position_file));
  view.forward = Vec3(camera.forward);
  view.right = Vec3(camera.right * (half_height * aspect));
  view.up = Vec3(camera.up * half_height);
  view.orthographic = camera.orthographic;
  return view;
}

}  // namespace preheat
