#include "common/render_settings.h"

#include <cmath>

namespace preheat {

View make_view(const Camera& camera, const Frame& frame, std::uint32_t width,
               std::uint32_t height) {
  const double aspect = static_cast<double>(width) / static_cast<double>(height);
  const double half_height = camera.orthographic
                                 ? std::ldexp(camera.height_file * 0.5, frame.scale_exponent)
                                 : std::tan(camera.vertical_fov_rad * 0.5);
  View view;
  view.origin = Vec3(scene_from_file(frame, camera.position_file));
  view.forward = Vec3(camera.forward);
  view.right = Vec3(camera.right * (half_height * aspect));
  view.up = Vec3(camera.up * half_height);
  view.orthographic = camera.orthographic;
  return view;
}

}  // namespace preheat
