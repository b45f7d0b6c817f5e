// How many pixels a box covers: the frustum-clipped projection of [P] section 4.
//
// The renderer has no near plane: what it sees is the cone from the eye through the image, or a
// prism in front of an orthographic image. The box's faces are clipped to that in homogeneous
// coordinates, before any division, so that what lies behind the view point is never projected,
// and no corner in the view plane divides by zero. What is left of a convex box is convex, and so
// is its image: the convex hull of the projected corners. All in double, relative to the view's
// origin. A pinhole only: there is no depth of field and no motion to account for.
// Threads: immutable.
#pragma once

#include <cstdint>
#include <vector>

#include "common/aabb.h"
#include "common/render_settings.h"
#include "common/result.h"
#include "common/vec3.h"

namespace preheat {

// In the image: x from -1 at the left to 1 at the right, y from -1 at the bottom to 1 at the top.
struct ScreenPoint {
  double x = 0.0;
  double y = 0.0;
};

class VoxelProjection {
 public:
  // A view that is not finite, has no extent or none that a ray could tell, or whose axes lie in a
  // plane is a usage error. A mirrored view is as good as any.
  [[nodiscard]] static Result<VoxelProjection> create(const View& view, std::uint32_t width,
                                                      std::uint32_t height);

  // What the image shows of the box: a convex polygon, counter-clockwise; fewer than three points
  // for nothing, a point or a line. All of the image if the eye is in the box or on its surface.
  [[nodiscard]] std::vector<ScreenPoint> outline(const Aabb& box) const;

  // The same with the fault of [P] figure 7: a box that lies partly in front of the view plane and
  // partly behind counts as wholly visible. Read as: its corners behind the plane are projected
  // as if they lay as far in front of it.
  [[nodiscard]] std::vector<ScreenPoint> outline_as_printed(const Aabb& box) const;

  // Pixels that an outline covers, parts of pixels included.
  [[nodiscard]] double pixels(const std::vector<ScreenPoint>& outline) const;

  [[nodiscard]] const View& view() const { return view_; }

 private:
  // Coordinates in units of the view's axes: perspective rays reach points with |x| <= w and
  // |y| <= w, orthographic rays those with |x| <= 1, |y| <= 1 and w >= 0.
  struct Homogeneous {
    double x = 0.0;
    double y = 0.0;
    double w = 0.0;
  };
  enum Plane { kRight = 0, kLeft, kTop, kBottom, kFront, kPlaneCount };

  VoxelProjection(const View& view, std::uint32_t width, std::uint32_t height);
  [[nodiscard]] Homogeneous project(const Vec3d& point) const;
  [[nodiscard]] double inside(const Homogeneous& point, int plane) const;
  [[nodiscard]] std::vector<Homogeneous> clipped(std::vector<Homogeneous> polygon) const;
  [[nodiscard]] bool eye_is_in(const Aabb& box) const;

  View view_;
  double pixels_;  // of the image
  // Rows of the inverse of the matrix whose columns are right, up and forward.
  Vec3d x_row_{0.0};
  Vec3d y_row_{0.0};
  Vec3d w_row_{0.0};
};

}  // namespace preheat
