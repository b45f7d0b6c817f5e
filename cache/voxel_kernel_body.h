// The body of the kernels, compiled once per instruction set: a file includes this after it has
// named its function by PREHEAT_TRACE_VOXEL. Everything here has internal linkage, and no header
// with inline functions of its own is included but the intrinsics, so that no instruction of one
// set can end up in code that runs on another.
#include <immintrin.h>

#include "cache/voxel_kernel.h"

namespace preheat {
namespace {

#if defined(__AVX2__)
__m128 multiply_add(__m128 a, __m128 b, __m128 c) { return _mm_fmadd_ps(a, b, c); }
__m128 multiply_subtract(__m128 a, __m128 b, __m128 c) { return _mm_fmsub_ps(a, b, c); }
__m128 reciprocal(__m128 a) {
  const __m128 guess = _mm_rcp_ps(a);
  return _mm_fmadd_ps(guess, _mm_fnmadd_ps(guess, a, _mm_set1_ps(1.0F)), guess);
}
#else
__m128 multiply_add(__m128 a, __m128 b, __m128 c) { return _mm_add_ps(_mm_mul_ps(a, b), c); }
__m128 multiply_subtract(__m128 a, __m128 b, __m128 c) { return _mm_sub_ps(_mm_mul_ps(a, b), c); }
__m128 reciprocal(__m128 a) {
  const __m128 guess = _mm_rcp_ps(a);
  return _mm_add_ps(guess, _mm_mul_ps(guess, _mm_sub_ps(_mm_set1_ps(1.0F), _mm_mul_ps(guess, a))));
}
#endif

__m128 absolute(__m128 a) { return _mm_andnot_ps(_mm_set1_ps(-0.0F), a); }

// Four vectors, one a lane.
struct Vectors {
  __m128 x;
  __m128 y;
  __m128 z;
};

Vectors operator-(const Vectors& a, const Vectors& b) {
  return {_mm_sub_ps(a.x, b.x), _mm_sub_ps(a.y, b.y), _mm_sub_ps(a.z, b.z)};
}
Vectors operator+(const Vectors& a, const Vectors& b) {
  return {_mm_add_ps(a.x, b.x), _mm_add_ps(a.y, b.y), _mm_add_ps(a.z, b.z)};
}
Vectors all_lanes(const float* v) {
  return {_mm_set1_ps(v[0]), _mm_set1_ps(v[1]), _mm_set1_ps(v[2])};
}
__m128 dot(const Vectors& a, const Vectors& b) {
  return multiply_add(a.x, b.x, multiply_add(a.y, b.y, _mm_mul_ps(a.z, b.z)));
}
Vectors cross(const Vectors& a, const Vectors& b) {
  return {multiply_subtract(a.y, b.z, _mm_mul_ps(a.z, b.y)),
          multiply_subtract(a.z, b.x, _mm_mul_ps(a.x, b.z)),
          multiply_subtract(a.x, b.y, _mm_mul_ps(a.y, b.x))};
}

// Of the two products of edges that give a normal's component, the one that cancels less.
__m128 normal_component(__m128 a1, __m128 b2, __m128 a2, __m128 b1, __m128 c2, __m128 c1) {
  const __m128 ab = _mm_mul_ps(a2, b1);
  const __m128 bc = _mm_mul_ps(b2, c1);
  const __m128 from_ab = multiply_subtract(a1, b2, ab);
  const __m128 from_bc = multiply_subtract(b1, c2, bc);
  const __m128 take_ab = _mm_cmplt_ps(absolute(ab), absolute(bc));
  return _mm_or_ps(_mm_and_ps(take_ab, from_ab), _mm_andnot_ps(take_ab, from_bc));
}
Vectors normal_of_edges(const Vectors& a, const Vectors& b, const Vectors& c) {
  return {normal_component(a.y, b.z, a.z, b.y, c.z, c.y),
          normal_component(a.z, b.x, a.x, b.z, c.x, c.z),
          normal_component(a.x, b.y, a.y, b.x, c.y, c.x)};
}

template <class Index>
const Index* indices_of(const VoxelTree& tree, std::uint32_t triangle) {
  return static_cast<const Index*>(tree.indices) + std::size_t{triangle} * 3;
}

// A corner of four triangles, given where each has its three indices.
template <class Index>
Vectors gather(const float* positions, const Index* const* indices, unsigned corner) {
  __m128 a = _mm_loadu_ps(positions + std::size_t{indices[0][corner]} * 3);
  __m128 b = _mm_loadu_ps(positions + std::size_t{indices[1][corner]} * 3);
  __m128 c = _mm_loadu_ps(positions + std::size_t{indices[2][corner]} * 3);
  __m128 d = _mm_loadu_ps(positions + std::size_t{indices[3][corner]} * 3);
  _MM_TRANSPOSE4_PS(a, b, c, d);
  return {a, b, c};
}

// Tests a group's triangles, the last of the block in place of those behind it; returns the ray's
// new t_far.
template <class Index>
float test_group(const VoxelTree& tree, std::uint32_t group, const Vectors& origin,
                 const Vectors& direction, float t_near, float t_far, KernelHit hit,
                 void* context) {
  const std::uint32_t last = tree.triangle_count - 1;
  std::uint32_t triangles[VoxelTree::kGroupWidth];
  const Index* indices[VoxelTree::kGroupWidth];
  for (std::uint32_t lane = 0; lane < VoxelTree::kGroupWidth; ++lane) {
    const std::uint32_t triangle = group * VoxelTree::kGroupWidth + lane;
    triangles[lane] = triangle < last ? triangle : last;
    indices[lane] = indices_of<Index>(tree, triangles[lane]);
  }
  const Vectors v0 = gather(tree.positions, indices, 0) - origin;
  const Vectors v1 = gather(tree.positions, indices, 1) - origin;
  const Vectors v2 = gather(tree.positions, indices, 2) - origin;
  const Vectors e0 = v2 - v0;
  const Vectors e1 = v0 - v1;
  const Vectors e2 = v1 - v2;
  const __m128 u = dot(cross(e0, v2 + v0), direction);
  const __m128 v = dot(cross(e1, v0 + v1), direction);
  const __m128 w = dot(cross(e2, v1 + v2), direction);
  const __m128 uvw = _mm_add_ps(_mm_add_ps(u, v), w);
  const __m128 slack = _mm_mul_ps(_mm_set1_ps(1.1920929e-07F), absolute(uvw));
  const __m128 lowest = _mm_min_ps(_mm_min_ps(u, v), w);
  const __m128 highest = _mm_max_ps(_mm_max_ps(u, v), w);
  const __m128 inside = _mm_or_ps(_mm_cmpge_ps(lowest, _mm_xor_ps(slack, _mm_set1_ps(-0.0F))),
                                  _mm_cmple_ps(highest, slack));
  if (_mm_movemask_ps(inside) == 0) { return t_far; }

  const Vectors normal = normal_of_edges(e0, e1, e2);
  const __m128 half_slope = dot(normal, direction);
  const __m128 slope = _mm_add_ps(half_slope, half_slope);
  const __m128 half_height = dot(v0, normal);
  const __m128 t = _mm_mul_ps(reciprocal(slope), _mm_add_ps(half_height, half_height));
  const __m128 in_range =
      _mm_and_ps(_mm_cmple_ps(_mm_set1_ps(t_near), t), _mm_cmple_ps(t, _mm_set1_ps(t_far)));
  const __m128 not_parallel = _mm_cmpneq_ps(slope, _mm_setzero_ps());
  int met = _mm_movemask_ps(_mm_and_ps(inside, _mm_and_ps(in_range, not_parallel)));
  if (met == 0) { return t_far; }

  // Below the first the reciprocal would overflow; then the triangle's first corner counts.
  const __m128 invertible = _mm_cmpge_ps(absolute(uvw), _mm_set1_ps(1e-18F));
  const __m128 scale = _mm_and_ps(invertible, reciprocal(uvw));
  const __m128 one = _mm_set1_ps(1.0F);
  alignas(16) float ts[4];
  alignas(16) float us[4];
  alignas(16) float vs[4];
  _mm_store_ps(ts, t);
  _mm_store_ps(us, _mm_min_ps(_mm_mul_ps(u, scale), one));
  _mm_store_ps(vs, _mm_min_ps(_mm_mul_ps(v, scale), one));
  for (; met != 0; met &= met - 1) {
    const auto lane = static_cast<unsigned>(__builtin_ctz(static_cast<unsigned>(met)));
    if (ts[lane] <= t_far) { t_far = hit(context, triangles[lane], ts[lane], us[lane], vs[lane]); }
  }
  return t_far;
}

// Behind the rounding of a slab test, in parts of t.
constexpr float kExitWidening = 1.000001F;

// The children that the ray enters before t_far, one a bit, and where it enters them.
#if defined(__AVX2__)
unsigned enter_children(const VoxelTreeNode& node, const KernelRay& ray, float t_far,
                        float* t_enter) {
  __m256 enter = _mm256_set1_ps(ray.t_near);
  __m256 exit = _mm256_set1_ps(t_far);
  for (unsigned axis = 0; axis < 3; ++axis) {
    const __m256 origin = _mm256_set1_ps(ray.origin[axis]);
    const __m256 reciprocal_axis = _mm256_set1_ps(ray.reciprocal[axis]);
    const __m256 near = _mm256_load_ps(node.faces[ray.near_face[axis]]);
    const __m256 far = _mm256_load_ps(node.faces[ray.far_face[axis]]);
    enter = _mm256_max_ps(enter, _mm256_mul_ps(_mm256_sub_ps(near, origin), reciprocal_axis));
    exit = _mm256_min_ps(exit, _mm256_mul_ps(_mm256_sub_ps(far, origin), reciprocal_axis));
  }
  _mm256_store_ps(t_enter, enter);
  exit = _mm256_mul_ps(exit, _mm256_set1_ps(kExitWidening));
  return static_cast<unsigned>(_mm256_movemask_ps(_mm256_cmp_ps(enter, exit, _CMP_LE_OQ)));
}
#else
unsigned enter_children(const VoxelTreeNode& node, const KernelRay& ray, float t_far,
                        float* t_enter) {
  unsigned entered = 0;
  for (unsigned half = 0; half < VoxelTreeNode::kWidth; half += 4) {
    __m128 enter = _mm_set1_ps(ray.t_near);
    __m128 exit = _mm_set1_ps(t_far);
    for (unsigned axis = 0; axis < 3; ++axis) {
      const __m128 origin = _mm_set1_ps(ray.origin[axis]);
      const __m128 reciprocal_axis = _mm_set1_ps(ray.reciprocal[axis]);
      const __m128 near = _mm_load_ps(node.faces[ray.near_face[axis]] + half);
      const __m128 far = _mm_load_ps(node.faces[ray.far_face[axis]] + half);
      enter = _mm_max_ps(enter, _mm_mul_ps(_mm_sub_ps(near, origin), reciprocal_axis));
      exit = _mm_min_ps(exit, _mm_mul_ps(_mm_sub_ps(far, origin), reciprocal_axis));
    }
    _mm_store_ps(t_enter + half, enter);
    exit = _mm_mul_ps(exit, _mm_set1_ps(kExitWidening));
    entered |= static_cast<unsigned>(_mm_movemask_ps(_mm_cmple_ps(enter, exit))) << half;
  }
  return entered;
}
#endif

// What a pending child needs first is on its way while nearer ones are tested.
template <class Index>
void prefetch(const VoxelTree& tree, std::uint32_t child) {
  const bool leaf = (child & VoxelTree::kLeaf) != 0;
  const void* const from =
      leaf ? static_cast<const void*>(indices_of<Index>(
                 tree, (child & VoxelTree::kFirstGroupMask) * VoxelTree::kGroupWidth))
           : static_cast<const void*>(tree.nodes + child);
  const auto* const bytes = static_cast<const char*>(from);
  _mm_prefetch(bytes, _MM_HINT_T0);
  if (leaf) { return; }
  _mm_prefetch(bytes + 64, _MM_HINT_T0);
  _mm_prefetch(bytes + 128, _MM_HINT_T0);
}

struct Pending {
  float t_enter;
  std::uint32_t child;
};

template <class Index>
void trace_tree(const VoxelTree& tree, const KernelRay& ray, KernelHit hit, void* context) {
  Pending pending[VoxelTree::kDepthMax * (VoxelTreeNode::kWidth - 1) + 1];
  std::size_t pending_count = 0;
  std::uint32_t child = tree.root;
  float t_far = ray.t_far;
  const Vectors origin = all_lanes(ray.origin);
  const Vectors direction = all_lanes(ray.direction);
  for (;;) {
    if ((child & VoxelTree::kLeaf) == 0) {
      const VoxelTreeNode& node = tree.nodes[child];
      alignas(32) float t_enter[VoxelTreeNode::kWidth];
      unsigned entered = enter_children(node, ray, t_far, t_enter);
      if (entered != 0) {
        auto at = static_cast<unsigned>(__builtin_ctz(entered));
        entered &= entered - 1;
        child = node.children[at];
        if (entered == 0) { continue; }
        // The nearest is taken next: the others are put in their places among those just pushed.
        float nearest = t_enter[at];
        const std::size_t first_pushed = pending_count;
        do {
          at = static_cast<unsigned>(__builtin_ctz(entered));
          entered &= entered - 1;
          Pending farther{t_enter[at], node.children[at]};
          if (farther.t_enter < nearest) {
            const Pending swapped{nearest, child};
            nearest = farther.t_enter;
            child = farther.child;
            farther = swapped;
          }
          prefetch<Index>(tree, farther.child);
          std::size_t place = pending_count++;
          while (place > first_pushed && pending[place - 1].t_enter < farther.t_enter) {
            pending[place] = pending[place - 1];
            --place;
          }
          pending[place] = farther;
        } while (entered != 0);
        continue;
      }
    } else {
      const std::uint32_t first = child & VoxelTree::kFirstGroupMask;
      const std::uint32_t groups = (child >> VoxelTree::kLeafGroupsShift & 3U) + 1;
      for (std::uint32_t group = first; group < first + groups; ++group) {
        t_far = test_group<Index>(tree, group, origin, direction, ray.t_near, t_far, hit, context);
        if (t_far < ray.t_near) { return; }
      }
    }
    do {
      if (pending_count == 0) { return; }
      child = pending[--pending_count].child;
    } while (!(pending[pending_count].t_enter <= t_far * kExitWidening));
  }
}

}  // namespace

void PREHEAT_TRACE_VOXEL(const VoxelTree& tree, const KernelRay& ray, KernelHit hit,
                         void* context) {
  if (tree.indices_are_narrow) {
    trace_tree<std::uint16_t>(tree, ray, hit, context);
  } else {
    trace_tree<std::uint32_t>(tree, ray, hit, context);
  }
}

}  // namespace preheat
