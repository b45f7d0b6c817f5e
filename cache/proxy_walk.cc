#include "cache/proxy_walk.h"

#include <immintrin.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <string>
#include <utility>

namespace preheat {
namespace {

constexpr std::uint32_t kVoxelNodeChildrenMax = 8;
constexpr std::uint32_t kVoxelNodeDepthMax = 24;

// Below this transmittance a ray's further accesses are too few to count: following it to 1/32 or
// 1/512 takes up to a twentieth or a third more time and moves no total by more than 0.003.
constexpr float kTransmittanceMin = 1.0F / 8.0F;

// Voxels that a ray enters this close behind a stop hold the stopping surface themselves: voxel
// bounds are grown by kVoxelMargin, so a wall between two voxels is in both.
constexpr float kEntryTolerance = 4.0F * kVoxelMargin;

// As far as a ray begins or ends inside occupied blocks of a scattered leaf they do not stop it:
// what it leaves or is sent to is some surface among them, which the blocks know no better than
// their own size, at either side of it.
constexpr float kReachBlocks = 2.0F;

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

// A ray against boxes, three slabs at once. As clip() of common/aabb.h but for rays along a slab,
// whose reciprocal is cut off so that no lane is ever 0 * inf.
class SlabTest {
 public:
  explicit SlabTest(const Ray& ray)
      : reciprocal(cut(1.0F / ray.direction.x), cut(1.0F / ray.direction.y),
                   cut(1.0F / ray.direction.z)),
        t_min_(_mm_set_ss(ray.t_min)),
        t_max_(_mm_set_ss(ray.t_max)),
        origins_(_mm_set_ps(ray.origin.x, ray.origin.z, ray.origin.y, ray.origin.x)),
        reciprocals_(_mm_set_ps(reciprocal.x, reciprocal.z, reciprocal.y, reciprocal.x)) {}

  [[nodiscard]] Interval span(const Aabb& box) const {
    static_assert(sizeof(Aabb) == 6 * sizeof(float));
    const float* const values = &box.low.x;
    const __m128 first = _mm_loadu_ps(values);       // low x y z, high x
    const __m128 second = _mm_loadu_ps(values + 2);  // low z, high x y z
    const __m128 low = _mm_shuffle_ps(first, first, _MM_SHUFFLE(0, 2, 1, 0));
    const __m128 high = _mm_shuffle_ps(second, second, _MM_SHUFFLE(1, 3, 2, 1));
    const __m128 t_low = _mm_mul_ps(_mm_sub_ps(low, origins_), reciprocals_);
    const __m128 t_high = _mm_mul_ps(_mm_sub_ps(high, origins_), reciprocals_);
    __m128 near = _mm_min_ps(t_low, t_high);
    __m128 far = _mm_max_ps(t_low, t_high);
    near = _mm_max_ps(near, _mm_shuffle_ps(near, near, _MM_SHUFFLE(2, 3, 0, 1)));
    far = _mm_min_ps(far, _mm_shuffle_ps(far, far, _MM_SHUFFLE(2, 3, 0, 1)));
    near = _mm_max_ss(_mm_max_ss(near, _mm_movehl_ps(near, near)), t_min_);
    far = _mm_min_ss(far, _mm_movehl_ps(far, far));
    far = _mm_min_ss(_mm_mul_ss(far, _mm_set_ss(kSlabRounding)), t_max_);
    return {_mm_cvtss_f32(near), _mm_cvtss_f32(far)};
  }

  // Bit i: the ray meets box i, and enters it at t_enter[i].
  [[nodiscard]] unsigned meet(const BoxesOfEight& boxes, std::array<float, 8>& t_enter) const {
    unsigned met = 0;
    for (std::size_t half = 0; half < 8; half += 4) {
      __m128 near = broadcast<0>(t_min_);
      __m128 far = _mm_set1_ps(kInfinity);
      const auto clip_axis = [&](const __m128& origin, const __m128& scale, std::size_t axis) {
        const __m128 low = _mm_load_ps(boxes.low[axis].data() + half);
        const __m128 high = _mm_load_ps(boxes.high[axis].data() + half);
        const __m128 t_low = _mm_mul_ps(_mm_sub_ps(low, origin), scale);
        const __m128 t_high = _mm_mul_ps(_mm_sub_ps(high, origin), scale);
        near = _mm_max_ps(near, _mm_min_ps(t_low, t_high));
        far = _mm_min_ps(far, _mm_max_ps(t_low, t_high));
      };
      clip_axis(broadcast<0>(origins_), broadcast<0>(reciprocals_), 0);
      clip_axis(broadcast<1>(origins_), broadcast<1>(reciprocals_), 1);
      clip_axis(broadcast<2>(origins_), broadcast<2>(reciprocals_), 2);
      far = _mm_min_ps(_mm_mul_ps(far, _mm_set1_ps(kSlabRounding)), broadcast<0>(t_max_));
      _mm_storeu_ps(t_enter.data() + half, near);
      met |= static_cast<unsigned>(_mm_movemask_ps(_mm_cmple_ps(near, far))) << half;
    }
    return met;
  }

  Vec3 reciprocal;

 private:
  static constexpr float kSlabRounding = 1.00000036F;

  template <int lane>
  static __m128 broadcast(const __m128& values) {
    return _mm_shuffle_ps(values, values, _MM_SHUFFLE(lane, lane, lane, lane));
  }
  static float cut(float value) { return std::clamp(value, -1e30F, 1e30F); }

  __m128 t_min_;
  __m128 t_max_;
  __m128 origins_;  // x y z x
  __m128 reciprocals_;
};

// The state of one walk.
class Walker {
 public:
  Walker(const SceneTables& tables, const std::vector<BoxesOfEight>& children, const Proxy& proxy,
         const Ray& ray, const ProxyOrigin& origin, float unstopped, std::span<double> accesses,
         std::span<const std::uint8_t> one_sided)
      : tables_(tables),
        children_(children),
        proxy_(proxy),
        ray_(ray),
        slabs_(ray),
        nearest_octant_((ray.direction.x < 0.0F ? 1U : 0U) | (ray.direction.y < 0.0F ? 2U : 0U) |
                        (ray.direction.z < 0.0F ? 4U : 0U)),
        origin_(origin),
        unstopped_(unstopped),
        accesses_(accesses),
        one_sided_(one_sided),
        left_at_(ray.t_min) {}

  ProxyStop run() {
    if (origin_.voxel != kNoIndex) { count_access(origin_.voxel, 1.0F); }
    std::array<Entry, kVoxelNodeDepthMax*(kVoxelNodeChildrenMax - 1) + 1> pending;
    std::size_t pending_count = 0;
    if (!tables_.voxel_nodes.empty()) {
      const Interval span = slabs_.span(tables_.voxel_nodes[0].bounds);
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
      std::array<float, 8> t_enter;
      unsigned met = slabs_.meet(children_[entry.node], t_enter) & ((1U << node.count) - 1U);
      for (; met != 0; met &= met - 1) {
        const auto child = static_cast<unsigned>(std::countr_zero(met));
        std::size_t at = pending_count++;
        while (at > begin && pending[at - 1].t_enter < t_enter[child]) {
          pending[at] = pending[at - 1];
          --at;
        }
        pending[at] = {t_enter[child], node.first + child};
      }
    }
    return stop_;
  }

 private:
  // Of voxel nodes and of proxy nodes, on stacks; without initialisers, as filling a stack for
  // every ray would take longer than walking it.
  struct Entry {
    float t_enter;
    std::uint32_t node;
  };
  struct Crossing {
    float t_enter;
    float t_exit;
    std::uint32_t node;
  };

  void count_access(std::uint32_t voxel, float probability) {
    accesses_[voxel] += static_cast<double>(probability);
  }

  void enter_voxel(std::uint32_t voxel, float t_enter) {
    if (voxel != origin_.voxel) {
      const bool beside_stop = t_enter <= stopped_at_ + kEntryTolerance;
      count_access(voxel, beside_stop ? transmittance_before_ : transmittance_);
    }
    if (transmittance_ > 0.0F) { march(voxel); }
  }

  void march(std::uint32_t voxel) {
    std::array<Crossing, kProxyDepthMax * 7 + 8> pending;
    std::size_t pending_count = 0;
    const std::uint32_t root = proxy_.roots[voxel];
    const Interval whole = slabs_.span(proxy_.nodes[root].bounds);
    if (!whole.is_empty()) { pending[pending_count++] = {whole.t_enter, whole.t_exit, root}; }
    while (pending_count > 0) {
      const Crossing crossing = pending[--pending_count];
      const ProxyNode& node = proxy_.nodes[crossing.node];
      if (node.child_mask == 0) {
        cross_leaf(voxel, crossing.node, {crossing.t_enter, crossing.t_exit});
        if (transmittance_ == 0.0F) { return; }
        continue;
      }
      std::array<Crossing, 8> children;  // by octant
      unsigned crossed = 0;              // by rank from the nearest octant to the farthest
      std::uint32_t child = node.first;
      for (unsigned left = node.child_mask; left != 0; left &= left - 1, ++child) {
        const auto octant = static_cast<unsigned>(std::countr_zero(left));
        const Interval span = slabs_.span(proxy_.nodes[child].bounds);
        children[octant] = {span.t_enter, span.t_exit, child};
        // XOR with the ray's signs turns octants into front-to-back order.
        crossed |= (span.is_empty() ? 0U : 1U) << (octant ^ nearest_octant_);
      }
      for (; crossed != 0; crossed &= ~std::bit_floor(crossed)) {  // the farthest goes first
        const auto rank = static_cast<unsigned>(std::bit_width(crossed)) - 1U;
        pending[pending_count++] = children[rank ^ nearest_octant_];
      }
    }
  }

  void cross_leaf(std::uint32_t voxel, std::uint32_t at, const Interval& span) {
    const ProxyNode& node = proxy_.nodes[at];
    const ProxyRecord& record = proxy_.records[node.first];
    if ((record.shape & kShapeFlat) != 0) {
      const bool is_own = at == origin_.node;
      if (is_own || !cross_plane({voxel, at}, span, record, node.bounds)) {
        leave_through(span, kInfinity);
      }
    } else {
      cross_scattered({voxel, at}, span, record, node.bounds);
    }
  }

  // True if the span is what the ray passes directly behind its origin, without free space between
  // and no farther than `reach`: the surface that it leaves, as roughly as the proxy knows it.
  bool leave_through(const Interval& span, float reach) {
    const bool is_far = span.t_enter > left_at_ + kEntryTolerance || left_at_ - ray_.t_min > reach;
    if (!is_leaving_ || is_far) {
      is_leaving_ = false;
      return false;
    }
    left_at_ = std::max(left_at_, span.t_exit);
    return true;
  }

  // Where a ray at `height` + t * `rate` over a leaf's plane meets it inside the span. Where the
  // plane lies outside the bounds, as that of a wall does which is tilted by what hangs on it, the
  // geometry lies at the face through which it left, unless the ray begins or ends as near as the
  // leaf is large: then it may be its own surface. kInfinity if the ray meets neither.
  [[nodiscard]] float meet_plane(const Interval& span, float height, float rate, float diagonal,
                                 const Aabb& bounds, int axis) const {
    const float height_enter = height + rate * span.t_enter;
    const float height_exit = height + rate * span.t_exit;
    if (height_enter * height_exit <= 0.0F ||
        std::min(std::abs(height_enter), std::abs(height_exit)) <= kPlaneTolerance * diagonal) {
      return rate != 0.0F ? std::clamp(-height / rate, span.t_enter, span.t_exit)
                          : 0.5F * (span.t_enter + span.t_exit);
    }
    const bool is_coming = height_exit * rate < 0.0F;
    const float t = is_coming ? span.t_exit : span.t_enter;
    if (t - ray_.t_min < diagonal || ray_.t_max - t < diagonal) { return kInfinity; }
    const float t_low = (bounds.low[axis] - ray_.origin[axis]) * slabs_.reciprocal[axis];
    const float t_high = (bounds.high[axis] - ray_.origin[axis]) * slabs_.reciprocal[axis];
    const bool is_through_face =
        is_coming ? std::max(t_low, t_high) <= t : std::min(t_low, t_high) >= t;
    return is_through_face ? t : kInfinity;
  }

  // True if rays meet the leaf only where its normal points.
  [[nodiscard]] bool has_one_side(const ProxyRecord& record) const {
    return !one_sided_.empty() && (record.shape & kShapeOriented) != 0 &&
           one_sided_[record.material_major] != 0 && one_sided_[record.material_minor] != 0;
  }

  // True if the ray meets a back, `rate` along the leaf's normal, that does not stop it. For a ray
  // that begins in free space it is a body's outline, some facets of which are turned to the ray as
  // little as their mean is turned away; where that is much, the back is seen indeed.
  [[nodiscard]] bool passes_from_behind(const ProxyRecord& record, float rate) const {
    constexpr float kOutlineMax = 0.7071F;  // 45 degrees
    return rate > 0.0F && (origin_.voxel != kNoIndex || rate < kOutlineMax) && has_one_side(record);
  }

  // False if the ray meets no surface of the leaf's plane.
  bool cross_plane(const ProxyOrigin& leaf, const Interval& span, const ProxyRecord& record,
                   const Aabb& bounds) {
    const Vec3 normal = record_normal(record);
    const float offset = record_plane_offset(record, normal, bounds);
    const float rate = glm::dot(normal, ray_.direction);
    if (passes_from_behind(record, rate)) { return false; }
    const float height = glm::dot(normal, ray_.origin) - offset;
    const float diagonal = glm::length(bounds.extent());
    const FlatAxes axes = flat_axes(normal);
    const float t = meet_plane(span, height, rate, diagonal, bounds, axes.axis);
    if (t == kInfinity) { return false; }
    // A ray that begins or ends among the layers of the same plane, in whichever leaf, is not
    // stopped by them: a lamp lights the ceiling that it hangs from.
    const float layers =
        diagonal * (2.0F * kPlaneTolerance + static_cast<float>(record.thickness) / 255.0F);
    const bool has_end = ray_.t_max < kInfinity;
    if (std::abs(height) <= layers || (has_end && std::abs(height + rate * ray_.t_max) <= layers)) {
      return true;
    }
    const Vec3 place = (ray_.origin + t * ray_.direction - bounds.low) / bounds.extent() * 8.0F;
    const auto u = static_cast<unsigned>(std::clamp(place[axes.u], 0.0F, 7.0F));
    const auto v = static_cast<unsigned>(std::clamp(place[axes.v], 0.0F, 7.0F));
    if ((record_mask(record) >> flat_bit(u, v) & 1U) != 0) {
      pass(leaf, 1.0F - static_cast<float>(record.coverage[0]) / 255.0F, t, t);
    }
    return true;
  }

  // Steps through the leaf's blocks (Amanatides and Woo 1987) and joins occupied ones to runs.
  void cross_scattered(const ProxyOrigin& leaf, const Interval& span, const ProxyRecord& record,
                       const Aabb& bounds) {
    const Vec3 block = bounds.extent() * 0.25F;
    Vec3 along;  // optical depths per distance along each axis
    std::array<float, 3> t_next{};
    std::array<float, 3> t_step{};
    std::array<int, 3> at{};
    const Vec3 place = (ray_.origin + span.t_enter * ray_.direction - bounds.low) / block;
    for (std::size_t i = 0; i < 3; ++i) {
      const int axis = static_cast<int>(i);
      along[axis] =
          std::abs(ray_.direction[axis]) * optical_depths()[record.coverage[i]] / block[axis];
      at[i] = static_cast<int>(std::clamp(place[axis], 0.0F, 3.0F));
      const bool descends = slabs_.reciprocal[axis] < 0.0F;
      const float face =
          bounds.low[axis] + block[axis] * static_cast<float>(at[i] + (descends ? 0 : 1));
      t_next[i] = (face - ray_.origin[axis]) * slabs_.reciprocal[axis];
      if (!(t_next[i] >= span.t_enter)) { t_next[i] = kInfinity; }  // never left along this axis
      t_step[i] = block[axis] * std::abs(slabs_.reciprocal[axis]);
    }
    const float roundness = static_cast<float>(record.thickness) / 255.0F;
    float density =
        roundness * glm::length(along) + (1.0F - roundness) * (along.x + along.y + along.z);
    density *= share_facing(record);
    const std::uint64_t mask = record_mask(record);
    const float reach = kReachBlocks * glm::length(block);
    Interval run{span.t_enter, span.t_enter};  // of occupied blocks, so far
    float t = span.t_enter;
    for (;;) {
      const std::size_t axis = t_next[0] < t_next[1] ? (t_next[0] < t_next[2] ? 0U : 2U)
                                                     : (t_next[1] < t_next[2] ? 1U : 2U);
      const float t_exit = std::min(t_next[axis], span.t_exit);
      const unsigned bit = block_bit(static_cast<unsigned>(at[0]), static_cast<unsigned>(at[1]),
                                     static_cast<unsigned>(at[2]));
      if ((mask >> bit & 1U) == 0) {
        cross_run(leaf, run, density, reach);
        run = {t_exit, t_exit};
      } else if (is_leaving_ && leave_through({t, t_exit}, reach)) {
        run = {t_exit, t_exit};
      } else {
        run.t_exit = t_exit;
      }
      t = t_exit;
      at[axis] += ray_.direction[static_cast<int>(axis)] < 0.0F ? -1 : 1;
      if (t_next[axis] >= span.t_exit || at[axis] < 0 || at[axis] > 3) { break; }
      t_next[axis] += t_step[axis];
    }
    cross_run(leaf, run, density, reach);
  }

  // How much of what a leaf shows along the ray is turned to it. Of a leaf with one side all, where
  // the ray comes straight at the mean normal, and half where it passes across.
  [[nodiscard]] float share_facing(const ProxyRecord& record) const {
    if (!has_one_side(record)) { return 1.0F; }
    const float rate = glm::dot(record_normal(record), ray_.direction);
    return std::clamp(0.5F - 0.5F * rate, 0.0F, 1.0F);
  }

  // A run that ends within `reach` of the ray's end is the surface that it ends at.
  void cross_run(const ProxyOrigin& leaf, const Interval& run, float density, float reach) {
    const float length = run.t_exit - run.t_enter;
    if (!(length * density > 0.0F) || run.t_exit >= ray_.t_max - reach) { return; }
    const float passing = std::exp(-density * length);
    float t = run.t_enter;
    if (!stop_.is_stopped && transmittance_ > 0.0F && transmittance_ * passing <= unstopped_) {
      t = std::min(run.t_exit, run.t_enter + std::log(transmittance_ / unstopped_) / density);
    }
    pass(leaf, passing, t, run.t_enter);
  }

  // The ray crosses geometry that lets `passing` of it through. The walk would stop at t_stop; what
  // is lost counts as lost from t_lost.
  void pass(const ProxyOrigin& leaf, float passing, float t_stop, float t_lost) {
    if (passing >= 1.0F || transmittance_ == 0.0F) { return; }
    const float after = transmittance_ * passing;
    if (!stop_.is_stopped && after <= unstopped_) { stop_ = {true, t_stop, leaf}; }
    if (t_lost > stopped_at_ + kEntryTolerance) {
      stopped_at_ = t_lost;
      transmittance_before_ = transmittance_;
    }
    transmittance_ = after < kTransmittanceMin ? 0.0F : after;
    if (transmittance_ == 0.0F && !stop_.is_stopped) { stop_ = {true, t_stop, leaf}; }
  }

  const SceneTables& tables_;
  const std::vector<BoxesOfEight>& children_;
  const Proxy& proxy_;
  const Ray& ray_;
  SlabTest slabs_;
  unsigned nearest_octant_;
  const ProxyOrigin& origin_;
  float unstopped_;
  std::span<double> accesses_;
  std::span<const std::uint8_t> one_sided_;
  float transmittance_ = 1.0F;
  float transmittance_before_ = 1.0F;  // where it last fell, and where that was
  float stopped_at_ = -kInfinity;
  bool is_leaving_ = true;  // so far only through the surface that the ray begins at
  float left_at_;           // where that surface has been left
  ProxyStop stop_{};
};

tl::unexpected<Error> mismatch(const char* what) {
  return fail(ExitCode::kStoreDamaged, std::string("scene tables and proxy: ") + what);
}

}  // namespace

ProxyWalk::ProxyWalk(const SceneTables& tables, const Proxy& proxy)
    : tables_(&tables), proxy_(&proxy), children_(tables.voxel_nodes.size()) {
  for (std::size_t at = 0; at < children_.size(); ++at) {
    const VoxelNode& node = tables.voxel_nodes[at];
    for (std::size_t child = 0; child < node.count; ++child) {
      const Aabb& bounds = tables.voxel_nodes[node.first + child].bounds;
      for (std::size_t axis = 0; axis < 3; ++axis) {
        children_[at].low[axis][child] = bounds.low[static_cast<int>(axis)];
        children_[at].high[axis][child] = bounds.high[static_cast<int>(axis)];
      }
    }
  }
}

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
                          std::span<double> accesses,
                          std::span<const std::uint8_t> one_sided) const {
  return Walker(*tables_, children_, *proxy_, ray, origin, unstopped, accesses, one_sided).run();
}

}  // namespace preheat
