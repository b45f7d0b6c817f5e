#include "tests/bench/bare_embree.h"

#include <string>

#include "cache/renderer.h"
#include "common/check.h"

#if __has_include(<embree4/rtcore.h>)
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

namespace preheat {

struct BareEmbree::Impl {
  RTCDevice device = nullptr;
  RTCScene scene = nullptr;
};

BareEmbree::BareEmbree(const MeshArrays& mesh) : impl_(std::make_unique<Impl>()) {
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
  rtcCommitGeometry(geometry);
  rtcAttachGeometry(impl_->scene, geometry);
  rtcReleaseGeometry(geometry);
  rtcCommitScene(impl_->scene);
}

BareEmbree::~BareEmbree() {
  rtcReleaseScene(impl_->scene);
  rtcReleaseDevice(impl_->device);
}

std::size_t BareEmbree::trace_all(std::span<const TracedRay> rays) const {
  std::size_t hits = 0;
#if RTC_VERSION_MAJOR < 4
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
#endif
  for (const TracedRay& traced : rays) {
    RTCRayHit query{};
    const Ray& ray = traced.ray;
    query.ray = {ray.origin.x,
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
    query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
#if RTC_VERSION_MAJOR >= 4
    traced.any_hit ? rtcOccluded1(impl_->scene, &query.ray) : rtcIntersect1(impl_->scene, &query);
#else
    traced.any_hit ? rtcOccluded1(impl_->scene, &context, &query.ray)
                   : rtcIntersect1(impl_->scene, &context, &query);
#endif
    hits += query.hit.geomID != RTC_INVALID_GEOMETRY_ID || query.ray.tfar < 0.0F ? 1U : 0U;
  }
  return hits;
}

}  // namespace preheat
