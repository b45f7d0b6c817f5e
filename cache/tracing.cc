#include "cache/tracing.h"

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

// True if a hit at t lies so clearly before the entry that nothing inside can be nearer.
bool is_before(float t, float t_enter) { return widened(t) < t_enter; }

// A query's state that the callbacks reach through Embree's context pointer.
struct QueryContext : RayContext {
  QueryContext(const Residency::Impl& of, RayQuery& asked, VoxelUses& noted)
      : residency(&of), query(&asked), uses(&noted), search(asked.ray) {
    init_context(*this);
    search.t_best = asked.t_best;
    search.triangle_before = asked.triangle_best;
  }

  const Residency::Impl* residency = nullptr;
  RayQuery* query = nullptr;
  VoxelUses* uses = nullptr;
  HitSearch search;                       // its mesh is pinned by the guard
  std::optional<KernelRay> kernel_ray{};  // made when the first resident voxel is met
};

void refuse_unsettled_blocker(const RTCFilterFunctionNArguments* arguments) {
  const auto& context = *static_cast<const QueryContext*>(arguments->context);
  const auto& arrays = *static_cast<const MeshArrays*>(arguments->geometryUserPtr);
  const auto& ray = *reinterpret_cast<const RTCRay*>(arguments->ray);
  const auto& hit = *reinterpret_cast<const RTCHit*>(arguments->hit);
  if (!context.search.counts(arrays, hit.primID, ray.tfar)) { arguments->valid[0] = 0; }
}

void filter_closest(const RTCFilterFunctionNArguments* arguments) {
  auto& context = *static_cast<QueryContext*>(arguments->context);
  const auto& arrays = *static_cast<const MeshArrays*>(arguments->geometryUserPtr);
  auto& ray = *reinterpret_cast<RTCRay*>(arguments->ray);
  const auto& hit = *reinterpret_cast<const RTCHit*>(arguments->hit);
  ray.tfar = context.search.keep_lowest(arrays, hit.primID, ray.tfar, hit.u, hit.v);
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
  return {positions_, normals_, PackedIndices(std::span(indices_)), materials_, triangles_};
}

std::uint64_t HotMesh::bytes() const {
  return positions_.capacity() * sizeof(float) +
         (normals_.capacity() + indices_.capacity() + triangles_.capacity()) *
             sizeof(std::uint32_t) +
         materials_.capacity() * sizeof(std::uint16_t) + seen_.capacity() / 8;
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
  query.t_far = query.context.search.keep_lowest(query.arrays, primitive, t, u, v);
  return query.t_far;
}

float on_blocker(void* user, std::uint32_t primitive, float t, float /*u*/, float /*v*/) {
  auto& query = *static_cast<MeshQuery*>(user);
  if (query.context.search.counts(query.arrays, primitive, t)) { query.t_far = -kInfinity; }
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

// Takes over what the search found. A cold voxel may be evicted before shading looks at it, the hot
// set never is.
void keep_found(const QueryContext& context, RayQuery& query) {
  const HitSearch& search = context.search;
  if (search.arrays == nullptr) { return; }
  query.t_best = search.t_best;
  query.triangle_best = search.arrays->triangles[search.primitive];
  const bool is_hot = search.arrays == &context.residency->hot_arrays;
  query.hot_primitive = is_hot ? search.primitive : kNoTriangle;
  if (is_hot) {
    query.hot_u = search.u;
    query.hot_v = search.v;
  } else {
    query.surface = surface_of(*search.arrays, search.primitive, query.t_best, search.u, search.v);
  }
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
  keep_found(context, query);
}

void resume_in(const VoxelMesh& mesh, QueryContext& context, RayQuery& query) {
  const float t_far = query_mesh(context, mesh, t_far_of(query));
  query.blocked |= query.any_hit && t_far < 0.0F;
  keep_found(context, query);
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
  QueryContext context(*impl_, query, uses);
  query_scene(impl_->scene, context, query);
  return is_final(query) ? Answer::kFinal : Answer::kWaiting;
}

SurfaceHit Residency::surface(const RayQuery& query) const {
  if (query.hot_primitive == kNoTriangle) { return query.surface; }
  return surface_of(impl_->hot_arrays, query.hot_primitive, query.t_best, query.hot_u, query.hot_v);
}

Residency::Answer Residency::resume(RayQuery& query, VoxelUses& uses) const {
  for (;;) {
    while (!is_final(query)) {
      const MissingVoxel next = query.missing[0];
      const VoxelMesh* mesh = impl_->resident->lookup(next.voxel);
      if (mesh == nullptr) { return Answer::kWaiting; }
      QueryContext context(*impl_, query, uses);
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
