#include "tests/bench/bare_embree.h"

#include <algorithm>
#include <string>

#include "cache/renderer.h"
#include "common/check.h"

#if __has_include(<embree4/rtcore.h>)
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

namespace preheat {
namespace {

#if RTC_VERSION_MAJOR >= 4
using Context = RTCRayQueryContext;
void init(Context& context) { rtcInitRayQueryContext(&context); }
void intersect(RTCScene scene, Context& context, RTCRayHit& query) {
  RTCIntersectArguments arguments;
  rtcInitIntersectArguments(&arguments);
  arguments.context = &context;
  rtcIntersect1(scene, &query, &arguments);
}
void occluded(RTCScene scene, Context& context, RTCRay& query) {
  RTCOccludedArguments arguments;
  rtcInitOccludedArguments(&arguments);
  arguments.context = &context;
  rtcOccluded1(scene, &query, &arguments);
}
#else
using Context = RTCIntersectContext;
void init(Context& context) { rtcInitIntersectContext(&context); }
void intersect(RTCScene scene, Context& context, RTCRayHit& query) {
  rtcIntersect1(scene, &context, &query);
}
void occluded(RTCScene scene, Context& context, RTCRay& query) {
  rtcOccluded1(scene, &context, &query);
}
#endif

struct BestHit : Context {
  float t_max = kInfinity;
  float t = kInfinity;
  std::uint32_t triangle = kNoTriangle;
  std::uint32_t primitive = 0;
  float u = 0.0F;
  float v = 0.0F;
};

void keep_lowest(const RTCFilterFunctionNArguments* arguments) {
  auto& best = *static_cast<BestHit*>(arguments->context);
  const auto& mesh = *static_cast<const MeshArrays*>(arguments->geometryUserPtr);
  auto& ray = *reinterpret_cast<RTCRay*>(arguments->ray);
  const auto& hit = *reinterpret_cast<const RTCHit*>(arguments->hit);
  const std::uint32_t triangle = mesh.triangles[hit.primID];
  if (ray.tfar < best.t || (ray.tfar == best.t && triangle < best.triangle)) {
    best.t = ray.tfar;
    best.triangle = triangle;
    best.primitive = hit.primID;
    best.u = hit.u;
    best.v = hit.v;
  }
  ray.tfar = std::min(best.t * 1.0000019F + 4.8e-07F, best.t_max);
}

RTCRay embree_ray(const Ray& ray) {
  return {ray.origin.x,
          ray.origin.y,
          ray.origin.z,
          ray.t_min,
          ray.direction.x,
          ray.direction.y,
          ray.direction.z,
          0.0F,
          ray.t_max,
          0xFFFFFFFFU,
          0,
          0};
}

}  // namespace

struct BareEmbree::Impl {
  MeshArrays mesh{};
  RTCDevice device = nullptr;
  RTCScene scene = nullptr;
};

BareEmbree::BareEmbree(const MeshArrays& mesh, HitFilter filter) : impl_(std::make_unique<Impl>()) {
  impl_->mesh = mesh;
  impl_->device = rtcNewDevice((std::string("isa=") + tracing_isa()).c_str());
  CHECK(impl_->device != nullptr);
  impl_->scene = rtcNewScene(impl_->device);
  rtcSetSceneFlags(impl_->scene, RTC_SCENE_FLAG_ROBUST);
  RTCGeometry geometry = rtcNewGeometry(impl_->device, RTC_GEOMETRY_TYPE_TRIANGLE);
  rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                             mesh.positions.data(), 0, 3 * sizeof(float),
                             mesh.positions.size() / 3);
  rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                             mesh.indices.data(), 0, 3 * sizeof(std::uint32_t),
                             mesh.indices.size() / 3);
  rtcSetGeometryUserData(geometry, &impl_->mesh);
  if (filter == HitFilter::kLowest) {
    rtcSetGeometryIntersectFilterFunction(geometry, keep_lowest);
  }
  rtcCommitGeometry(geometry);
  rtcAttachGeometry(impl_->scene, geometry);
  rtcReleaseGeometry(geometry);
  rtcCommitScene(impl_->scene);
}

BareEmbree::~BareEmbree() {
  rtcReleaseScene(impl_->scene);
  rtcReleaseDevice(impl_->device);
}

std::size_t BareEmbree::trace_closest(std::span<const Ray> rays) const {
  std::size_t hits = 0;
  for (const Ray& ray : rays) {
    BestHit best;
    init(best);
    best.t_max = ray.t_max;
    RTCRayHit query;
    query.ray = embree_ray(ray);
    query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    query.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
    intersect(impl_->scene, best, query);
    hits += query.hit.geomID != RTC_INVALID_GEOMETRY_ID ? 1U : 0U;
  }
  return hits;
}

std::size_t BareEmbree::trace_any(std::span<const Ray> rays) const {
  std::size_t hits = 0;
  for (const Ray& ray : rays) {
    Context context;
    init(context);
    RTCRay query = embree_ray(ray);
    occluded(impl_->scene, context, query);
    hits += query.tfar < 0.0F ? 1U : 0U;
  }
  return hits;
}

}  // namespace preheat
