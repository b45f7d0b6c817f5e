// Triangles in an Embree scene of their own, for tests and benchmarks that compare with it: either
// version of Embree.
#pragma once

#if __has_include(<embree4/rtcore.h>)
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

#include <cstdint>
#include <span>

#include "common/ray.h"

namespace preheat::test {

#if RTC_VERSION_MAJOR >= 4
using EmbreeContext = RTCRayQueryContext;
inline void init(EmbreeContext& context) { rtcInitRayQueryContext(&context); }
inline void intersect(RTCScene scene, EmbreeContext& context, RTCRayHit& query) {
  RTCIntersectArguments arguments;
  rtcInitIntersectArguments(&arguments);
  arguments.context = &context;
  rtcIntersect1(scene, &query, &arguments);
}
inline void occluded(RTCScene scene, EmbreeContext& context, RTCRay& query) {
  RTCOccludedArguments arguments;
  rtcInitOccludedArguments(&arguments);
  arguments.context = &context;
  rtcOccluded1(scene, &query, &arguments);
}
#else
using EmbreeContext = RTCIntersectContext;
inline void init(EmbreeContext& context) { rtcInitIntersectContext(&context); }
inline void intersect(RTCScene scene, EmbreeContext& context, RTCRayHit& query) {
  rtcIntersect1(scene, &context, &query);
}
inline void occluded(RTCScene scene, EmbreeContext& context, RTCRay& query) {
  rtcOccluded1(scene, &context, &query);
}
#endif

inline RTCRay embree_ray(const Ray& ray) {
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

// A robust scene of these triangles alone. The spans outlive it, and 4 bytes behind the positions
// can be read. The filters may be nullptr; they find `user` in their arguments.
inline RTCScene triangle_scene(RTCDevice device, std::span<const float> positions,
                               std::span<const std::uint32_t> indices,
                               RTCFilterFunctionN intersect_filter,
                               RTCFilterFunctionN occluded_filter, void* user) {
  RTCScene scene = rtcNewScene(device);
  rtcSetSceneFlags(scene, RTC_SCENE_FLAG_ROBUST);
  RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
  rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                             positions.data(), 0, 3 * sizeof(float), positions.size() / 3);
  rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, indices.data(),
                             0, 3 * sizeof(std::uint32_t), indices.size() / 3);
  rtcSetGeometryUserData(geometry, user);
  rtcSetGeometryIntersectFilterFunction(geometry, intersect_filter);
  rtcSetGeometryOccludedFilterFunction(geometry, occluded_filter);
  rtcCommitGeometry(geometry);
  rtcAttachGeometry(scene, geometry);
  rtcReleaseGeometry(geometry);
  rtcCommitScene(scene);
  return scene;
}

}  // namespace preheat::test
