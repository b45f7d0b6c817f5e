// Walks rays through a scene's voxels and their proxy trees, front to back, without a triangle.
//
// A walk carries a transmittance: the probability that a real ray comes so far. Every voxel whose
// bounds the ray enters is credited with the transmittance at its entry, which is the expected
// number of accesses; one random number decides where the walk itself stops.
// Threads: a ProxyWalk is immutable; any thread may walk.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "common/proxy.h"
#include "common/ray.h"
#include "common/result.h"
#include "common/scene_tables.h"

namespace preheat {

// A plane is met within this share of its leaf's diagonal, so that rounding opens no seam between
// the planes of neighbouring leaves.
inline constexpr float kPlaneTolerance = 1e-4F;

inline constexpr std::uint32_t kNoIndex = std::numeric_limits<std::uint32_t>::max();

// Where a ray begins: a surface inside this leaf. The leaf does not stop the rays that leave it,
// and its voxel is entered however roughly the proxy places the surface.
struct ProxyOrigin {
  std::uint32_t voxel = kNoIndex;
  std::uint32_t node = kNoIndex;  // into Proxy::nodes
};

struct ProxyStop {
  bool is_stopped = false;
  float t = 0.0F;
  ProxyOrigin leaf{};
};

// The boxes of up to eight children, by coordinate.
struct alignas(16) BoxesOfEight {
  std::array<std::array<float, 8>, 3> low{};
  std::array<std::array<float, 8>, 3> high{};
};

class ProxyWalk {
 public:
  // An error where tables and proxy do not belong together. Both must outlive the walk.
  [[nodiscard]] static Result<ProxyWalk> create(const SceneTables& tables, const Proxy& proxy);

  // `unstopped` in [0,1): the walk stops where the transmittance falls to it or below; 0 = where
  // nothing passes. A ray with an end is not stopped by the surface that it ends at. Adds to
  // `accesses` [voxel_count]. `one_sided` [Proxy::materials], or empty for none: 1 for what stops
  // no ray from behind.
  [[nodiscard]] ProxyStop walk(const Ray& ray, const ProxyOrigin& origin, float unstopped,
                               std::span<double> accesses,
                               std::span<const std::uint8_t> one_sided = {}) const;

 private:
  ProxyWalk(const SceneTables& tables, const Proxy& proxy);

  const SceneTables* tables_;
  const Proxy* proxy_;
  std::vector<BoxesOfEight> children_{};  // [voxel_nodes] of each, unused for leaves
};

}  // namespace preheat
