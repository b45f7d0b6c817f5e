// Embree and nothing else, over triangles that preheat holds: what tracing is measured against.
#pragma once

#include <memory>
#include <span>

#include "cache/tracing.h"
#include "common/ray.h"

namespace preheat {

struct TracedRay {
  Ray ray{};
  bool any_hit = false;
};

// One triangle geometry, ROBUST, no filter, the ISA that preheat pins.
class BareEmbree {
 public:
  explicit BareEmbree(const MeshArrays& mesh);  // which outlives this
  ~BareEmbree();
  BareEmbree(const BareEmbree&) = delete;
  BareEmbree& operator=(const BareEmbree&) = delete;

  // The number of rays that hit.
  [[nodiscard]] std::size_t trace_all(std::span<const TracedRay> rays) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace preheat
