#include "cache/tracing.h"

#include <immintrin.h>
#include <spdlog/spdlog.h>

#include <atomic>
#include <cmath>
#include <cstring>
#include <mutex>
#include <optional>

#include "cache/renderer.h"
#include "cache/voxel_bvh.h"
#include "common/check.h"

#if __has_include(<embree4/rtcore.h>)
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

namespace preheat {
namespace {

// Written for Embree 4; these few lines make Embree 3 look like it.
#if RTC_VERSION_MAJOR >= 4
using RayContext = RTCRayQueryContext;
void init_context(RayContext& context) { rtcInitRayQueryContext(&context); }
void intersect(RTCScene scene, RayContext& context, RTCRayHit& ray_hit) {
  RTCIntersectArguments arguments;
  rtcInitIntersectArguments(&arguments);
  arguments.context = &context;
  rtcIntersect1(scene, &ray_hit, &arguments);
}
void occluded(RTCScene scene, RayContext& context, RTCRay& ray) {
  RTCOccludedArguments arguments;
  rtcInitOccludedArguments(&arguments);
  arguments.context = &context;
  rtcOccluded1(scene, &ray, &arguments);
}
#else
using RayContext = RTCIntersectContext;
void init_context(RayContext& context) { rtcInitIntersectContext(&context); }
void intersect(RTCScene scene, RayContext& context, RTCRayHit& ray_hit) {
  rtcIntersect1(scene, &context, &ray_hit);
}
void occluded(RTCScene scene, RayContext& context, RTCRay& ray) {
  rtcOccluded1(scene, &context, &ray);
}
#endif

// The candidates' window behind the best hit: 16 ulp of t for the rounding of t itself, and 2^-21
// scene units for that of coordinates of magnitude 1.
constexpr float kWindowRelative = 1.9073486328125e-06F;
constexpr float kWindowAbsolute = 4.76837158203125e-07F;

float widened(float t) { return t * (1.0F + kWindowRelative) + kWindowAbsolute; }
float half_widened(float t) { return t * (1.0F + 0.5F * kWindowRelative) + 0.5F * kWindowAbsolute; }

// True if a hit at t lies so clearly before the entry that nothing inside can be nearer.
bool is_before(float t, float t_enter) { return widened(t) < t_enter; }

// A query's state that the callbacks reach through Embree's context pointer.
struct QueryContext : RayContext {
  const Residency::Impl* residency = nullptr;
  RayQuery* query = nullptr;
  VoxelUses* uses = nullptr;
  unsigned parallel_axes = 0;  // bit i: the ray runs (almost) parallel to the faces of axis i
  Vec3 reciprocal{0.0F};       // of the direction on the other axes
  std::optional<KernelRay> kernel_ray{};  // made when the first resident voxel is met
  // The best hit's place, while its mesh is pinned by the guard.
  const MeshArrays* arrays = nullptr;
  std::uint32_t primitive = 0;
  float u = 0.0F;
  float v = 0.0F;
};

Vec3 vertex_at(const MeshArrays& arrays, std::uint32_t primitive, unsigned corner) {
  const std::size_t vertex = arrays.indices[std::size_t{primitive} * 3 + corner];
  return {arrays.positions[vertex * 3], arrays.positions[vertex * 3 + 1],
          arrays.positions[vertex * 3 + 2]};
}

// Below this a direction's component is taken as parallel: over a scene's length such a ray leaves
// a face by less than the rounding of a coordinate.
constexpr float kParallelComponent = 9.5367431640625e-07F;

unsigned parallel_axes(const Vec3& direction) {
  unsigned axes = 0;
  for (int axis = 0; axis < 3; ++axis) {
    axes |= std::abs(direction[axis]) < kParallelComponent ? 1U << axis : 0U;
  }
  return axes;
}

// A ray that lies exactly in the far face of a box leaves it at t = 0 by Embree's slab test, and a
// hit of a triangle that touches this face is then found or not as the layout has it. So a hit
// counts only if the slab test of the triangle's own box admits it on the parallel axes: every box
// around the triangle then admits it too, as the test is monotone in the box.
bool own_box_admits(const QueryContext& context, const MeshArrays& arrays, std::uint32_t primitive,
                    float t) {
  constexpr float kReciprocalMax = 1e18F;  // Embree's bound on 1 / 0
  const Vec3 a = vertex_at(arrays, primitive, 0);
  const Vec3 b = vertex_at(arrays, primitive, 1);
  const Vec3 c = vertex_at(arrays, primitive, 2);
  for (int axis = 0; axis < 3; ++axis) {
    if ((context.parallel_axes >> axis & 1U) == 0) { continue; }
    const float direction = context.query->ray.direction[axis];
    const float reciprocal = std::min(1.0F / std::abs(direction), kReciprocalMax) *
                             (std::signbit(direction) ? -1.0F : 1.0F);
    const float origin = context.query->ray.origin[axis];
    const float t_low = (std::min({a[axis], b[axis], c[axis]}) - origin) * reciprocal;
    const float t_high = (std::max({a[axis], b[axis], c[axis]}) - origin) * reciprocal;
    if (!(std::min(t_low, t_high) <= t && t <= std::max(t_low, t_high))) { return false; }
  }
  return true;
}

// Where the ray enters and leaves the triangle's own box, by the axes that it is not parallel to.
Interval own_box_span(const QueryContext& context, const MeshArrays& arrays,
                      std::uint32_t primitive) {
  const Vec3 a = vertex_at(arrays, primitive, 0);
  const Vec3 b = vertex_at(arrays, primitive, 1);
  const Vec3 c = vertex_at(arrays, primitive, 2);
  const Vec3 low = (glm::min(glm::min(a, b), c) - context.query->ray.origin) * context.reciprocal;
  const Vec3 high = (glm::max(glm::max(a, b), c) - context.query->ray.origin) * context.reciprocal;
  Interval span{-kInfinity, kInfinity};
  for (int axis = 0; axis < 3; ++axis) {
    if ((context.parallel_axes >> axis & 1U) != 0) { continue; }
    span.t_enter = std::max(span.t_enter, std::min(low[axis], high[axis]));
    span.t_exit = std::min(span.t_exit, std::max(low[axis], high[axis]));
  }
  return span;
}

// Of a slab test's exit, behind which an entry means a miss: its rounding (pbrt-v4 section 6.1.2: 1
// + 2 gamma(3)). Embree's robust boxes and voxel_kernel_body.h allow for twice as much and more.
constexpr float kSlabRounding = 1.00000036F;

// The t by which a hit is compared; nothing if it does not count. A triangle that a ray grazes or
// passes within its edge's rounding can be met where the ray is not in the triangle's own box, and
// whether larger boxes around it are entered in time is then the layout's choice. So a hit whose
// own box is missed or lies outside the ray's range does not count, and none is nearer than its
// box: whatever counts lies behind the entry of every box around it.
std::optional<float> settled(const QueryContext& context, const MeshArrays& arrays,
                             std::uint32_t primitive, float t) {
  if (context.parallel_axes != 0 && !own_box_admits(context, arrays, primitive, t)) {
    return std::nullopt;
  }
  const Interval span = own_box_span(context, arrays, primitive);
  const float nearest = span.t_enter > half_widened(t) ? span.t_enter : t;
  const Ray& ray = context.query->ray;
  if (span.t_enter > span.t_exit * kSlabRounding || nearest > ray.t_max ||
      span.t_enter > ray.t_max || span.t_exit < ray.t_min) {
    return std::nullopt;
  }
  return nearest;
}

// The best triangle so far. Looked up when needed, as its line is rarely at hand.
std::uint32_t best_triangle(const QueryContext& context) {
  return context.arrays == nullptr ? context.query->triangle_best
                                   : context.arrays->triangles[context.primitive];
}

bool is_lowest(const QueryContext& context, const MeshArrays& arrays, std::uint32_t primitive,
               float t) {
  const float t_best = context.query->t_best;
  return t < t_best || (t == t_best && arrays.triangles[primitive] < best_triangle(context));
}

// Keeps the hit if it counts and is the lowest; returns how far candidates may lie from now on.
float keep_lowest(QueryContext& context, const MeshArrays& arrays, std::uint32_t primitive, float t,
                  float u, float v) {
  RayQuery& query = *context.query;
  // What is settled is never nearer.
  if (is_lowest(context, arrays, primitive, t)) {
    const std::optional<float> t_settled = settled(context, arrays, primitive, t);
    if (t_settled && is_lowest(context, arrays, primitive, *t_settled)) {
      query.t_best = *t_settled;
      context.arrays = &arrays;
      context.primitive = primitive;
      // The surface is likely to be asked for, and its lines are far.
      _mm_prefetch(&arrays.indices[std::size_t{primitive} * 3], _MM_HINT_T0);
      _mm_prefetch(&arrays.materials[primitive], _MM_HINT_T0);
      _mm_prefetch(&arrays.triangles[primitive], _MM_HINT_T0);
      context.u = u;
      context.v = v;
    }
  }
  return std::min(widened(query.t_best), query.ray.t_max);
}

void refuse_unsettled_blocker(const RTCFilterFunctionNArguments* arguments) {
  const auto& context = *static_cast<const QueryContext*>(arguments->context);
  const auto& arrays = *static_cast<const MeshArrays*>(arguments->geometryUserPtr);
  const auto& ray = *reinterpret_cast<const RTCRay*>(arguments->ray);
  const auto& hit = *reinterpret_cast<const RTCHit*>(arguments->hit);
  if (!settled(context, arrays, hit.primID, ray.tfar)) { arguments->valid[0] = 0; }
}

void filter_closest(const RTCFilterFunctionNArguments* arguments) {
  auto& context = *static_cast<QueryContext*>(arguments->context);
  const auto& arrays = *static_cast<const MeshArrays*>(arguments->geometryUserPtr);
  auto& ray = *reinterpret_cast<RTCRay*>(arguments->ray);
  const auto& hit = *reinterpret_cast<const RTCHit*>(arguments->hit);
  ray.tfar = keep_lowest(context, arrays, hit.primID, ray.tfar, hit.u, hit.v);
}

RTCGeometry new_triangle_geometry(RTCDevice device, const MeshArrays& arrays) {
  RTCGeometry embree = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
  rtcSetSharedGeometryBuffer(embree, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                             arrays.positions.data(), 0, 3 * sizeof(float),
                             arrays.positions.size() / 3);
  rtcSetSharedGeometryBuffer(embree, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                             arrays.indices.data(), 0, 3 * sizeof(std::uint32_t),
                             arrays.triangles.size());
  rtcSetGeometryUserData(embree, const_cast<MeshArrays*>(&arrays));
  rtcSetGeometryIntersectFilterFunction(embree, filter_closest);
  rtcSetGeometryOccludedFilterFunction(embree, refuse_unsettled_blocker);
  rtcSetGeometryMask(embree, 0xFFFFFFFFU);
  rtcCommitGeometry(embree);
  return embree;
}

// Up to where candidates may lie, knowing what is known.
float t_far_of(const RayQuery& query) {
  if (query.any_hit || !query.has_hit()) { return query.ray.t_max; }
  return std::min(widened(query.t_best), query.ray.t_max);
}

RTCRay make_ray(const RayQuery& query) {
  RTCRay ray{};
  ray.org_x = query.ray.origin.x;
  ray.org_y = query.ray.origin.y;
  ray.org_z = query.ray.origin.z;
  ray.dir_x = query.ray.direction.x;
  ray.dir_y = query.ray.direction.y;
  ray.dir_z = query.ray.direction.z;
  ray.tnear = query.ray.t_min;
  ray.tfar = t_far_of(query);
  ray.mask = 0xFFFFFFFFU;
  return ray;
}

void note_missing(RayQuery& query, const MissingVoxel& missing) {
  std::size_t place = query.missing_count;
  if (place == RayQuery::kMissingMax) {
    query.missing_overflow = true;
    if (!(missing < query.missing.back())) { return; }
    --place;
  } else {
    ++query.missing_count;
  }
  while (place > 0 && missing < query.missing[place - 1]) {
    query.missing[place] = query.missing[place - 1];
    --place;
  }
  query.missing[place] = missing;
}

void pop_missing(RayQuery& query) {
  std::copy(query.missing.begin() + 1, query.missing.begin() + query.missing_count,
            query.missing.begin());
  --query.missing_count;
}

Vec3 shading_normal(const MeshArrays& arrays, std::uint32_t primitive,
                    const std::array<float, 3>& weights, const Vec3& normal_geometric) {
  if (arrays.normals.empty()) { return normal_geometric; }
  Vec3 sum(0.0F);
  for (unsigned corner = 0; corner < 3; ++corner) {
    const std::uint32_t code = arrays.normals[arrays.indices[std::size_t{primitive} * 3 + corner]];
    if (code == 0) { return normal_geometric; }
    sum += decode_normal(code) * weights[corner];
  }
  const float length_squared = glm::dot(sum, sum);
  if (!(length_squared > 1e-12F)) { return normal_geometric; }
  const Vec3 normal = sum / std::sqrt(length_squared);
  return glm::dot(normal, normal_geometric) < 0.0F ? -normal : normal;
}

void fill_surface(const QueryContext& context, RayQuery& query) {
  query.triangle_best = best_triangle(context);
  query.surface =
      surface_of(*context.arrays, context.primitive, query.t_best, context.u, context.v);
}

// Embree aborts on any other ray, and none of them meets anything: coordinates are numbers within
// the range whose squares float has, and the range of t is one.
bool is_traceable(const Ray& ray) {
  constexpr float kCoordinateMax = 1e18F;
  const auto is_number = [](float coordinate) { return std::abs(coordinate) <= kCoordinateMax; };
  return is_number(ray.origin.x) && is_number(ray.origin.y) && is_number(ray.origin.z) &&
         is_number(ray.direction.x) && is_number(ray.direction.y) && is_number(ray.direction.z) &&
         ray.t_min >= 0.0F && ray.t_min <= ray.t_max;
}

const char* choose_isa() { return __builtin_cpu_supports("avx2") ? "avx2" : "sse4.2"; }

}  // namespace

// Error bounds as pbrt-v4 section 6.8.4, equation 6.25: gamma(7) times the sum of magnitudes.
SurfaceHit surface_of(const MeshArrays& arrays, std::uint32_t primitive, float t, float u,
                      float v) {
  const std::array<float, 3> weights{1.0F - u - v, u, v};
  const Vec3 a = vertex_at(arrays, primitive, 0);
  const Vec3 b = vertex_at(arrays, primitive, 1);
  const Vec3 c = vertex_at(arrays, primitive, 2);
  SurfaceHit surface;
  surface.position = a * weights[0] + b * weights[1] + c * weights[2];
  const Vec3 magnitude =
      glm::abs(a * weights[0]) + glm::abs(b * weights[1]) + glm::abs(c * weights[2]);
  constexpr float kGamma7 = 4.1723277e-07F;
  surface.position_error = kGamma7 * std::max({magnitude.x, magnitude.y, magnitude.z});
  // In double, as the cross product of small edges would lose its bits or underflow in float.
  const Vec3d normal = glm::cross(Vec3d(b) - Vec3d(a), Vec3d(c) - Vec3d(a));
  const double length = std::sqrt(glm::dot(normal, normal));
  surface.normal_geometric = Vec3(normal / length);
  surface.normal_shading = shading_normal(arrays, primitive, weights, surface.normal_geometric);
  surface.distance = t;
  surface.triangle = arrays.triangles[primitive];
  surface.material = arrays.materials[primitive];
  return surface;
}

const char* tracing_isa() {
  static const char* const isa = choose_isa();
  return isa;
}

struct TracingDevice::Impl {
  RTCDevice device = nullptr;
  std::atomic<std::int64_t> bytes{0};
  std::atomic<std::int64_t> bytes_peak{0};
  std::mutex error_mutex;
  std::string error;
};

namespace {

bool count_memory(void* user, ssize_t bytes, bool /*post*/) {
  auto& impl = *static_cast<TracingDevice::Impl*>(user);
  const std::int64_t now = impl.bytes.fetch_add(bytes, std::memory_order_relaxed) + bytes;
  std::int64_t peak = impl.bytes_peak.load(std::memory_order_relaxed);
  while (now > peak && !impl.bytes_peak.compare_exchange_weak(peak, now)) {}
  return true;
}

void keep_error(void* user, RTCError code, const char* text) {
  auto& impl = *static_cast<TracingDevice::Impl*>(user);
  const std::lock_guard lock(impl.error_mutex);
  spdlog::error("event=embree_error code={} text=\"{}\"", static_cast<int>(code), text);
  if (impl.error.empty()) { impl.error = text; }
}

}  // namespace

TracingDevice::TracingDevice(unsigned build_threads) : impl_(std::make_unique<Impl>()) {
  const std::string config = std::string("isa=") + tracing_isa() +
                             ",threads=" + std::to_string(build_threads) +
                             ",set_affinity=0,start_threads=0";
  impl_->device = rtcNewDevice(config.c_str());
  CHECK(impl_->device != nullptr);
  rtcSetDeviceErrorFunction(impl_->device, keep_error, impl_.get());
  rtcSetDeviceMemoryMonitorFunction(impl_->device, count_memory, impl_.get());
}

TracingDevice::~TracingDevice() { rtcReleaseDevice(impl_->device); }

std::uint64_t TracingDevice::bytes() const {
  return static_cast<std::uint64_t>(std::max<std::int64_t>(0, impl_->bytes.load()));
}
std::uint64_t TracingDevice::bytes_peak() const {
  return static_cast<std::uint64_t>(std::max<std::int64_t>(0, impl_->bytes_peak.load()));
}
void TracingDevice::reset_peak() { impl_->bytes_peak.store(impl_->bytes.load()); }
std::string TracingDevice::take_error() {
  const std::lock_guard lock(impl_->error_mutex);
  return std::exchange(impl_->error, {});
}

HotMesh::HotMesh(const SceneTables& tables, std::span<const VoxelId> voxels) {
  std::size_t triangle_count = 0;
  std::size_t vertex_bytes = 0;
  for (const VoxelId voxel : voxels) {
    const VoxelEntry& entry = tables.voxels[index_of(voxel)];
    triangle_count += entry.triangle_count;
    vertex_bytes += entry.block_bytes - voxel_block_bytes(0, entry.triangle_count, false);
  }
  // A vertex takes 12 bytes without a normal and 16 with one; blocks of both kinds may be mixed.
  positions_.reserve(vertex_bytes / sizeof(float) + 4);
  indices_.reserve(triangle_count * 3);
  triangles_.reserve(triangle_count);
  materials_.reserve(triangle_count);
  if (!voxels.empty()) { seen_.resize(tables.triangle_count); }
}

void HotMesh::add(const VoxelBlockView& block) {
  const auto vertex_offset = static_cast<std::uint32_t>(positions_.size() / 3);
  const std::size_t vertex_count = block.positions.size() / 3;
  positions_.insert(positions_.end(), block.positions.begin(), block.positions.end());
  if (!block.normals.empty() && !has_normals_) {
    has_normals_ = true;
    normals_.reserve(positions_.capacity() / 3);
    normals_.resize(vertex_offset);
  }
  if (has_normals_) {
    if (block.normals.empty()) {
      normals_.resize(vertex_offset + vertex_count);
    } else {
      normals_.insert(normals_.end(), block.normals.begin(), block.normals.end());
    }
  }
  for (std::size_t index = 0; index < block.triangles.size(); ++index) {
    const std::uint32_t triangle = block.triangles[index];
    if (seen_[triangle]) { continue; }
    seen_[triangle] = true;
    for (std::size_t corner = 0; corner < 3; ++corner) {
      indices_.push_back(block.indices[index * 3 + corner] + vertex_offset);
    }
    triangles_.push_back(triangle);
    materials_.push_back(block.materials[index]);
  }
}

MeshArrays HotMesh::arrays() const {
  return {positions_, normals_, indices_, triangles_, materials_};
}

std::uint64_t HotMesh::bytes() const {
  return positions_.capacity() * sizeof(float) +
         (normals_.capacity() + indices_.capacity() + triangles_.capacity() +
          materials_.capacity()) *
             sizeof(std::uint32_t) +
         seen_.capacity() / 8;
}

struct Residency::Impl {
  const SceneTables* tables = nullptr;
  ResidentTable* resident = nullptr;
  std::vector<VoxelId> cold{};  // user primitive -> voxel
  MeshArrays hot_arrays{};
  RTCScene scene = nullptr;
};

namespace {

void box_bounds(const RTCBoundsFunctionArguments* arguments) {
  const auto& residency = *static_cast<const Residency::Impl*>(arguments->geometryUserPtr);
  const Aabb& box = residency.tables->voxels[index_of(residency.cold[arguments->primID])].bounds;
  RTCBounds& bounds = *arguments->bounds_o;
  bounds.lower_x = box.low.x;
  bounds.lower_y = box.low.y;
  bounds.lower_z = box.low.z;
  bounds.upper_x = box.high.x;
  bounds.upper_y = box.high.y;
  bounds.upper_z = box.high.z;
}

// What a kernel reports to.
struct MeshQuery {
  QueryContext& context;
  const MeshArrays& arrays;
  float t_far;
};

float on_closest(void* user, std::uint32_t primitive, float t, float u, float v) {
  auto& query = *static_cast<MeshQuery*>(user);
  query.t_far = keep_lowest(query.context, query.arrays, primitive, t, u, v);
  return query.t_far;
}

float on_blocker(void* user, std::uint32_t primitive, float t, float /*u*/, float /*v*/) {
  auto& query = *static_cast<MeshQuery*>(user);
  if (settled(query.context, query.arrays, primitive, t)) { query.t_far = -kInfinity; }
  return query.t_far;
}

// Tests a resident voxel's triangles up to t_far. Returns the t_far to go on with, -infinity for an
// any-hit ray that is blocked.
float query_mesh(QueryContext& context, const VoxelMesh& mesh, float t_far) {
  static const VoxelKernel kernel = voxel_kernel();
  if (!context.kernel_ray) { context.kernel_ray = kernel_ray(context.query->ray, t_far); }
  context.kernel_ray->t_far = t_far;
  MeshQuery query{context, mesh.arrays(), t_far};
  kernel(mesh.tree(), *context.kernel_ray, context.query->any_hit ? on_blocker : on_closest,
         &query);
  return query.t_far;
}

// The resident mesh of a cold voxel that the ray enters, or nullptr with the voxel noted or
// outside.
const VoxelMesh* enter_voxel(QueryContext& context, std::uint32_t primitive, const RTCRay& ray) {
  const Residency::Impl& residency = *context.residency;
  const VoxelId voxel = residency.cold[primitive];
  if (const VoxelMesh* mesh = residency.resident->lookup(voxel)) {
    context.uses->add(voxel);
    return mesh;
  }
  RayQuery& query = *context.query;
  const Interval span = clip({query.ray.origin, query.ray.direction, ray.tnear, ray.tfar},
                             residency.tables->voxels[index_of(voxel)].bounds);
  if (span.is_empty()) { return nullptr; }
  const MissingVoxel missing{span.t_enter, voxel};
  if (query.tested_up_to < missing) { note_missing(query, missing); }
  return nullptr;
}

void box_intersect(const RTCIntersectFunctionNArguments* arguments) {
  arguments->valid[0] = 0;
  auto& context = *static_cast<QueryContext*>(arguments->context);
  auto& ray = reinterpret_cast<RTCRayHit*>(arguments->rayhit)->ray;
  const VoxelMesh* mesh = enter_voxel(context, arguments->primID, ray);
  if (mesh == nullptr) { return; }
  const float t_far = query_mesh(context, *mesh, ray.tfar);
  arguments->valid[0] = t_far < ray.tfar ? -1 : 0;
  ray.tfar = t_far;
}

void box_occluded(const RTCOccludedFunctionNArguments* arguments) {
  arguments->valid[0] = 0;
  auto& context = *static_cast<QueryContext*>(arguments->context);
  auto& ray = *reinterpret_cast<RTCRay*>(arguments->ray);
  const VoxelMesh* mesh = enter_voxel(context, arguments->primID, ray);
  if (mesh == nullptr) { return; }
  ray.tfar = query_mesh(context, *mesh, ray.tfar);
  arguments->valid[0] = ray.tfar < 0.0F ? -1 : 0;
}

QueryContext make_context(const Residency::Impl& residency, RayQuery& query, VoxelUses& uses) {
  QueryContext context;
  init_context(context);
  context.residency = &residency;
  context.query = &query;
  context.uses = &uses;
  context.parallel_axes = parallel_axes(query.ray.direction);
  context.reciprocal = 1.0F / query.ray.direction;
  return context;
}

void query_scene(RTCScene scene, QueryContext& context, RayQuery& query) {
  if (query.any_hit) {
    RTCRay ray = make_ray(query);
    occluded(scene, context, ray);
    query.blocked |= ray.tfar < 0.0F;
    return;
  }
  RTCRayHit ray_hit{};
  ray_hit.ray = make_ray(query);
  ray_hit.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  ray_hit.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
  intersect(scene, context, ray_hit);
  if (context.arrays != nullptr) { fill_surface(context, query); }
}

void resume_in(const VoxelMesh& mesh, QueryContext& context, RayQuery& query) {
  const float t_far = query_mesh(context, mesh, t_far_of(query));
  query.blocked |= query.any_hit && t_far < 0.0F;
  if (context.arrays != nullptr) { fill_surface(context, query); }
}

bool is_final(const RayQuery& query) {
  if (query.any_hit && query.blocked) { return true; }
  return query.missing_count == 0 || is_before(query.t_best, query.missing[0].t_enter);
}

}  // namespace

Residency::Residency(TracingDevice& device, const HotMesh& hot, const SceneTables& tables,
                     std::span<const VoxelId> cold, ResidentTable& resident)
    : impl_(std::make_unique<Impl>()) {
  impl_->tables = &tables;
  impl_->resident = &resident;
  impl_->cold.assign(cold.begin(), cold.end());
  impl_->hot_arrays = hot.arrays();
  RTCDevice embree = device.impl().device;
  impl_->scene = rtcNewScene(embree);
  rtcSetSceneFlags(impl_->scene, RTC_SCENE_FLAG_ROBUST);
  rtcSetSceneBuildQuality(impl_->scene, RTC_BUILD_QUALITY_MEDIUM);
  if (!impl_->hot_arrays.triangles.empty()) {
    RTCGeometry geometry = new_triangle_geometry(embree, impl_->hot_arrays);
    rtcAttachGeometry(impl_->scene, geometry);
    rtcReleaseGeometry(geometry);
  }
  if (!cold.empty()) {
    RTCGeometry boxes = rtcNewGeometry(embree, RTC_GEOMETRY_TYPE_USER);
    rtcSetGeometryUserPrimitiveCount(boxes, static_cast<unsigned>(cold.size()));
    rtcSetGeometryUserData(boxes, impl_.get());
    rtcSetGeometryBoundsFunction(boxes, box_bounds, nullptr);
    rtcSetGeometryIntersectFunction(boxes, box_intersect);
    rtcSetGeometryOccludedFunction(boxes, box_occluded);
    rtcSetGeometryMask(boxes, 0xFFFFFFFFU);
    rtcCommitGeometry(boxes);
    rtcAttachGeometry(impl_->scene, boxes);
    rtcReleaseGeometry(boxes);
  }
  rtcCommitScene(impl_->scene);
}

Residency::~Residency() { rtcReleaseScene(impl_->scene); }

Residency::Answer Residency::trace(RayQuery& query, VoxelUses& uses) const {
  query.missing_count = 0;
  query.missing_overflow = false;
  if (!is_traceable(query.ray)) { return Answer::kFinal; }
  QueryContext context = make_context(*impl_, query, uses);
  query_scene(impl_->scene, context, query);
  return is_final(query) ? Answer::kFinal : Answer::kWaiting;
}

Residency::Answer Residency::resume(RayQuery& query, VoxelUses& uses) const {
  for (;;) {
    while (!is_final(query)) {
      const MissingVoxel next = query.missing[0];
      const VoxelMesh* mesh = impl_->resident->lookup(next.voxel);
      if (mesh == nullptr) { return Answer::kWaiting; }
      QueryContext context = make_context(*impl_, query, uses);
      uses.add(next.voxel);
      resume_in(*mesh, context, query);
      query.tested_up_to = next;
      pop_missing(query);
    }
    if (query.missing_count > 0 || query.blocked || !query.missing_overflow) {
      return Answer::kFinal;
    }
    if (trace(query, uses) == Answer::kFinal) { return Answer::kFinal; }
  }
}

}  // namespace preheat
