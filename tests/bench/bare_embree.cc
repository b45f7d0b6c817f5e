#include "tests/bench/bare_embree.h"

#include <string>

#include "cache/hit_filter.h"
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

struct SearchContext : EmbreeContext {
  explicit SearchContext(const Ray& ray) : search(ray) { init(*this); }
  HitSearch search;
};

void keep_lowest(const RTCFilterFunctionNArguments* arguments) {
  auto& search = static_cast<SearchContext*>(arguments->context)->search;
  const auto& mesh = *static_cast<const MeshArrays*>(arguments->geometryUserPtr);
  auto& ray = *reinterpret_cast<RTCRay*>(arguments->ray);
  const auto& hit = *reinterpret_cast<const RTCHit*>(arguments->hit);
  ray.tfar = search.keep_lowest(mesh, hit.primID, ray.tfar, hit.u, hit.v);
}

void refuse_what_does_not_count(const RTCFilterFunctionNArguments* arguments) {
  const auto& search = static_cast<SearchContext*>(arguments->context)->search;
  const auto& mesh = *static_cast<const MeshArrays*>(arguments->geometryUserPtr);
  const auto& ray = *reinterpret_cast<const RTCRay*>(arguments->ray);
  const auto& hit = *reinterpret_cast<const RTCHit*>(arguments->hit);
  if (!search.counts(mesh, hit.primID, ray.tfar)) { arguments->valid[0] = 0; }
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
  impl_->has_surface = filter == HitFilter::kSameWithSurface;
  impl_->device = rtcNewDevice((std::string("isa=") + tracing_isa()).c_str());
  CHECK(impl_->device != nullptr);
  const bool filtered = filter != HitFilter::kNone;
  impl_->scene = test::triangle_scene(
      impl_->device, mesh.positions, impl_->indices, filtered ? keep_lowest : nullptr,
      filtered ? refuse_what_does_not_count : nullptr, &impl_->mesh);
}

BareEmbree::~BareEmbree() {
  rtcReleaseScene(impl_->scene);
  rtcReleaseDevice(impl_->device);
}

std::size_t BareEmbree::trace_closest(std::span<const Ray> rays) const {
  std::size_t hits = 0;
  for (const Ray& ray : rays) {
    SearchContext context(ray);
    RTCRayHit query;
    query.ray = embree_ray(ray);
    query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    query.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
    intersect(impl_->scene, context, query);
    const HitSearch& best = context.search;
    if (impl_->has_surface && best.arrays != nullptr) {
      // A sum of what was fetched, so that it is.
      const SurfaceHit surface =
          surface_of(impl_->mesh, best.primitive, best.t_best, best.u, best.v);
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
    SearchContext context(ray);
    RTCRay query = embree_ray(ray);
    occluded(impl_->scene, context, query);
    hits += query.tfar < 0.0F ? 1U : 0U;
  }
  return hits;
}

}  // namespace preheat
