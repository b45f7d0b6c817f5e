#include "tests/bench/bare_embree.h"

#include <algorithm>
#include <string>

#include "cache/renderer.h"
#include "common/check.h"
#include "tests/cache/embree_triangles.h"

namespace preheat {
namespace {

using test::embree_ray;
using test::EmbreeContext;
using test::init;
using test::intersect;
using test::occluded;

struct BestHit : EmbreeContext {
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

}  // namespace

struct BareEmbree::Impl {
  MeshArrays mesh{};
  std::vector<std::uint32_t> indices{};
  bool has_surface = false;
  RTCDevice device = nullptr;
  RTCScene scene = nullptr;
};

BareEmbree::BareEmbree(const MeshArrays& mesh, HitFilter filter) : impl_(std::make_unique<Impl>()) {
  impl_->mesh = mesh;
  impl_->indices = mesh.indices.unpacked();
  impl_->has_surface = filter == HitFilter::kLowestWithSurface;
  impl_->device = rtcNewDevice((std::string("isa=") + tracing_isa()).c_str());
  CHECK(impl_->device != nullptr);
  impl_->scene =
      test::triangle_scene(impl_->device, mesh.positions, impl_->indices,
                           filter == HitFilter::kNone ? nullptr : keep_lowest, &impl_->mesh);
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
    if (impl_->has_surface && best.triangle != kNoTriangle) {
      // A sum of what was fetched, so that it is.
      const SurfaceHit surface = surface_of(impl_->mesh, best.primitive, best.t, best.u, best.v);
      hits += surface.material + (surface.normal_shading.x > surface.position.x ? 1U : 0U);
    } else {
      hits += query.hit.geomID != RTC_INVALID_GEOMETRY_ID ? 1U : 0U;
    }
  }
  return hits;
}

std::size_t BareEmbree::trace_any(std::span<const Ray> rays) const {
  std::size_t hits = 0;
  for (const Ray& ray : rays) {
    EmbreeContext context;
    init(context);
    RTCRay query = embree_ray(ray);
    occluded(impl_->scene, context, query);
    hits += query.tfar < 0.0F ? 1U : 0U;
  }
  return hits;
}

}  // namespace preheat
