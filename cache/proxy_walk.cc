#include "cache/proxy_walk.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <string>
#include <utility>

#include "common/voxel_block.h"

namespace preheat {
namespace {

constexpr std::uint32_t kVoxelNodeChildrenMax = 8;
constexpr std::uint32_t kVoxelNodeDepthMax = 24;

// Below this transmittance a ray's further accesses are too few to count.
constexpr float kTransmittanceMin = 1.0F / 512.0F;

// Voxels that a ray enters this close behind a stop hold the stopping surface themselves: voxel
// bounds are grown by kVoxelMargin, so a wall between two voxels is in both.
constexpr float kEntryTolerance = 4.0F * kVoxelMargin;

// A plane is met within this share of its leaf's diagonal, so that rounding opens no seam between
// the planes of neighbouring leaves.
constexpr float kPlaneTolerance = 1e-4F;

// -ln(1 - code/255), with a full face standing for 1/1024 that passes.
const std::array<float, 256>& optical_depths() {
  static const std::array<float, 256> depths = [] {
    std::array<float, 256> values{};
    for (std::size_t code = 0; code < 255; ++code) {
      values[code] = static_cast<float>(-std::log1p(-static_cast<double>(code) / 255.0));
    }
    values[255] = static_cast<float>(std::log(1024.0));
    return values;
  }();
  return depths;
}

// The state of one walk.
class Walker {
 public:
  Walker(const SceneTables& tables, const Proxy& proxy, const Ray& ray, const ProxyOrigin& origin,
         float unstopped, std::span<std::uint64_t> accesses)
      : tables_(tables),
        proxy_(proxy),
        ray_(ray),
        reciprocal_(1.0F / ray.direction.x, 1.0F / ray.direction.y, 1.0F / ray.direction.z),
        nearest_octant_((ray.direction.x < 0.0F ? 1U : 0U) | (ray.direction.y < 0.0F ? 2U : 0U) |
                        (ray.direction.z < 0.0F ? 4U : 0U)),
        origin_(origin),
        unstopped_(unstopped),
        accesses_(accesses) {}

  ProxyStop run() {
    if (origin_.voxel != kNoIndex) { count_access(origin_.voxel, 1.0F); }
    std::array<Entry, kVoxelNodeDepthMax*(kVoxelNodeChildrenMax - 1) + 1> pending;
    std::size_t pending_count = 0;
    if (!tables_.voxel_nodes.empty()) {
      const Interval span = span_in(tables_.voxel_nodes[0].bounds);
      if (!span.is_empty()) { pending[pending_count++] = {span.t_enter, 0}; }
    }
    while (pending_count > 0) {
      const Entry entry = pending[--pending_count];
      if (transmittance_ == 0.0F && entry.t_enter > stopped_at_ + kEntryTolerance) { break; }
      const VoxelNode& node = tables_.voxel_nodes[entry.node];
      if (node.count == 0) {
        enter_voxel(node.first, entry.t_enter);
        continue;
      }
      // Sorted by entry, the nearest last. Few children: insertion is quickest.
      const std::size_t begin = pending_count;
      for (std::uint32_t i = 0; i < node.count; ++i) {
        const Interval span = span_in(tables_.voxel_nodes[node.first + i].bounds);
        if (span.is_empty()) { continue; }
        std::size_t at = pending_count++;
        while (at > begin && pending[at - 1].t_enter < span.t_enter) {
          pending[at] = pending[at - 1];
          --at;
        }
        pending[at] = {span.t_enter, node.first + i};
      }
    }
    return stop_;
  }

 private:
  struct Entry {
    float t_enter = 0.0F;
    std::uint32_t node = 0;
  };

  // As clip() of common/aabb.h, with the divisions done once.
  [[nodiscard]] Interval span_in(const Aabb& box) const {
    float enter = ray_.t_min;
    float exit = ray_.t_max;
    for (int axis = 0; axis < 3; ++axis) {
      const float t_low = (box.low[axis] - ray_.origin[axis]) * reciprocal_[axis];
      const float t_high = (box.high[axis] - ray_.origin[axis]) * reciprocal_[axis];
      const float t_near = reciprocal_[axis] < 0.0F ? t_high : t_low;
      const float t_far = (reciprocal_[axis] < 0.0F ? t_low : t_high) * 1.00000036F;
      enter = enter < t_near ? t_near : enter;
      exit = t_far < exit ? t_far : exit;
    }
    return {enter, exit};
  }

  void count_access(std::uint32_t voxel, float probability) {
    accesses_[voxel] += static_cast<std::uint64_t>(probability * static_cast<float>(kAccessUnit));
  }

  void enter_voxel(std::uint32_t voxel, float t_enter) {
    if (voxel != origin_.voxel) {
      const bool beside_stop = t_enter <= stopped_at_ + kEntryTolerance;
      count_access(voxel, beside_stop ? transmittance_before_ : transmittance_);
    }
    if (transmittance_ > 0.0F) { march(voxel); }
  }

  void march(std::uint32_t voxel) {
    std::array<std::uint32_t, kProxyDepthMax * 7 + 1> pending;
    std::size_t pending_count = 0;
    pending[pending_count++] = proxy_.roots[voxel];
    while (pending_count > 0) {
      const std::uint32_t at = pending[--pending_count];
      const ProxyNode& node = proxy_.nodes[at];
      const Interval span = span_in(node.bounds);
      if (span.is_empty()) { continue; }
      if (node.child_mask == 0) {
        if (at != origin_.node) { cross_leaf(voxel, at, span); }
        if (transmittance_ == 0.0F) { return; }
        continue;
      }
      // XOR with the ray's signs turns octants into front-to-back order; the farthest goes first.
      const unsigned mask = node.child_mask;
      for (unsigned order = 8; order-- > 0;) {
        const unsigned octant = order ^ nearest_octant_;
        if ((mask >> octant & 1U) == 0) { continue; }
        pending[pending_count++] =
            node.first + static_cast<std::uint32_t>(std::popcount(mask & ((1U << octant) - 1U)));
      }
    }
  }

  void cross_leaf(std::uint32_t voxel, std::uint32_t at, const Interval& span) {
    const ProxyNode& node = proxy_.nodes[at];
    const ProxyRecord& record = proxy_.records[node.first];
    if ((record.shape & kShapeFlat) != 0) {
      cross_plane(voxel, at, span, record, node.bounds);
    } else {
      cross_scattered(voxel, at, span, record, node.bounds);
    }
  }

  void cross_plane(std::uint32_t voxel, std::uint32_t at, const Interval& span,
                   const ProxyRecord& record, const Aabb& bounds) {
    const Vec3 normal = decode_normal(record.normal);
    const float offset = record_plane_offset(record, normal, bounds);
    const float rate = glm::dot(normal, ray_.direction);
    const float height = glm::dot(normal, ray_.origin) - offset;
    const float height_enter = height + rate * span.t_enter;
    const float height_exit = height + rate * span.t_exit;
    const float diagonal = glm::length(bounds.extent());
    const float tolerance = kPlaneTolerance * diagonal;
    if (height_enter * height_exit > 0.0F &&
        std::min(std::abs(height_enter), std::abs(height_exit)) > tolerance) {
      return;
    }
    if (span.t_exit == ray_.t_max) {
      const float thickness = diagonal * static_cast<float>(record.thickness) / 65535.0F;
      if (std::abs(height_exit) <= thickness + 2.0F * tolerance) { return; }
    }
    const float t = rate != 0.0F ? std::clamp(-height / rate, span.t_enter, span.t_exit)
                                 : 0.5F * (span.t_enter + span.t_exit);
    const float passing = 1.0F - static_cast<float>(record.coverage[0]) / 255.0F;
    pass(voxel, at, passing, t, t);
  }

  void cross_scattered(std::uint32_t voxel, std::uint32_t at, const Interval& span,
                       const ProxyRecord& record, const Aabb& bounds) {
    if (span.t_exit == ray_.t_max) { return; }
    const Vec3 extent = bounds.extent();
    float density = 0.0F;
    for (int axis = 0; axis < 3; ++axis) {
      const float depth = optical_depths()[record.coverage[static_cast<std::size_t>(axis)]];
      density += std::abs(ray_.direction[axis]) * depth / extent[axis];
    }
    if (density == 0.0F) { return; }
    const float passing = std::exp(-density * (span.t_exit - span.t_enter));
    float t = span.t_enter;
    if (!stop_.is_stopped && transmittance_ * passing <= unstopped_) {
      t = std::min(span.t_exit, span.t_enter + std::log(transmittance_ / unstopped_) / density);
    }
    pass(voxel, at, passing, t, span.t_enter);
  }

  // The ray crosses a leaf that lets `passing` of it through. The walk would stop at t_stop; what
  // is lost counts as lost from t_lost.
  void pass(std::uint32_t voxel, std::uint32_t at, float passing, float t_stop, float t_lost) {
    if (passing >= 1.0F) { return; }
    const float after = transmittance_ * passing;
    if (!stop_.is_stopped && after <= unstopped_) { stop_ = {true, t_stop, {voxel, at}}; }
    if (t_lost > stopped_at_ + kEntryTolerance) {
      stopped_at_ = t_lost;
      transmittance_before_ = transmittance_;
    }
    transmittance_ = after < kTransmittanceMin ? 0.0F : after;
    if (transmittance_ == 0.0F && !stop_.is_stopped) { stop_ = {true, t_stop, {voxel, at}}; }
  }

  const SceneTables& tables_;
  const Proxy& proxy_;
  const Ray& ray_;
  Vec3 reciprocal_;
  unsigned nearest_octant_;
  const ProxyOrigin& origin_;
  float unstopped_;
  std::span<std::uint64_t> accesses_;
  float transmittance_ = 1.0F;
  float transmittance_before_ = 1.0F;  // where it last fell, and where that was
  float stopped_at_ = -kInfinity;
  ProxyStop stop_{};
};

tl::unexpected<Error> mismatch(const char* what) {
  return fail(ExitCode::kStoreDamaged, std::string("scene tables and proxy: ") + what);
}

}  // namespace

ProxyWalk::ProxyWalk(const SceneTables& tables, const Proxy& proxy)
    : tables_(&tables), proxy_(&proxy) {}

Result<ProxyWalk> ProxyWalk::create(const SceneTables& tables, const Proxy& proxy) {
  if (proxy.roots.size() != tables.voxels.size()) {
    return mismatch("they differ in the number of voxels");
  }
  for (const std::uint32_t material : proxy.materials) {
    if (material >= tables.materials.size()) { return mismatch("a material that does not exist"); }
  }
  std::vector<std::uint32_t> depths(tables.voxel_nodes.size(), 0);
  for (std::size_t at = 0; at < tables.voxel_nodes.size(); ++at) {
    const VoxelNode& node = tables.voxel_nodes[at];
    if (node.count == 0) {
      if (node.first >= tables.voxels.size()) { return mismatch("a node without its voxel"); }
      continue;
    }
    const bool in_range = node.first > at && node.first < tables.voxel_nodes.size() &&
                          node.count <= tables.voxel_nodes.size() - node.first;
    if (!in_range || node.count > kVoxelNodeChildrenMax || depths[at] >= kVoxelNodeDepthMax) {
      return mismatch("a node with impossible children");
    }
    for (std::uint32_t i = 0; i < node.count; ++i) { depths[node.first + i] = depths[at] + 1; }
  }
  return ProxyWalk(tables, proxy);
}

ProxyStop ProxyWalk::walk(const Ray& ray, const ProxyOrigin& origin, float unstopped,
                          std::span<std::uint64_t> accesses) const {
  return Walker(*tables_, *proxy_, ray, origin, unstopped, accesses).run();
}

}  // namespace preheat
