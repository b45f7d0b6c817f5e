// Small scenes made of random triangles, for tests that compare with brute force.
#pragma once

#include <cstddef>
#include <cstdint>
#include <random>

#include "common/scene.h"

namespace preheat::test {

inline Scene empty_scene() {
  Scene scene;
  scene.materials.emplace_back();
  return scene;
}

// Adds a triangle with vertices of its own.
inline void add_triangle(Scene& scene, const Vec3& a, const Vec3& b, const Vec3& c,
                         std::uint32_t material = 0) {
  const auto first = static_cast<std::uint32_t>(scene.positions.size());
  scene.positions.insert(scene.positions.end(), {a, b, c});
  scene.normals.resize(scene.positions.size(), Vec3(0.0F));
  scene.triangles.push_back({{first, first + 1, first + 2}, material});
}

class SoupRandom {
 public:
  explicit SoupRandom(std::uint32_t seed) : engine_(seed) {}
  float in(float low, float high) {
    return low + (high - low) * (static_cast<float>(engine_() >> 8) * 0x1p-24F);
  }
  Vec3 in_cube(float low, float high) { return {in(low, high), in(low, high), in(low, high)}; }
  std::uint32_t below(std::uint32_t count) { return static_cast<std::uint32_t>(engine_() % count); }

 private:
  std::mt19937 engine_;
};

// Triangles of about `size`, a few of them spanning the scene, some in axis planes, some slivers,
// some lying in the planes of the first splits.
inline Scene soup(std::size_t triangle_count, float size, std::uint32_t seed) {
  Scene scene = empty_scene();
  SoupRandom random(seed);
  while (scene.triangles.size() < triangle_count) {
    const std::uint32_t kind = random.below(20);
    const Vec3 centre = random.in_cube(-0.9F, 0.9F);
    const float reach = kind == 0 ? 0.9F : size;
    Vec3 a = centre + reach * random.in_cube(-1.0F, 1.0F);
    Vec3 b = centre + reach * random.in_cube(-1.0F, 1.0F);
    Vec3 c = centre + reach * random.in_cube(-1.0F, 1.0F);
    if (kind >= 1 && kind <= 3) {  // in an axis plane
      const int axis = static_cast<int>(kind) - 1;
      a[axis] = b[axis] = c[axis] = random.below(2) == 0 ? centre[axis] : 0.0F;
    }
    if (kind == 4) { c = a + 1.00001F * (b - a); }  // collinear up to rounding
    for (Vec3* vertex : {&a, &b, &c}) { *vertex = glm::clamp(*vertex, -1.0F, 1.0F); }
    add_triangle(scene, a, b, c);
  }
  return scene;
}

// A bumpy square of 2 n^2 triangles with shared vertices and normals.
inline Scene sheet(std::uint32_t n) {
  Scene scene = empty_scene();
  const auto at = [n](std::uint32_t i) {
    return 1.8F * static_cast<float>(i) / static_cast<float>(n) - 0.9F;
  };
  for (std::uint32_t y = 0; y <= n; ++y) {
    for (std::uint32_t x = 0; x <= n; ++x) {
      scene.positions.emplace_back(at(x), 0.002F * static_cast<float>(x * 7 % 5 + y * 3 % 4),
                                   at(y));
      scene.normals.emplace_back(0.0F, 1.0F, 0.0F);
    }
  }
  for (std::uint32_t y = 0; y < n; ++y) {
    for (std::uint32_t x = 0; x < n; ++x) {
      const std::uint32_t i = y * (n + 1) + x;
      scene.triangles.push_back({{i, i + n + 1, i + 1}, 0});
      scene.triangles.push_back({{i + 1, i + n + 1, i + n + 2}, 0});
    }
  }
  return scene;
}

// A ball of 8 n^2 facets around the origin, wound so that its normals point outwards; or inwards.
inline Scene ball(std::uint32_t n, float radius = 0.9F, bool is_inside_out = false) {
  Scene scene = empty_scene();
  for (unsigned octant = 0; octant < 8; ++octant) {
    const Vec3 sign((octant & 1U) != 0 ? -1.0F : 1.0F, (octant & 2U) != 0 ? -1.0F : 1.0F,
                    (octant & 4U) != 0 ? -1.0F : 1.0F);
    const auto at = [&](std::uint32_t x, std::uint32_t y) {
      const Vec3 corner(static_cast<float>(x), static_cast<float>(y),
                        static_cast<float>(n - x - y));
      return radius * glm::normalize(sign * corner);
    };
    const auto add = [&](const Vec3& a, const Vec3& b, const Vec3& c) {
      const bool is_outwards = glm::dot(glm::cross(b - a, c - a), a) > 0.0F;
      add_triangle(scene, a, is_outwards != is_inside_out ? b : c,
                   is_outwards != is_inside_out ? c : b);
    };
    for (std::uint32_t y = 0; y < n; ++y) {
      for (std::uint32_t x = 0; x + y < n; ++x) {
        add(at(x, y), at(x + 1, y), at(x, y + 1));
        if (x + y + 2 <= n) { add(at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)); }
      }
    }
  }
  return scene;
}

}  // namespace preheat::test
