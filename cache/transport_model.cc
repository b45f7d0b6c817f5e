#include "cache/transport_model.h"

#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "cache/proxy_walk.h"
#include "common/path.h"

namespace preheat {
namespace {

// The image is cut into so many strata a side, with one path in each.
constexpr std::uint32_t kStrataPerSide = 64;

enum RayType : std::size_t { kCamera = 0, kScatter = 1, kShadow = 2, kRayTypes = 3 };

// What one thread has counted; whole numbers, so that threads may share the paths in any way.
struct Counts {
  explicit Counts(std::size_t voxel_count) {
    for (auto& type : accesses) { type.resize(voxel_count, 0); }
  }
  std::array<std::vector<std::uint64_t>, kRayTypes> accesses;
  std::array<std::uint64_t, kRayTypes> rays{};
};

// PCG's output permutation over a multiplicative hash (Jarzynski and Olano, JCGT 2020).
std::uint32_t hash(std::uint32_t value) {
  const std::uint32_t state = value * 747796405U + 2891336453U;
  const std::uint32_t word = ((state >> ((state >> 28U) + 4U)) ^ state) * 277803737U;
  return (word >> 22U) ^ word;
}

// The numbers that the proxy needs beside those of the shading, which knows nothing of leaves.
class LeafRandom {
 public:
  LeafRandom(std::uint64_t seed, std::uint32_t path)
      : state_(hash(path ^ hash(static_cast<std::uint32_t>(seed) ^
                                hash(static_cast<std::uint32_t>(seed >> 32U))))) {}
  float next() {  // in [0, 1)
    state_ = hash(state_ + 0x9E3779B9U);
    return static_cast<float>(state_ >> 8U) * 0x1p-24F;
  }

 private:
  std::uint32_t state_;
};

class TransportTracer {
 public:
  TransportTracer(const PredictionInput& input, const ProxyWalk& walk)
      : input_(input), walk_(walk), shading_(input.tables, input.settings) {}

  void trace(std::uint32_t pixel, std::uint32_t sample, std::uint32_t index, Counts& counts) const {
    LeafRandom random(input_.settings.seed, index);
    PathState path;
    Ray ray = shading_.start_path(pixel, sample, path);
    RayType type = kCamera;
    ProxyOrigin origin;
    for (std::uint32_t bounce = 0; bounce <= input_.settings.bounces; ++bounce) {
      ++counts.rays[type];
      const ProxyStop stop = walk_.walk(ray, origin, random.next(), counts.accesses[type]);
      if (!stop.is_stopped) { return; }
      const ShadedVertex vertex = shading_.shade_hit(ray, surface_at(ray, stop, random), path);
      origin = stop.leaf;
      if (vertex.has_shadow_ray) {
        ++counts.rays[kShadow];
        static_cast<void>(walk_.walk(vertex.shadow, origin, 0.0F, counts.accesses[kShadow]));
      }
      if (!vertex.has_scatter_ray) { return; }
      ray = vertex.scatter;
      type = kScatter;
    }
  }

 private:
  [[nodiscard]] SurfaceHit surface_at(const Ray& ray, const ProxyStop& stop,
                                      LeafRandom& random) const {
    const Proxy& proxy = input_.proxy;
    const ProxyNode& node = proxy.nodes[stop.leaf.node];
    const ProxyRecord& record = proxy.records[node.first];
    SurfaceHit hit;
    hit.position = ray.origin + stop.t * ray.direction;
    hit.distance = stop.t;
    hit.triangle = kNoIndex;
    hit.normal_geometric = normal_at(ray, record, node.bounds, random);
    hit.normal_shading = hit.normal_geometric;
    const bool is_flat = (record.shape & kShapeFlat) != 0;
    const float facing = glm::dot(hit.normal_geometric, ray.direction) > 0.0F ? -1.0F : 1.0F;
    const bool is_front = glm::dot(record_normal(record), ray.direction) < 0.0F;
    const float share = static_cast<float>(record.minor_share) / 255.0F;
    const bool shows_minor = is_flat ? !is_front : random.next() < share;
    hit.material = proxy.materials[shows_minor ? record.material_minor : record.material_major];
    // On the ray's side of all that the leaf holds, so that a lamp does not see itself.
    const float diagonal = glm::length(node.bounds.extent());
    const float thickness = diagonal * static_cast<float>(record.thickness) / 255.0F;
    hit.position_error = std::max(kVoxelMargin, 0.5F * thickness);
    hit.position +=
        hit.normal_geometric * (facing * (hit.position_error + 2.0F * kPlaneTolerance * diagonal));
    return hit;
  }

  // The side of a surface is known where the leaf's normals agree; otherwise the ray sees its
  // front.
  [[nodiscard]] static Vec3 normal_at(const Ray& ray, const ProxyRecord& record, const Aabb& bounds,
                                      LeafRandom& random) {
    const Vec3 mean = record_normal(record);
    const bool is_flat = (record.shape & kShapeFlat) != 0;
    const bool is_oriented = (record.shape & kShapeOriented) != 0;
    const float towards = glm::dot(mean, ray.direction);
    if (is_flat) { return !is_oriented && towards > 0.0F ? -mean : mean; }
    if (is_oriented && towards < 0.0F) { return mean; }
    // Facing one of the axes, as likely as the geometry's shadow along it is met.
    const Vec3 extent = bounds.extent();
    Vec3 weight;
    for (int axis = 0; axis < 3; ++axis) {
      weight[axis] = std::abs(ray.direction[axis]) / extent[axis] *
                     static_cast<float>(record.coverage[static_cast<std::size_t>(axis)]);
    }
    float left = random.next() * (weight.x + weight.y + weight.z);
    int axis = 0;
    while (axis < 2 && left >= weight[axis]) { left -= weight[axis++]; }
    Vec3 normal(0.0F);
    normal[axis] = ray.direction[axis] > 0.0F ? -1.0F : 1.0F;
    return normal;
  }

  const PredictionInput& input_;
  const ProxyWalk& walk_;
  Shading shading_;
};

// How the image is sampled: strata of pixels, each with its paths.
struct Strata {
  std::uint32_t columns = 0;
  std::uint32_t rows = 0;
  std::uint32_t paths_each = 0;
  [[nodiscard]] std::uint64_t paths() const { return std::uint64_t{columns} * rows * paths_each; }
};

Strata strata_of(const RenderSettings& settings) {
  Strata strata;
  strata.columns = std::min(kStrataPerSide, settings.width);
  strata.rows = std::min(kStrataPerSide, settings.height);
  const std::uint32_t wanted = kStrataPerSide * kStrataPerSide / (strata.columns * strata.rows);
  strata.paths_each = std::clamp(wanted, 1U, settings.spp);
  return strata;
}

void trace_stratum(const TransportTracer& tracer, const RenderSettings& settings,
                   const Strata& strata, std::uint32_t stratum, Counts& counts) {
  const std::uint32_t column = stratum % strata.columns;
  const std::uint32_t row = stratum / strata.columns;
  for (std::uint32_t i = 0; i < strata.paths_each; ++i) {
    const std::uint32_t index = stratum * strata.paths_each + i;
    LeafRandom random(~settings.seed, index);
    const auto place = [&](std::uint32_t at, std::uint32_t strata_count, std::uint32_t size) {
      const double position = (at + static_cast<double>(random.next())) * size / strata_count;
      return std::min(static_cast<std::uint32_t>(position), size - 1);
    };
    const std::uint32_t x = place(column, strata.columns, settings.width);
    const std::uint32_t y = place(row, strata.rows, settings.height);
    const auto sample = static_cast<std::uint32_t>((static_cast<double>(random.next()) + i) *
                                                   settings.spp / strata.paths_each);
    tracer.trace(y * settings.width + x, std::min(sample, settings.spp - 1), index, counts);
  }
}

Prediction scaled(const tbb::enumerable_thread_specific<Counts>& threads, std::size_t voxel_count,
                  double scale) {
  Counts sum(voxel_count);
  for (const Counts& counts : threads) {
    for (std::size_t type = 0; type < kRayTypes; ++type) {
      sum.rays[type] += counts.rays[type];
      for (std::size_t voxel = 0; voxel < voxel_count; ++voxel) {
        sum.accesses[type][voxel] += counts.accesses[type][voxel];
      }
    }
  }
  const auto rays = [&](RayType type) {
    std::vector<double> values(voxel_count);
    for (std::size_t voxel = 0; voxel < voxel_count; ++voxel) {
      values[voxel] = static_cast<double>(sum.accesses[type][voxel]) * (scale / kAccessUnit);
    }
    return values;
  };
  Prediction prediction;
  prediction.rays_camera = rays(kCamera);
  prediction.rays_scatter = rays(kScatter);
  prediction.rays_shadow = rays(kShadow);
  prediction.camera_total = static_cast<double>(sum.rays[kCamera]) * scale;
  prediction.scatter_total = static_cast<double>(sum.rays[kScatter]) * scale;
  prediction.shadow_total = static_cast<double>(sum.rays[kShadow]) * scale;
  return prediction;
}

}  // namespace

Result<Prediction> predict_transport(const PredictionInput& input) {
  const Result<ProxyWalk> walk = ProxyWalk::create(input.tables, input.proxy);
  if (!walk) { return tl::unexpected<Error>(walk.error()); }
  const RenderSettings& settings = input.settings;
  const TransportTracer tracer(input, *walk);
  const Strata strata = strata_of(settings);
  const std::size_t voxel_count = input.tables.voxels.size();
  tbb::enumerable_thread_specific<Counts> counts(voxel_count);
  tbb::task_arena arena(static_cast<int>(std::max(1U, input.threads)));
  arena.execute([&] {
    tbb::parallel_for(0U, strata.columns * strata.rows, [&](std::uint32_t stratum) {
      trace_stratum(tracer, settings, strata, stratum, counts.local());
    });
  });
  const double samples = static_cast<double>(settings.width) *
                         static_cast<double>(settings.height) * static_cast<double>(settings.spp);
  return scaled(counts, voxel_count, samples / static_cast<double>(strata.paths()));
}

}  // namespace preheat
