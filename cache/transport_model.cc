#include "cache/transport_model.h"

#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include "cache/proxy_walk.h"
#include "cache/seen_sides.h"
#include "common/math.h"
#include "common/path.h"
#include "common/rng.h"

namespace preheat {
namespace {

// The knee of speed against error. Over 23 views of 18 scenes at 1024x1024, the median of 1 - R^2,
// the median capture lost at the worst of 1, 10, 25 and 50 % of the bytes, and milliseconds in all:
//   1024 paths .0044 .015 499, 2048 .0028 .007 677, 4096 .0015 .005 1016,
//   8192 .0013 .002 1835, 16384 .0013 .002 3495.
// From here on the proxy errs more than its sampling, and time doubles with the paths.
constexpr std::uint32_t kPathsDefault = 4096;

// The paths are traced in so many parts: what threads share out, and what the standard error is
// estimated from.
constexpr std::uint32_t kBatches = 32;

enum RayType : std::size_t { kCamera = 0, kScatter = 1, kShadow = 2, kRayTypes = 3 };

// What one batch has counted.
struct Counts {
  std::array<std::vector<double>, kRayTypes> accesses{};  // [voxel_count] each
  std::array<std::uint64_t, kRayTypes> rays{};
};

// The image is cut into so many cells a side at most, each with the same number of paths.
constexpr std::uint32_t kCellsPerSideMax = 64;

// The image as so many pixels a side, the cells. A pixel's samples are spread evenly over it, and,
// at every vertex, over lights and directions (common/rng.h).
RenderSettings with_cells(RenderSettings settings, std::uint32_t cells_per_side) {
  settings.width = cells_per_side;
  settings.height = cells_per_side;
  return settings;
}

// Where the image may show a box: in cells, from the lowest to the highest. The whole image where
// the box reaches behind the camera, nothing where all of it is there.
struct CellRange {
  float low_x = kInfinity;
  float low_y = kInfinity;
  float high_x = -kInfinity;
  float high_y = -kInfinity;
};

CellRange cells_of(const Aabb& box, const View& view, float cells_per_side) {
  constexpr float kDepthMin = 1e-6F;  // nothing is seen nearer: voxel bounds are grown by as much
  const Vec3 right = view.right / glm::dot(view.right, view.right);
  const Vec3 up = view.up / glm::dot(view.up, view.up);
  CellRange range;
  unsigned behind = 0;
  for (unsigned corner = 0; corner < 8; ++corner) {
    const Vec3 at((corner & 1U) != 0 ? box.high.x : box.low.x,
                  (corner & 2U) != 0 ? box.high.y : box.low.y,
                  (corner & 4U) != 0 ? box.high.z : box.low.z);
    const Vec3 from_eye = at - view.origin;
    const float depth = view.orthographic ? 1.0F : glm::dot(from_eye, view.forward);
    if (!(depth > kDepthMin)) {
      ++behind;
      continue;
    }
    const float x = (0.5F + 0.5F * glm::dot(from_eye, right) / depth) * cells_per_side;
    const float y = (0.5F - 0.5F * glm::dot(from_eye, up) / depth) * cells_per_side;
    range.low_x = std::min(range.low_x, x);
    range.low_y = std::min(range.low_y, y);
    range.high_x = std::max(range.high_x, x);
    range.high_y = std::max(range.high_y, y);
  }
  if (behind == 0 || behind == 8) { return range; }
  return {0.0F, 0.0F, cells_per_side, cells_per_side};
}

// The cells in which the view may show a voxel, in Morton order, so that neighbours in the image
// are neighbours in the sequence of paths; a ray through any other cell meets nothing.
std::vector<std::uint32_t> cells_shown(const SceneTables& tables, const View& view,
                                       std::uint32_t cells_per_side) {
  const auto side = static_cast<float>(cells_per_side);
  std::vector<bool> is_shown(std::size_t{cells_per_side} * cells_per_side, false);
  for (const VoxelEntry& voxel : tables.voxels) {
    const CellRange range = cells_of(voxel.bounds, view, side);
    // A margin for the rounding of both this and the camera's rays.
    constexpr float kMargin = 1e-3F;
    if (!(range.low_x <= side + kMargin && range.high_x >= -kMargin &&
          range.low_y <= side + kMargin && range.high_y >= -kMargin)) {
      continue;
    }
    const auto cell = [&](float at) {
      return static_cast<std::uint32_t>(std::clamp(at, 0.0F, side - 1.0F));
    };
    for (std::uint32_t y = cell(range.low_y - kMargin); y <= cell(range.high_y + kMargin); ++y) {
      for (std::uint32_t x = cell(range.low_x - kMargin); x <= cell(range.high_x + kMargin); ++x) {
        is_shown[std::size_t{y} * cells_per_side + x] = true;
      }
    }
  }
  std::vector<std::uint32_t> shown;
  for (std::uint32_t code = 0; code < cells_per_side * cells_per_side; ++code) {
    std::uint32_t x = 0;
    std::uint32_t y = 0;
    for (std::uint32_t bit = 0; bit < 16; ++bit) {
      x |= (code >> (2 * bit) & 1U) << bit;
      y |= (code >> (2 * bit + 1) & 1U) << bit;
    }
    if (is_shown[std::size_t{y} * cells_per_side + x]) { shown.push_back(y * cells_per_side + x); }
  }
  return shown;
}

class TransportTracer {
 public:
  TransportTracer(const PredictionInput& input, const ProxyWalk& walk, std::uint32_t cells_per_side)
      : input_(input),
        walk_(walk),
        shading_(input.tables, with_cells(input.settings, cells_per_side), kAlbedoStrataCoarse),
        leaf_rng_(~input.settings.seed) {}

  // What paths have seen, for those that are traced from now on. Refracting surfaces have both
  // sides whatever it has: rays come out of glass.
  void set_sides(const SeenSides& sides) {
    one_sided_ = sides.one_sided();
    for (std::size_t i = 0; i < one_sided_.size(); ++i) {
      if (input_.tables.materials[input_.proxy.materials[i]].transmission > 0.0F) {
        one_sided_[i] = 0;
      }
    }
  }

  // One path of a cell. Behind the camera all paths, numbered by `index`, are samples of one pixel.
  // Given `sides`, it casts no shadow rays but notes which sides of things it sees.
  void trace(std::uint32_t cell, std::uint32_t sample, std::uint32_t index, Counts& counts,
             SeenSides* sides) const {
    PathState path;
    Ray ray = shading_.start_path(cell, sample, path);
    path.pixel = 0;
    path.sample = index;
    RayType type = kCamera;
    ProxyOrigin origin;
    for (std::uint32_t bounce = 0; bounce <= input_.settings.bounces; ++bounce) {
      ++counts.rays[type];
      const LeafRandom random = leaf_random(index, bounce);
      const ProxyStop stop =
          walk_.walk(ray, origin, random.unstopped, counts.accesses[type], one_sided_);
      if (!stop.is_stopped) { return; }
      if (sides != nullptr && is_far(ray, origin, stop)) { note_side(ray, stop, *sides); }
      const ShadedVertex vertex = shading_.shade_hit(ray, surface_at(ray, stop, random), path);
      origin = stop.leaf;
      if (vertex.has_shadow_ray && sides == nullptr) {
        ++counts.rays[kShadow];
        static_cast<void>(
            walk_.walk(vertex.shadow, origin, 0.0F, counts.accesses[kShadow], one_sided_));
      }
      if (!vertex.has_scatter_ray) { return; }
      ray = vertex.scatter;
      type = kScatter;
    }
  }

 private:
  // The numbers that the proxy needs beside those of the shading, which knows nothing of leaves.
  struct LeafRandom {
    float unstopped = 0.0F;
    float material = 0.0F;
    float side = 0.0F;
    float face = 0.0F;
    RandomPair normal{};
  };

  [[nodiscard]] LeafRandom leaf_random(std::uint32_t index, std::uint32_t bounce) const {
    const RandomPair first = leaf_rng_.pair(0, index, bounce, Dimension::kChoice);
    const RandomPair face = leaf_rng_.pair(0, index, bounce, Dimension::kRoulette);
    return {first.x(), first.y(), face.x(), face.y(),
            leaf_rng_.pair(0, index, bounce, Dimension::kDirection)};
  }

  void note_side(const Ray& ray, const ProxyStop& stop, SeenSides& sides) const {
    const ProxyRecord& record = input_.proxy.records[input_.proxy.nodes[stop.leaf.node].first];
    if ((record.shape & kShapeOriented) == 0) { return; }
    const float cosine = -glm::dot(record_normal(record), ray.direction);
    sides.add(cosine > 0.0F ? record.material_major : record.material_minor, cosine);
  }

  // True if the ray does not end at the surface that it leaves, as roughly as leaves know it.
  [[nodiscard]] bool is_far(const Ray& ray, const ProxyOrigin& origin,
                            const ProxyStop& stop) const {
    constexpr float kLeaves = 2.0F;
    if (origin.node == kNoIndex) { return true; }
    const Vec3 reach = input_.proxy.nodes[origin.node].bounds.extent() +
                       input_.proxy.nodes[stop.leaf.node].bounds.extent();
    return stop.t - ray.t_min > kLeaves * glm::length(reach);
  }

  // What a ray meets of a leaf.
  struct Face {
    Vec3 normal{0.0F};
    bool shows_minor = false;
  };

  [[nodiscard]] SurfaceHit surface_at(const Ray& ray, const ProxyStop& stop,
                                      const LeafRandom& random) const {
    const Proxy& proxy = input_.proxy;
    const ProxyNode& node = proxy.nodes[stop.leaf.node];
    const ProxyRecord& record = proxy.records[node.first];
    const bool is_flat = (record.shape & kShapeFlat) != 0;
    const Face face =
        is_flat ? flat_face(ray, record) : scattered_face(ray, record, node.bounds, random);
    SurfaceHit hit;
    hit.position = ray.origin + stop.t * ray.direction;
    hit.distance = stop.t;
    hit.triangle = kNoIndex;
    hit.normal_geometric = face.normal;
    hit.normal_shading = hit.normal_geometric;
    const float facing = glm::dot(hit.normal_geometric, ray.direction) > 0.0F ? -1.0F : 1.0F;
    hit.material =
        proxy.materials[face.shows_minor ? record.material_minor : record.material_major];
    // A lamp is on the ray's side of all that the leaf holds, so that it does not see itself but
    // lights what it hangs from.
    const float diagonal = glm::length(node.bounds.extent());
    const bool is_lamp = input_.tables.materials[hit.material].emission != Vec3(0.0F);
    const float thickness =
        is_flat && is_lamp ? diagonal * static_cast<float>(record.thickness) / 255.0F : 0.0F;
    hit.position_error = std::max(kVoxelMargin, 0.5F * thickness);
    hit.position +=
        hit.normal_geometric * (facing * (hit.position_error + 2.0F * kPlaneTolerance * diagonal));
    return hit;
  }

  // The side of a surface is known where the leaf's normals agree; otherwise the ray sees its
  // front.
  [[nodiscard]] static Face flat_face(const Ray& ray, const ProxyRecord& record) {
    const Vec3 mean = record_normal(record);
    const bool is_back = glm::dot(mean, ray.direction) >= 0.0F;
    const bool is_oriented = (record.shape & kShapeOriented) != 0;
    return {!is_oriented && is_back ? -mean : mean, is_back};
  }

  [[nodiscard]] static Face scattered_face(const Ray& ray, const ProxyRecord& record,
                                           const Aabb& bounds, const LeafRandom& random) {
    // The ray sees three sides of the leaf, each as likely as it meets the geometry's shadow there.
    const Vec3 extent = bounds.extent();
    Vec3 weight;
    Vec3 share;  // of the minor material
    for (int axis = 0; axis < 3; ++axis) {
      weight[axis] = std::abs(ray.direction[axis]) / extent[axis] *
                     static_cast<float>(record.coverage[static_cast<std::size_t>(axis)]);
      share[axis] = record_minor_share(record, axis, ray.direction[axis] > 0.0F);
    }
    const float weights = weight.x + weight.y + weight.z;
    float left = random.side * weights;
    int axis = 0;
    while (axis < 2 && left >= weight[axis]) { left -= weight[axis++]; }
    const bool shows_minor = random.material < share[axis];
    const Vec3 mean = record_normal(record);
    const bool is_oriented = (record.shape & kShapeOriented) != 0;
    if (is_oriented && glm::dot(mean, ray.direction) < 0.0F) { return {mean, shows_minor}; }
    // What a ray sees of a sphere has normals around its own direction by their cosine.
    if (random.face < record_roundness(record, shows_minor)) {
      const Vec3 local = cosine_direction(random.normal.x(), random.normal.y());
      return {OrthonormalFrame(-ray.direction).scene_from_local(local), shows_minor};
    }
    Vec3 normal(0.0F);
    normal[axis] = ray.direction[axis] > 0.0F ? -1.0F : 1.0F;
    return {normal, shows_minor};
  }

  const PredictionInput& input_;
  const ProxyWalk& walk_;
  Shading shading_;
  Rng leaf_rng_;
  std::vector<std::uint8_t> one_sided_{};  // [Proxy::materials]
};

// One path in so many is followed before all are, to see which sides things have.
constexpr std::uint32_t kPathsPerLook = 32;

// Traces all paths, `cell_paths` for each cell.
std::vector<Counts> trace_all(TransportTracer& tracer, const std::vector<std::uint32_t>& cells,
                              std::uint32_t cell_paths, const PredictionInput& input) {
  const auto path_count = static_cast<std::uint32_t>(cells.size()) * cell_paths;
  const auto trace = [&](std::uint32_t index, Counts& counts, SeenSides* sides) {
    tracer.trace(cells[index / cell_paths], index % cell_paths, index, counts, sides);
  };
  const auto clear = [&](Counts& counts) {
    for (auto& type : counts.accesses) { type.assign(input.tables.voxels.size(), 0.0); }
  };
  std::vector<Counts> batches(kBatches);
  std::vector<SeenSides> sides(kBatches, SeenSides(input.proxy.materials.size()));
  tbb::parallel_for(0U, kBatches, [&](std::uint32_t batch) {
    clear(batches[batch]);
    // Spread over the image, whose neighbouring cells have neighbouring numbers.
    constexpr std::uint32_t kStride = kBatches * kPathsPerLook;
    for (std::uint32_t index = batch * (kPathsPerLook + 1); index < path_count; index += kStride) {
      trace(index, batches[batch], &sides[batch]);
    }
  });
  for (std::uint32_t batch = 1; batch < kBatches; ++batch) { sides[0].add(sides[batch]); }
  tracer.set_sides(sides[0]);
  tbb::parallel_for(0U, kBatches, [&](std::uint32_t batch) {
    batches[batch].rays = {};
    clear(batches[batch]);
    for (std::uint32_t index = batch; index < path_count; index += kBatches) {
      trace(index, batches[batch], nullptr);
    }
  });
  return batches;
}

// Sums of the batches, scaled from the paths traced to the samples of the image. What a batch says
// of the whole is that many times its own count; the standard error of their mean overstates that
// of the paths together, which complement each other.
class Estimate {
 public:
  // Each path stands for so many samples of the image.
  Estimate(const std::vector<Counts>& batches, std::size_t voxel_count, double samples_per_path)
      : batches_(batches), voxel_count_(voxel_count), samples_per_path_(samples_per_path) {}

  [[nodiscard]] std::vector<double> accesses(RayType type) const {
    std::vector<double> sum(voxel_count_, 0.0);
    for (const Counts& batch : batches_) {
      for (std::size_t voxel = 0; voxel < voxel_count_; ++voxel) {
        sum[voxel] += batch.accesses[type][voxel];
      }
    }
    for (double& value : sum) { value = scaled(value); }
    return sum;
  }

  [[nodiscard]] double rays(RayType type) const {
    std::uint64_t sum = 0;
    for (const Counts& batch : batches_) { sum += batch.rays[type]; }
    return scaled(static_cast<double>(sum));
  }

  [[nodiscard]] double rays_total_error() const {
    Squares squares;
    for (const Counts& batch : batches_) {
      squares.add(
          static_cast<double>(batch.rays[kCamera] + batch.rays[kScatter] + batch.rays[kShadow]));
    }
    return scaled(squares.error_of_sum());
  }

  [[nodiscard]] std::vector<double> rays_error() const {
    std::vector<Squares> squares(voxel_count_);
    for (const Counts& batch : batches_) {
      for (std::size_t voxel = 0; voxel < voxel_count_; ++voxel) {
        squares[voxel].add(batch.accesses[kCamera][voxel] + batch.accesses[kScatter][voxel] +
                           batch.accesses[kShadow][voxel]);
      }
    }
    std::vector<double> errors;
    errors.reserve(voxel_count_);
    for (const Squares& of_voxel : squares) { errors.push_back(scaled(of_voxel.error_of_sum())); }
    return errors;
  }

 private:
  struct Squares {
    double sum = 0.0;
    double squares = 0.0;
    void add(double count) {
      sum += count;
      squares += count * count;
    }
    // Standard error of the sum of kBatches independent counts.
    [[nodiscard]] double error_of_sum() const {
      constexpr double kCount = kBatches;
      return std::sqrt(std::max(0.0, squares - sum * sum / kCount) * kCount / (kCount - 1.0));
    }
  };

  [[nodiscard]] double scaled(double sum) const { return sum * samples_per_path_; }

  const std::vector<Counts>& batches_;
  std::size_t voxel_count_;
  double samples_per_path_;
};

}  // namespace

Result<Prediction> predict_transport(const PredictionInput& input) {
  const Result<ProxyWalk> walk = ProxyWalk::create(input.tables, input.proxy);
  if (!walk) { return tl::unexpected<Error>(walk.error()); }
  const std::uint32_t paths_wanted = input.knobs.transport.paths;
  if (paths_wanted > kTransportPathsMax) {
    return fail(ExitCode::kUsage, "transport: " + std::to_string(paths_wanted) +
                                      " paths, at most " + std::to_string(kTransportPathsMax));
  }
  const std::uint32_t paths = paths_wanted == 0 ? kPathsDefault : paths_wanted;
  const std::uint32_t cells_per_side =
      std::min(kCellsPerSideMax, std::bit_floor(static_cast<std::uint32_t>(std::sqrt(paths))));
  const std::vector<std::uint32_t> cells =
      cells_shown(input.tables, input.settings.view, cells_per_side);
  const auto cell_count = static_cast<std::uint32_t>(cells.size());
  const std::uint32_t cell_paths = cells.empty() ? 0 : (paths + cell_count / 2) / cell_count;
  TransportTracer tracer(input, *walk, cells_per_side);
  const std::size_t voxel_count = input.tables.voxels.size();
  tbb::task_arena arena(static_cast<int>(std::max(1U, input.threads)));
  const std::vector<Counts> batches =
      arena.execute([&] { return trace_all(tracer, cells, cell_paths, input); });
  const double samples = sample_count(input.settings);
  const double cells_all = static_cast<double>(cells_per_side) * cells_per_side;
  const Estimate estimate(batches, voxel_count, samples / (cells_all * std::max(1U, cell_paths)));
  Prediction prediction;
  prediction.rays_camera = estimate.accesses(kCamera);
  prediction.rays_scatter = estimate.accesses(kScatter);
  prediction.rays_shadow = estimate.accesses(kShadow);
  prediction.camera_total = samples;
  prediction.scatter_total = estimate.rays(kScatter);
  prediction.shadow_total = estimate.rays(kShadow);
  prediction.rays_total_error = estimate.rays_total_error();
  prediction.rays_error = estimate.rays_error();
  return prediction;
}

}  // namespace preheat
