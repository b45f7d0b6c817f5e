#include "cache/voxel_projection.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <random>

#include "common/math.h"

namespace preheat {
namespace {

constexpr unsigned kSeed = 5;
constexpr int kRays = 100'000;
constexpr std::uint32_t kWidth = 320;
constexpr std::uint32_t kHeight = 200;

View view_of(const Vec3& origin, const Vec3& forward, double tangent, double aspect) {
  View view;
  view.origin = origin;
  view.forward = glm::normalize(forward);
  const OrthonormalFrame frame(view.forward);
  view.right = frame.tangent * static_cast<float>(tangent * aspect);
  view.up = frame.bitangent * static_cast<float>(tangent);
  return view;
}

bool outline_holds(const std::vector<ScreenPoint>& outline, double x, double y) {
  constexpr double kRounding = 1e-7;  // of single-precision axes
  if (outline.size() < 3) { return false; }
  for (std::size_t i = 0; i < outline.size(); ++i) {
    const ScreenPoint& a = outline[i];
    const ScreenPoint& b = outline[(i + 1) % outline.size()];
    const double length = std::hypot(b.x - a.x, b.y - a.y);
    if ((b.x - a.x) * (y - a.y) - (b.y - a.y) * (x - a.x) < -kRounding * length) { return false; }
  }
  return true;
}

struct Ray3d {
  Vec3d origin;
  Vec3d direction;
};

Ray3d primary_ray(const View& view, double x, double y) {
  const Vec3d across = Vec3d(view.right) * x + Vec3d(view.up) * y;
  const Vec3d origin(view.origin);
  const Vec3d forward(view.forward);
  return view.orthographic ? Ray3d{origin + across, forward} : Ray3d{origin, forward + across};
}

// Exact up to rounding in double; a ray along a face counts as a hit.
bool hits(const Ray3d& ray, const Aabb& box) {
  double enter = 0.0;
  double exit = std::numeric_limits<double>::infinity();
  for (int axis = 0; axis < 3; ++axis) {
    const double low = static_cast<double>(box.low[axis]) - ray.origin[axis];
    const double high = static_cast<double>(box.high[axis]) - ray.origin[axis];
    if (ray.direction[axis] == 0.0) {
      if (low > 0.0 || high < 0.0) { return false; }
      continue;
    }
    const double a = low / ray.direction[axis];
    const double b = high / ray.direction[axis];
    enter = std::max(enter, std::min(a, b));
    exit = std::min(exit, std::max(a, b));
  }
  return enter <= exit;
}

double share_of(const VoxelProjection& projection, const std::vector<ScreenPoint>& outline,
                std::uint32_t width = kWidth, std::uint32_t height = kHeight) {
  return projection.pixels(outline) / (static_cast<double>(width) * static_cast<double>(height));
}

// The oracle of all cases: primary rays against the box. The outline's area is the share of rays
// that hit within four standard errors, and every ray that hits lies in the outline.
double expect_as_traced(const View& view, const Aabb& box, int rays = kRays,
                        std::uint32_t width = kWidth, std::uint32_t height = kHeight) {
  const auto projection = VoxelProjection::create(view, width, height);
  EXPECT_TRUE(projection.has_value());
  const std::vector<ScreenPoint> outline = projection->outline(box);
  const double share = share_of(*projection, outline, width, height);
  EXPECT_TRUE(std::isfinite(share));
  EXPECT_GE(share, 0.0);
  EXPECT_LE(share, 1.0);
  std::mt19937_64 random(kSeed);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  int found = 0;
  int outside = 0;
  for (int i = 0; i < rays; ++i) {
    const double x = unit(random);
    const double y = unit(random);
    if (!hits(primary_ray(view, x, y), box)) { continue; }
    ++found;
    outside += outline_holds(outline, x, y) ? 0 : 1;
  }
  const double traced = static_cast<double>(found) / rays;
  const double error = std::sqrt(std::max(share, 1.0 / rays) * (1.0 - share) / rays);
  EXPECT_NEAR(share, traced, 4.0 * error + 1e-9) << "seed " << kSeed;
  EXPECT_EQ(outside, 0) << "rays that hit outside the outline";
  return share;
}

const Aabb kUnitBox{Vec3(-0.5F), Vec3(0.5F)};

// P1
TEST(VoxelProjection, FromInsideABoxIsTheWholeImage) {
  for (const Vec3& eye : {Vec3(0.0F), Vec3(0.4F, -0.3F, 0.2F)}) {
    EXPECT_EQ(expect_as_traced(view_of(eye, {0.3F, -0.2F, 1.0F}, 0.5, 1.6), kUnitBox), 1.0);
  }
}

// P2
TEST(VoxelProjection, OfABoxBehindIsNothing) {
  for (const Vec3& eye : {Vec3(0.0F, 0.0F, 2.0F), Vec3(0.3F, 0.2F, 0.6F)}) {
    EXPECT_EQ(expect_as_traced(view_of(eye, {0.0F, 0.0F, 1.0F}, 0.5, 1.6), kUnitBox), 0.0);
  }
}

// P3: the view plane cuts the box in every way there is. Of the 256 sets of corners a plane can
// leave 104 in front, the threshold functions of three variables; each is met and tested.
TEST(VoxelProjection, CutsABoxAcrossTheViewPlane) {
  SCOPED_TRACE(kSeed);
  std::mt19937_64 random(kSeed);
  std::uniform_real_distribution<float> unit(-1.0F, 1.0F);
  std::array<int, 256> met{};
  int straddling = 0;
  for (int i = 0; i < 6000; ++i) {
    const Vec3 eye(0.9F * unit(random), 0.9F * unit(random), 0.9F * unit(random));
    const Vec3 forward(unit(random), unit(random), unit(random));
    if (glm::length(forward) < 0.1F) { continue; }
    const View view =
        view_of(eye, forward, 0.3 + 0.7 * std::abs(static_cast<double>(unit(random))), 1.6);
    unsigned mask = 0;
    for (unsigned corner = 0; corner < 8; ++corner) {
      const Vec3 at((corner & 1U) != 0 ? 0.5F : -0.5F, (corner & 2U) != 0 ? 0.5F : -0.5F,
                    (corner & 4U) != 0 ? 0.5F : -0.5F);
      mask |= static_cast<unsigned>(glm::dot(at - eye, view.forward) > 0.0F) << corner;
    }
    if (++met[mask] > 2) { continue; }
    expect_as_traced(view, kUnitBox, 20'000);
    straddling += mask != 0 && mask != 255 ? 1 : 0;
  }
  const auto masks = std::count_if(met.begin(), met.end(), [](int count) { return count > 0; });
  EXPECT_EQ(masks, 104);
  EXPECT_GT(straddling, 150);
}

// P4
TEST(VoxelProjection, OfCornersInTheViewPlaneIsFinite) {
  const View ahead = view_of({0.0F, 0.0F, -0.5F}, {0.0F, 0.0F, 1.0F}, 0.5, 1.0);
  const View away = view_of({0.0F, 0.0F, -0.5F}, {0.0F, 0.0F, -1.0F}, 0.5, 1.0);
  const View beside = view_of({2.0F, 0.0F, -0.5F}, {0.0F, 0.0F, 1.0F}, 0.5, 1.0);
  EXPECT_EQ(expect_as_traced(ahead, kUnitBox), 1.0) << "on a face";
  const double back = share_of(*VoxelProjection::create(away, kWidth, kHeight),
                               VoxelProjection::create(away, kWidth, kHeight)->outline(kUnitBox));
  EXPECT_TRUE(back == 0.0 || back == 1.0) << "the limit from either side";
  expect_as_traced(beside, kUnitBox);
  for (const Vec3& corner : {Vec3(0.5F), Vec3(-0.5F, 0.5F, -0.5F), Vec3(0.5F, 0.5F, 0.0F)}) {
    const View view = view_of(corner, -corner, 0.4, 1.3);
    EXPECT_EQ(expect_as_traced(view, kUnitBox), 1.0) << "on a corner or an edge, looking in";
  }
  const View wide = view_of({-0.6F, 0.5F, 0.5F}, {0.0F, 0.0F, 1.0F}, 2.0, 1.0);
  expect_as_traced(wide, kUnitBox);  // four corners exactly in the plane
}

// P5
TEST(VoxelProjection, IsCutAtTheImagesEdge) {
  const View view = view_of({0.0F, 0.0F, -3.0F}, {0.0F, 0.0F, 1.0F}, 0.2, 1.6);
  expect_as_traced(view, kUnitBox);
  expect_as_traced(view, {Vec3(0.7F, -0.2F, 0.0F), Vec3(1.5F, 0.3F, 0.5F)});
  EXPECT_EQ(expect_as_traced(view, {Vec3(3.0F, -0.2F, 0.0F), Vec3(4.0F, 0.3F, 0.5F)}), 0.0);
  EXPECT_EQ(expect_as_traced(view, {Vec3(-9.0F, -9.0F, 0.0F), Vec3(9.0F, 9.0F, 0.5F)}), 1.0);
}

// P6
TEST(VoxelProjection, OfABoxWithoutExtentIsNothingOrItsFace) {
  const View view = view_of({0.0F, 0.0F, -3.0F}, {0.1F, 0.0F, 1.0F}, 0.4, 1.0);
  const auto projection = VoxelProjection::create(view, kWidth, kHeight);
  ASSERT_TRUE(projection);
  const Vec3 at(0.1F);
  EXPECT_EQ(share_of(*projection, projection->outline({at, at})), 0.0);
  EXPECT_NEAR(share_of(*projection, projection->outline({at, at + Vec3(0.4F, 0, 0)})), 0.0, 1e-12);
  const View edge_on = view_of({0.0F, 0.0F, -3.0F}, {0.0F, 0.0F, 1.0F}, 0.4, 1.0);
  expect_as_traced(edge_on, {Vec3(0.0F, -0.5F, -0.5F), Vec3(0.0F, 0.5F, 0.5F)});
  expect_as_traced(view, {Vec3(-0.5F, -0.5F, 0.1F), Vec3(0.5F, 0.5F, 0.1F)});
  EXPECT_EQ(share_of(*projection, projection->outline({view.origin, view.origin})), 1.0);
}

// P7
TEST(VoxelProjection, WorksAtTheEndsOfFieldAspectAndShift) {
  const Aabb speck{Vec3(-1e-4F, -1e-4F, 0.0F), Vec3(1e-4F, 2e-4F, 1e-4F)};
  const auto tangent = [](double degrees) { return std::tan(degrees * kPiDouble / 360.0); };
  expect_as_traced(view_of({0.0F, 0.0F, -1.5F}, {0.0F, 0.0F, 1.0F}, tangent(0.01), 1.0), speck);
  expect_as_traced(view_of({0.0F, 0.0F, -0.51F}, {0.0F, 0.0F, 1.0F}, tangent(179.9), 1.0),
                   kUnitBox);
  expect_as_traced(view_of({0.0F, 0.0F, -0.6F}, {0.0F, 0.3F, 1.0F}, tangent(179.9), 1.6), kUnitBox);
  expect_as_traced(view_of({0.0F, 0.0F, -2.0F}, {0.0F, 0.0F, 1.0F}, 0.5, 1.0), kUnitBox, kRays, 1,
                   1);
  expect_as_traced(view_of({0.0F, 0.0F, -2.0F}, {0.0F, 0.0F, 1.0F}, 1e-4, 65536.0), kUnitBox, kRays,
                   65536, 1);
  View shifted = view_of({0.0F, 0.0F, -2.0F}, {0.0F, 0.0F, 1.0F}, 0.4, 1.0);
  shifted.forward += 0.7F * shifted.right + 0.2F * shifted.up;  // a lens beside the image's middle
  expect_as_traced(shifted, kUnitBox);
  View orthographic = view_of({0.2F, 0.1F, -2.0F}, {0.2F, -0.3F, 1.0F}, 0.6, 1.6);
  orthographic.orthographic = true;
  expect_as_traced(orthographic, kUnitBox);
  orthographic.origin = Vec3(0.1F);  // the plane cuts the box
  expect_as_traced(orthographic, kUnitBox);
  orthographic.origin = Vec3(0.3F, -0.4F, 3.0F);
  EXPECT_EQ(expect_as_traced(orthographic, kUnitBox), 0.0);
}

TEST(VoxelProjection, RefusesAFieldOfNothingAndOfAHalfTurn) {
  for (const float scale : {0.0F, 1e20F, kInfinity, std::numeric_limits<float>::quiet_NaN()}) {
    View view = view_of(Vec3(0.0F), {0.0F, 0.0F, 1.0F}, 0.5, 1.0);
    view.up *= scale;
    const auto projection = VoxelProjection::create(view, kWidth, kHeight);
    ASSERT_FALSE(projection) << scale;
    EXPECT_EQ(projection.error().code, ExitCode::kUsage);
  }
  EXPECT_FALSE(VoxelProjection::create(View{}, 0, 5));
}

// P8
TEST(VoxelProjection, KeepsItsDigitsNearAndFar) {
  const auto expect_area = [](const View& view, const Aabb& box, double expected) {
    const auto projection = VoxelProjection::create(view, kWidth, kHeight);
    EXPECT_NEAR(share_of(*projection, projection->outline(box)), expected, 1e-5 * expected);
  };
  // A square of side s at distance d covers (s / (2 d tangent))^2 of the image.
  const View view = view_of(Vec3(0.0F), {0.0F, 0.0F, 1.0F}, 0.5, 1.0);
  const float tiny = 1e-9F;
  expect_area(view, {Vec3(-0.5F * tiny, -0.5F * tiny, 1.0F), Vec3(0.5F * tiny, 0.5F * tiny, 1.0F)},
              1e-18);
  expect_area(view, {Vec3(0.25F, 0.125F, 1.0F), Vec3(0.25F + 0x1p-20F, 0.125F + 0x1p-20F, 1.0F)},
              std::ldexp(1.0, -40));
  View close = view;
  close.origin = Vec3(0.0F, 0.0F, -0.5F - 1e-6F);
  expect_as_traced(close, kUnitBox);
  View far_away = view;  // an offset that leaves a sixteenth of a unit between coordinates
  far_away.origin = Vec3(1e6F, 1e6F, 1e6F);
  expect_as_traced(far_away, {Vec3(1e6F - 1.0F, 1e6F - 0.5F, 1e6F + 2.0F),
                              Vec3(1e6F + 0.5F, 1e6F + 1.0F, 1e6F + 4.0F)});
}

// P9
TEST(VoxelProjection, RefusesAViewThatIsNoneAndTakesAMirroredOne) {
  View view = view_of({0.0F, 0.0F, -2.0F}, {0.2F, 0.0F, 1.0F}, 0.5, 1.0);
  View flat = view;
  flat.up = flat.right;
  View depthless = view;
  depthless.forward = Vec3(0.0F);
  View lost = view;
  lost.origin.y = std::numeric_limits<float>::quiet_NaN();
  for (const View& bad : {flat, depthless, lost}) {
    const auto projection = VoxelProjection::create(bad, kWidth, kHeight);
    ASSERT_FALSE(projection);
    EXPECT_EQ(projection.error().code, ExitCode::kUsage);
    EXPECT_NE(projection.error().message.find("view"), std::string::npos);
  }
  View mirrored = view;
  mirrored.right = -mirrored.right;
  EXPECT_DOUBLE_EQ(expect_as_traced(mirrored, kUnitBox), expect_as_traced(view, kUnitBox));
}

// P11
TEST(VoxelProjection, OfThePartsOfABoxCoversWhatItCovers) {
  SCOPED_TRACE(kSeed);
  for (const Vec3& eye : {Vec3(0.3F, 0.7F, -1.5F), Vec3(0.1F, 0.2F, 0.1F)}) {
    const View view = view_of(eye, {0.1F, -0.3F, 1.0F}, 0.6, 1.6);
    const auto projection = VoxelProjection::create(view, kWidth, kHeight);
    ASSERT_TRUE(projection);
    std::vector<std::vector<ScreenPoint>> outlines;
    for (unsigned part = 0; part < 64; ++part) {
      const Vec3 low = Vec3(static_cast<float>(part & 3U), static_cast<float>(part >> 2U & 3U),
                            static_cast<float>(part >> 4U)) *
                           0.25F -
                       0.5F;
      outlines.push_back(projection->outline({low, low + 0.25F}));
    }
    std::mt19937_64 random(kSeed);
    std::uniform_real_distribution<double> unit(-1.0, 1.0);
    int found = 0;
    for (int i = 0; i < 20'000; ++i) {
      const double x = unit(random);
      const double y = unit(random);
      if (!hits(primary_ray(view, x, y), kUnitBox)) { continue; }
      ++found;
      EXPECT_TRUE(std::any_of(outlines.begin(), outlines.end(),
                              [&](const auto& outline) { return outline_holds(outline, x, y); }));
    }
    EXPECT_GT(found, 1000);
  }
}

// [P] figure 7: most of a long box lies behind the view plane and beside the image.
TEST(VoxelProjection, AsPrintedSeesBoxesAcrossTheViewPlaneWholly) {
  const View view = view_of(Vec3(0.0F), {0.0F, 0.0F, 1.0F}, 0.5, 1.0);
  const auto projection = VoxelProjection::create(view, kWidth, kHeight);
  ASSERT_TRUE(projection);
  const Aabb across{Vec3(1.0F, -0.5F, -5.0F), Vec3(2.0F, 0.5F, 1.0F)};
  EXPECT_EQ(expect_as_traced(view, across), 0.0);
  const double printed = share_of(*projection, projection->outline_as_printed(across));
  EXPECT_GT(printed, 0.05);
  EXPECT_LE(printed, 1.0);

  const Aabb ahead{Vec3(-0.5F, -0.5F, 1.0F), Vec3(0.5F, 0.5F, 3.0F)};
  EXPECT_EQ(share_of(*projection, projection->outline_as_printed(ahead)),
            share_of(*projection, projection->outline(ahead)));
  const Aabb behind{Vec3(-0.5F, -0.5F, -3.0F), Vec3(0.5F, 0.5F, -1.0F)};
  EXPECT_EQ(share_of(*projection, projection->outline_as_printed(behind)), 0.0);
  const Aabb touching{Vec3(0.5F, -0.5F, -1.0F), Vec3(1.0F, 0.5F, 0.0F)};  // corners in the plane
  EXPECT_TRUE(std::isfinite(share_of(*projection, projection->outline_as_printed(touching))));
}

}  // namespace
}  // namespace preheat
