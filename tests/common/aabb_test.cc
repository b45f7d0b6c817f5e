#include "common/aabb.h"

#include <gtest/gtest.h>
#include <immintrin.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <iostream>
#include <limits>
#include <random>
#include <vector>

#include "tests/scenes/ray_count.h"
#include "tests/scenes/soups.h"

namespace preheat {
namespace {

using test::ray_count;
using test::SoupRandom;

// Coordinates are multiples of 2^-23 in [-1,1]: a difference has 25 bits and its product with a
// direction's 24 is exact in double, so that fractions can be compared without rounding.
float lattice(SoupRandom& random) {
  return static_cast<float>(random.below((1U << 24U) + 1)) * 0x1p-23F - 1.0F;
}

// numerator / denominator, the denominator above zero.
struct Fraction {
  double numerator = 0.0;
  double denominator = 1.0;
};
bool operator<(const Fraction& a, const Fraction& b) {
  return a.numerator * b.denominator < b.numerator * a.denominator;
}

struct ExactSpan {
  bool is_empty = false;
  Fraction enter{0.0, 1.0};
  Fraction exit{8.0, 1.0};  // beyond any box on the lattice
};

// The part of the ray in the closed box, without rounding.
ExactSpan clip_exactly(const Ray& ray, const Aabb& box) {
  ExactSpan span;
  for (int axis = 0; axis < 3; ++axis) {
    const auto direction = static_cast<double>(ray.direction[axis]);
    const auto origin = static_cast<double>(ray.origin[axis]);
    double to_near = static_cast<double>(box.low[axis]) - origin;
    double to_far = static_cast<double>(box.high[axis]) - origin;
    if (direction == 0.0) {
      span.is_empty |= to_near > 0.0 || to_far < 0.0;
      continue;
    }
    if (direction < 0.0) { std::swap(to_near = -to_near, to_far = -to_far); }
    span.enter = std::max(span.enter, Fraction{to_near, std::abs(direction)});
    span.exit = std::min(span.exit, Fraction{to_far, std::abs(direction)});
  }
  span.is_empty |= span.exit < span.enter;
  return span;
}

double value_of(const Fraction& fraction) { return fraction.numerator / fraction.denominator; }

struct HardCases {
  std::size_t inside = 0;           // boxes that the exact ray meets
  std::size_t touched = 0;          // of these, in a single point
  std::size_t flat = 0;             // of these, boxes without extent on an axis
  std::size_t zero_direction = 0;   // of these, by rays parallel to an axis plane
  std::size_t denormal = 0;         // or but for a denormal component
  std::size_t origin_in_plane = 0;  // by rays that start in the plane of one of the box's faces
};

// A ray at a corner, an edge, a face or the inside of the box: exact where it starts from the
// target or runs along axes or diagonals, otherwise within the direction's rounding.
Ray ray_at(const Aabb& box, SoupRandom& random) {
  Vec3 target(0.0F);
  Ray ray;
  for (int axis = 0; axis < 3; ++axis) {
    const std::uint32_t where = random.below(3);
    target[axis] = where == 0   ? box.low[axis]
                   : where == 1 ? box.high[axis]
                                : std::clamp(lattice(random), box.low[axis], box.high[axis]);
    ray.origin[axis] = lattice(random);
  }
  constexpr std::array<float, 6> kTiny{0.0F, -0.0F, 1e-45F, -1e-40F, 1e-37F, -1e-20F};
  switch (random.below(5)) {
    case 0: {  // along an axis, or nearly
      const auto along = static_cast<int>(random.below(3));
      for (int axis = 0; axis < 3; ++axis) {
        ray.direction[axis] = kTiny[random.below(6)];
        if (axis != along) { ray.origin[axis] = target[axis]; }
      }
      ray.direction[along] = ray.origin[along] < target[along] ? 1.0F : -1.0F;
      break;
    }
    case 1: {  // a diagonal through the target, whose steps stay on the lattice
      const float step = static_cast<float>(random.below(1U << 20U)) * 0x1p-23F;
      for (int axis = 0; axis < 3; ++axis) {
        ray.direction[axis] = static_cast<float>(random.below(3)) - 1.0F;
        ray.origin[axis] = target[axis] - step * ray.direction[axis];
      }
      break;
    }
    case 2:  // from the target
      ray.origin = target;
      ray.direction = random.in_cube(-1.0F, 1.0F);
      break;
    case 3:  // in the plane of a face
      ray.origin[static_cast<int>(random.below(3))] = target.x;
      ray.direction = target - ray.origin;
      break;
    default:
      ray.direction = target - ray.origin;
      break;
  }
  return ray;
}

std::vector<Aabb> random_boxes(std::size_t count, SoupRandom& random) {
  std::vector<Aabb> boxes(count);
  for (Aabb& box : boxes) {
    box.extend(Vec3(lattice(random), lattice(random), lattice(random)));
    for (int axis = 0; axis < 3; ++axis) {
      const std::uint32_t kind = random.below(4);
      const float width = kind == 0   ? 0.0F
                          : kind == 1 ? 0x1p-23F
                          : kind == 2 ? 0x1p-7F
                                      : std::abs(lattice(random));
      box.high[axis] = std::min(1.0F, box.low[axis] + width);
    }
  }
  return boxes;
}

void count_hard_case(const Ray& ray, const Aabb& box, const ExactSpan& exact, HardCases& cases) {
  ++cases.inside;
  const bool touched = !(exact.enter < exact.exit);
  cases.touched += touched ? 1U : 0U;
  const Vec3 extent = box.extent();
  cases.flat += std::min({extent.x, extent.y, extent.z}) == 0.0F ? 1U : 0U;
  for (int axis = 0; axis < 3; ++axis) {
    const float direction = ray.direction[axis];
    cases.zero_direction += direction == 0.0F ? 1U : 0U;
    cases.denormal += std::fpclassify(direction) == FP_SUBNORMAL ? 1U : 0U;
    const float origin = ray.origin[axis];
    cases.origin_in_plane += origin == box.low[axis] || origin == box.high[axis] ? 1U : 0U;
  }
}

// Threads that trace flush denormals, those that predict need not.
constexpr unsigned kFlushDenormals = 0x8040;

// A function of its own, so that nothing is computed in the wrong mode.
[[gnu::noinline]] void clip_all(const std::vector<Ray>& rays, const std::vector<Aabb>& boxes,
                                unsigned mode, std::vector<Interval>& spans) {
  const unsigned before = _mm_getcsr();
  _mm_setcsr(before | mode);
  for (std::size_t i = 0; i < boxes.size(); ++i) { spans[i] = clip(rays[i], boxes[i]); }
  _mm_setcsr(before);
}

class Clip : public testing::TestWithParam<unsigned> {};

// 10^6 rays aimed at faces, edges and corners of 1000 boxes: none that meets a box in exact
// arithmetic is lost, and the span found holds the exact one up to the entry's rounding.
TEST_P(Clip, LosesNoRayThatMeetsTheBoxInExactArithmetic) {
  const auto seed = static_cast<std::uint32_t>(std::random_device{}());
  std::cout << "seed=" << seed << '\n';
  SoupRandom random(seed);
  const std::vector<Aabb> boxes = random_boxes(1000, random);
  std::vector<Ray> rays(boxes.size());
  std::vector<Interval> spans(boxes.size());
  constexpr double kGamma3 = 3.0 * 0x1p-24 / (1.0 - 3.0 * 0x1p-24);

  HardCases cases;
  std::size_t lost = 0;
  std::size_t short_exits = 0;
  std::size_t late_entries = 0;
  std::size_t invented = 0;
  for (int round = 0; round < ray_count(1000); ++round) {
    for (std::size_t i = 0; i < boxes.size(); ++i) { rays[i] = ray_at(boxes[i], random); }
    clip_all(rays, boxes, GetParam(), spans);
    for (std::size_t i = 0; i < boxes.size(); ++i) {
      if (rays[i].direction == Vec3(0.0F)) { continue; }
      const ExactSpan exact = clip_exactly(rays[i], boxes[i]);
      if (exact.is_empty) {
        const Aabb larger{boxes[i].low - Vec3(0x1p-18F), boxes[i].high + Vec3(0x1p-18F)};
        invented += !spans[i].is_empty() && clip_exactly(rays[i], larger).is_empty ? 1U : 0U;
        continue;
      }
      count_hard_case(rays[i], boxes[i], exact, cases);
      lost += spans[i].is_empty() ? 1U : 0U;
      const auto exit = static_cast<double>(spans[i].t_exit);
      const auto enter = static_cast<double>(spans[i].t_enter);
      short_exits += exit < value_of(exact.exit) ? 1U : 0U;
      late_entries += enter > value_of(exact.enter) * (1.0 + kGamma3) ? 1U : 0U;
    }
  }

  EXPECT_EQ(lost, 0U);
  EXPECT_EQ(short_exits, 0U);
  EXPECT_EQ(late_entries, 0U);
  EXPECT_EQ(invented, 0U);
  std::cout << cases.inside << " meet, " << cases.touched << " touch, " << cases.flat << " flat, "
            << cases.zero_direction << " zero, " << cases.denormal << " denormal, "
            << cases.origin_in_plane << " from a face's plane\n";
  EXPECT_GT(cases.inside, static_cast<std::size_t>(ray_count(500'000)));
  for (const std::size_t reached :
       {cases.touched, cases.flat, cases.zero_direction, cases.denormal, cases.origin_in_plane}) {
    EXPECT_GT(reached, static_cast<std::size_t>(ray_count(20'000)));
  }
}

INSTANTIATE_TEST_SUITE_P(Denormals, Clip, testing::Values(0U, kFlushDenormals),
                         [](const auto& of) { return of.param == 0 ? "kept" : "flushed"; });

TEST(ClippedRay, KeepsToItsRange) {
  const Aabb box{Vec3(0.0F), Vec3(1.0F)};
  const Vec3 forward(0.0F, 0.0F, 1.0F);
  const auto spans = [&](float z, float t_min, float t_max) {
    return !clip({{0.5F, 0.5F, z}, forward, t_min, t_max}, box).is_empty();
  };
  EXPECT_TRUE(spans(-1.0F, 0.0F, kInfinity));
  EXPECT_TRUE(spans(0.5F, 0.0F, kInfinity));
  EXPECT_TRUE(spans(0.5F, 0.0F, 0.0F));
  EXPECT_TRUE(spans(1.0F, 0.0F, kInfinity)) << "on the exit";
  EXPECT_TRUE(spans(0.0F, 0.0F, 0.0F)) << "on the entry";
  EXPECT_TRUE(spans(-1.0F, 0.0F, 1.0F)) << "ends on the entry";
  EXPECT_TRUE(spans(-1.0F, 2.0F, 3.0F)) << "begins on the exit";
  EXPECT_FALSE(spans(-1.0F, 0.0F, 0.9999F));
  EXPECT_FALSE(spans(-1.0F, 2.0001F, 3.0F));
  EXPECT_FALSE(spans(1.0001F, 0.0F, kInfinity));
  EXPECT_FALSE(spans(0.5F, 0.5F, 0.25F)) << "no range";
}

TEST(ClippedRay, OfAnEmptyBoxIsEmpty) {
  EXPECT_TRUE(clip({Vec3(0.0F), Vec3(0.0F, 0.0F, 1.0F)}, Aabb{}).is_empty());
}

}  // namespace
}  // namespace preheat
