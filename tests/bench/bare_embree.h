// Embree and nothing else, over triangles that preheat holds: what tracing is measured against.
#pragma once

#include <memory>
#include <span>

#include "cache/tracing.h"
#include "common/ray.h"

namespace preheat {

// One triangle geometry, ROBUST, the ISA that preheat pins.
class BareEmbree {
 public:
  enum class HitFilter {
    kNone,
    kSame,             // as preheat judges hits, see hit_filter.h
    kSameWithSurface,  // and what shading needs of the nearest hit is fetched
  };

  BareEmbree(const MeshArrays& mesh, HitFilter filter);  // `mesh` is copied, its arrays are not
  ~BareEmbree();
  BareEmbree(const BareEmbree&) = delete;
  BareEmbree& operator=(const BareEmbree&) = delete;

  // The number of rays that hit; with a surface, of what was fetched of it.
  [[nodiscard]] std::size_t trace_closest(std::span<const Ray> rays) const;
  [[nodiscard]] std::size_t trace_any(std::span<const Ray> rays) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace preheat
