#include "cache/voxel_projection.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "common/math.h"

namespace preheat {
namespace {

[[nodiscard]] Vec3d corner_of(const Aabb& box, unsigned corner) {
  return {static_cast<double>((corner & 1U) != 0 ? box.high.x : box.low.x),
          static_cast<double>((corner & 2U) != 0 ? box.high.y : box.low.y),
          static_cast<double>((corner & 4U) != 0 ? box.high.z : box.low.z)};
}

// Corners around each face.
constexpr std::array<std::array<unsigned, 4>, 6> kFaces{
    {{0, 2, 6, 4}, {1, 3, 7, 5}, {0, 1, 5, 4}, {2, 3, 7, 6}, {0, 1, 3, 2}, {4, 5, 7, 6}}};

[[nodiscard]] double turn(const ScreenPoint& a, const ScreenPoint& b, const ScreenPoint& c) {
  return (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
}

// Andrew's monotone chain (1979).
[[nodiscard]] std::vector<ScreenPoint> convex_hull(std::vector<ScreenPoint> points) {
  std::sort(points.begin(), points.end(), [](const ScreenPoint& a, const ScreenPoint& b) {
    return a.x != b.x ? a.x < b.x : a.y < b.y;
  });
  if (points.size() < 3) { return points; }
  std::vector<ScreenPoint> hull;
  const auto add = [&hull](const ScreenPoint& point, std::size_t least) {
    while (hull.size() > least && turn(hull[hull.size() - 2], hull.back(), point) <= 0.0) {
      hull.pop_back();
    }
    hull.push_back(point);
  };
  for (const ScreenPoint& point : points) { add(point, 1); }
  const std::size_t lower = hull.size();
  for (std::size_t i = points.size() - 1; i-- > 0;) { add(points[i], lower); }
  hull.pop_back();  // the first point again
  return hull;
}

[[nodiscard]] std::vector<ScreenPoint> whole_image() {
  return {{-1.0, -1.0}, {1.0, -1.0}, {1.0, 1.0}, {-1.0, 1.0}};
}

// Clips a polygon to `inside` >= 0 (Sutherland and Hodgman 1974).
template <class Point, class Inside, class Mix>
[[nodiscard]] std::vector<Point> clip_to_plane(const std::vector<Point>& polygon, Inside&& inside,
                                               Mix&& mix) {
  std::vector<Point> kept;
  for (std::size_t i = 0; i < polygon.size(); ++i) {
    const Point& from = polygon[i];
    const Point& to = polygon[(i + 1) % polygon.size()];
    const double inside_from = inside(from);
    const double inside_to = inside(to);
    if (inside_from >= 0.0) { kept.push_back(from); }
    if ((inside_from > 0.0 && inside_to < 0.0) || (inside_from < 0.0 && inside_to > 0.0)) {
      kept.push_back(mix(from, to, inside_from / (inside_from - inside_to)));
    }
  }
  return kept;
}

[[nodiscard]] std::vector<ScreenPoint> clipped_to_image(std::vector<ScreenPoint> polygon) {
  for (unsigned plane = 0; plane < 4; ++plane) {
    polygon = clip_to_plane(
        polygon,
        [plane](const ScreenPoint& p) {
          const double at = plane < 2 ? p.x : p.y;
          return plane % 2 == 0 ? 1.0 - at : 1.0 + at;
        },
        [](const ScreenPoint& a, const ScreenPoint& b, double t) {
          return ScreenPoint{a.x + t * (b.x - a.x), a.y + t * (b.y - a.y)};
        });
  }
  return polygon;
}

}  // namespace

Result<VoxelProjection> VoxelProjection::create(const View& view, std::uint32_t width,
                                                std::uint32_t height) {
  if (!is_finite(view.origin) || !is_finite(view.forward) || !is_finite(view.right) ||
      !is_finite(view.up) || width == 0 || height == 0) {
    return fail(ExitCode::kUsage, fmt::format("the view has a value that is not finite, or an "
                                              "image of {}x{} pixels",
                                              width, height));
  }
  constexpr double kExtentMin = 1e-12;
  constexpr double kExtentMax = 1e12;
  const double right = glm::length(Vec3d(view.right));
  const double up = glm::length(Vec3d(view.up));
  const double forward = glm::length(Vec3d(view.forward));
  for (const double extent : {right, up, forward}) {
    if (!(extent >= kExtentMin && extent <= kExtentMax)) {
      return fail(ExitCode::kUsage,
                  fmt::format("the view's axes are {} wide, {} high and {} deep: each must be "
                              "within {}..{}",
                              right, up, forward, kExtentMin, kExtentMax));
    }
  }
  const double volume =
      glm::dot(Vec3d(view.right), glm::cross(Vec3d(view.up), Vec3d(view.forward)));
  if (!(std::abs(volume) > kExtentMin * right * up * forward)) {
    return fail(ExitCode::kUsage, "the view's axes lie in one plane");
  }
  return VoxelProjection(view, width, height);
}

VoxelProjection::VoxelProjection(const View& view, std::uint32_t width, std::uint32_t height)
    : view_(view), pixels_(static_cast<double>(width) * static_cast<double>(height)) {
  const Vec3d right(view.right);
  const Vec3d up(view.up);
  const Vec3d forward(view.forward);
  const double volume = glm::dot(right, glm::cross(up, forward));
  x_row_ = glm::cross(up, forward) / volume;
  y_row_ = glm::cross(forward, right) / volume;
  w_row_ = glm::cross(right, up) / volume;
}

VoxelProjection::Homogeneous VoxelProjection::project(const Vec3d& point) const {
  const Vec3d offset = point - Vec3d(view_.origin);
  return {glm::dot(offset, x_row_), glm::dot(offset, y_row_), glm::dot(offset, w_row_)};
}

double VoxelProjection::inside(const Homogeneous& point, int plane) const {
  const double reach = view_.orthographic ? 1.0 : point.w;
  switch (plane) {
    case kRight:
      return reach - point.x;
    case kLeft:
      return reach + point.x;
    case kTop:
      return reach - point.y;
    case kBottom:
      return reach + point.y;
    default:
      return point.w;
  }
}

std::vector<VoxelProjection::Homogeneous> VoxelProjection::clipped(
    std::vector<Homogeneous> polygon) const {
  for (int plane = 0; plane < kPlaneCount; ++plane) {
    polygon = clip_to_plane(
        polygon, [&](const Homogeneous& p) { return inside(p, plane); },
        [](const Homogeneous& a, const Homogeneous& b, double t) {
          return Homogeneous{a.x + t * (b.x - a.x), a.y + t * (b.y - a.y), a.w + t * (b.w - a.w)};
        });
  }
  return polygon;
}

bool VoxelProjection::eye_is_in(const Aabb& box) const {
  bool is_in = !view_.orthographic;
  for (int axis = 0; axis < 3; ++axis) {
    is_in = is_in && view_.origin[axis] >= box.low[axis] && view_.origin[axis] <= box.high[axis];
  }
  return is_in;
}

std::vector<ScreenPoint> VoxelProjection::outline(const Aabb& box) const {
  if (eye_is_in(box)) { return whole_image(); }
  std::vector<ScreenPoint> points;
  for (const std::array<unsigned, 4>& face : kFaces) {
    std::vector<Homogeneous> polygon;
    for (const unsigned corner : face) { polygon.push_back(project(corner_of(box, corner))); }
    for (const Homogeneous& point : clipped(std::move(polygon))) {
      // Clipping leaves w >= |x| and |y|, so only the eye itself has w = 0: it is met when it lies
      // in the box up to rounding.
      const double w = view_.orthographic ? 1.0 : point.w;
      if (!(w > 0.0)) { return whole_image(); }
      points.push_back({std::clamp(point.x / w, -1.0, 1.0), std::clamp(point.y / w, -1.0, 1.0)});
    }
  }
  return convex_hull(std::move(points));
}

std::vector<ScreenPoint> VoxelProjection::outline_as_printed(const Aabb& box) const {
  if (eye_is_in(box)) { return whole_image(); }
  std::array<Homogeneous, 8> corners{};
  double reach = 0.0;
  double nearest = kInfinity;
  double farthest = -kInfinity;
  for (unsigned corner = 0; corner < corners.size(); ++corner) {
    corners[corner] = project(corner_of(box, corner));
    nearest = std::min(nearest, corners[corner].w);
    farthest = std::max(farthest, corners[corner].w);
    reach = std::max({reach, std::abs(corners[corner].x), std::abs(corners[corner].y)});
  }
  if (!(nearest < 0.0 && farthest > 0.0)) { return outline(box); }
  std::vector<ScreenPoint> points;
  for (const Homogeneous& corner : corners) {
    constexpr double kFlattest = 1e-9;  // a corner in the plane lies far outside the image, finite
    const double w = view_.orthographic ? 1.0 : std::max(std::abs(corner.w), kFlattest * reach);
    points.push_back({corner.x / w, corner.y / w});
  }
  return clipped_to_image(convex_hull(std::move(points)));
}

double VoxelProjection::pixels(const std::vector<ScreenPoint>& outline) const {
  if (outline.size() < 3) { return 0.0; }
  double doubled = 0.0;  // around the first point, so that a small outline keeps its digits
  for (std::size_t i = 1; i + 1 < outline.size(); ++i) {
    doubled += turn(outline[0], outline[i], outline[i + 1]);
  }
  constexpr double kImageArea = 4.0;
  return std::clamp(0.5 * doubled / kImageArea, 0.0, 1.0) * pixels_;
}

}  // namespace preheat
