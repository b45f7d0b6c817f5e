#include "common/box_clip.h"

namespace preheat {

ClippedTriangle clip_to_box(const std::array<Vec3d, 3>& triangle, const Aabb& box) {
  ClippedTriangle clipped{{triangle[0], triangle[1], triangle[2]}, 3};
  for (int plane = 0; plane < 6 && clipped.count > 0; ++plane) {
    const int axis = plane / 2;
    const double sign = plane % 2 == 0 ? 1.0 : -1.0;
    const auto limit = static_cast<double>(plane % 2 == 0 ? box.low[axis] : box.high[axis]);
    const ClippedTriangle whole = clipped;
    clipped.count = 0;
    for (std::size_t i = 0; i < whole.count; ++i) {
      const Vec3d& from = whole.corners[i];
      const Vec3d& to = whole.corners[(i + 1) % whole.count];
      const double inside_from = sign * (from[axis] - limit);
      const double inside_to = sign * (to[axis] - limit);
      if (inside_from >= 0.0) { clipped.corners[clipped.count++] = from; }
      if ((inside_from > 0.0 && inside_to < 0.0) || (inside_from < 0.0 && inside_to > 0.0)) {
        Vec3d& added = clipped.corners[clipped.count++];
        added = from + (to - from) * (inside_from / (inside_from - inside_to));
        added[axis] = limit;
      }
    }
  }
  return clipped;
}

}  // namespace preheat
