#include "tests/cache/transport_truth.h"

#if __has_include(<embree4/rtcore.h>)
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif
#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <numeric>

#include "common/math.h"
#include "common/path.h"
#include "common/voxel_block.h"
#include "tests/scenes/soups.h"

namespace preheat::test {
namespace {

// ---- compiling ----

Aabb bounds_in_cell(const Scene& scene, const Octree& octree, const OctreeNode& node,
                    const Aabb& cell) {
  Aabb bounds;
  for (std::uint64_t i = 0; i < node.references_count; ++i) {
    const Triangle& triangle = scene.triangles[octree.references[node.references_begin + i]];
    Aabb box;
    for (const std::uint32_t vertex : triangle.vertices) { box.extend(scene.positions[vertex]); }
    box.low = glm::max(box.low, cell.low);
    box.high = glm::min(box.high, cell.high);
    bounds.extend(box);
  }
  bounds.low -= Vec3(kVoxelMargin);
  bounds.high += Vec3(kVoxelMargin);
  return bounds;
}

struct PendingNode {
  std::uint32_t octree_node = 0;
  std::uint32_t voxel_node = 0;
  Aabb cell{};
};

void add_voxel(CompiledScene& compiled, const PendingNode& pending) {
  const OctreeNode& node = compiled.octree.nodes[pending.octree_node];
  const auto begin =
      compiled.octree.references.begin() + static_cast<std::ptrdiff_t>(node.references_begin);
  std::vector<std::uint32_t> triangles(begin, begin + node.references_count);
  std::sort(triangles.begin(), triangles.end());
  triangles.erase(std::unique(triangles.begin(), triangles.end()), triangles.end());
  VoxelEntry entry;
  entry.bounds = bounds_in_cell(compiled.scene, compiled.octree, node, pending.cell);
  entry.triangle_count = static_cast<std::uint32_t>(triangles.size());
  entry.block_bytes =
      static_cast<std::uint32_t>(voxel_block_bytes(triangles.size(), triangles.size(), false));
  entry.resident_bytes = 140 * std::uint64_t{triangles.size()};
  compiled.tables.voxel_nodes[pending.voxel_node].bounds = entry.bounds;
  compiled.tables.voxel_nodes[pending.voxel_node].first =
      static_cast<std::uint32_t>(compiled.tables.voxels.size());
  compiled.tables.voxels.push_back(entry);
  compiled.voxel_roots.push_back(pending.octree_node);
}

// ---- scene ----

constexpr std::uint32_t kWhite = 1;
constexpr std::uint32_t kWood = 2;
constexpr std::uint32_t kRed = 3;
constexpr std::uint32_t kMetal = 4;
constexpr std::uint32_t kGlass = 5;
constexpr std::uint32_t kLamp = 6;

void add_quad(Scene& scene, const Vec3& corner, const Vec3& u, const Vec3& v,
              std::uint32_t material) {
  add_triangle(scene, corner, corner + u, corner + u + v, material);
  add_triangle(scene, corner, corner + u + v, corner + v, material);
}

// A box turned about the vertical (y) axis, standing on `foot`.
void add_box(Scene& scene, const Vec3& foot, const Vec3& size, float turn, std::uint32_t material) {
  const Vec3 x = Vec3(std::cos(turn), 0.0F, std::sin(turn)) * size.x;
  const Vec3 z = Vec3(-std::sin(turn), 0.0F, std::cos(turn)) * size.z;
  const Vec3 y(0.0F, size.y, 0.0F);
  const Vec3 corner = foot - 0.5F * (x + z);
  add_quad(scene, corner, x, z, material);
  add_quad(scene, corner + y, z, x, material);
  add_quad(scene, corner, y, x, material);
  add_quad(scene, corner + z, x, y, material);
  add_quad(scene, corner, z, y, material);
  add_quad(scene, corner + x, y, z, material);
}

void add_sphere(Scene& scene, const Vec3& centre, float radius, unsigned bands,
                std::uint32_t material) {
  const auto point = [&](unsigned band, unsigned sector) {
    const float polar = kPi * static_cast<float>(band) / static_cast<float>(bands);
    const float azimuth = kPi * static_cast<float>(sector) / static_cast<float>(bands);
    return centre + radius * Vec3(std::sin(polar) * std::cos(azimuth), std::cos(polar),
                                  std::sin(polar) * std::sin(azimuth));
  };
  for (unsigned band = 0; band < bands; ++band) {
    for (unsigned sector = 0; sector < 2 * bands; ++sector) {
      const Vec3 a = point(band, sector);
      const Vec3 b = point(band, sector + 1);
      const Vec3 c = point(band + 1, sector);
      const Vec3 d = point(band + 1, sector + 1);
      if (band > 0) { add_triangle(scene, a, b, c, material); }
      if (band + 1 < bands) { add_triangle(scene, b, d, c, material); }
    }
  }
}

void add_table(Scene& scene, const Vec3& foot, float turn, std::uint32_t clutter,
               SoupRandom& random) {
  add_box(scene, foot + Vec3(0.0F, 0.3F, 0.0F), {0.5F, 0.02F, 0.3F}, turn, kWood);
  for (const float x : {-0.22F, 0.22F}) {
    for (const float z : {-0.12F, 0.12F}) {
      const Vec3 leg(x * std::cos(turn) - z * std::sin(turn), 0.0F,
                     x * std::sin(turn) + z * std::cos(turn));
      add_box(scene, foot + leg, {0.02F, 0.3F, 0.02F}, turn, kWood);
    }
  }
  for (std::uint32_t i = 0; i < clutter; ++i) {
    const Vec3 at = foot + Vec3(random.in(-0.2F, 0.2F), 0.32F, random.in(-0.12F, 0.12F));
    const std::uint32_t material = kWhite + random.below(5);
    if (random.below(3) == 0) {
      add_box(scene, at, random.in_cube(0.02F, 0.1F), random.in(0.0F, 3.0F), material);
    } else {
      const float radius = random.in(0.01F, 0.05F);
      add_sphere(scene, at + Vec3(0.0F, radius, 0.0F), radius, 8 + random.below(17), material);
    }
  }
}

// ---- tracing ----

class Tracer {
 public:
  explicit Tracer(const Scene& scene) : device_(rtcNewDevice("isa=avx2")) {
    scene_ = rtcNewScene(device_);
    rtcSetSceneFlags(scene_, RTC_SCENE_FLAG_ROBUST);
    const RTCGeometry geometry = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_TRIANGLE);
    auto* vertices = static_cast<float*>(
        rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                3 * sizeof(float), scene.positions.size()));
    for (const Vec3& position : scene.positions) {
      for (int axis = 0; axis < 3; ++axis) { *vertices++ = position[axis]; }
    }
    auto* indices = static_cast<std::uint32_t*>(
        rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                3 * sizeof(std::uint32_t), scene.triangles.size()));
    for (const Triangle& triangle : scene.triangles) {
      indices = std::copy(triangle.vertices.begin(), triangle.vertices.end(), indices);
    }
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(scene_, geometry);
    rtcReleaseGeometry(geometry);
    rtcCommitScene(scene_);
  }
  ~Tracer() {
    rtcReleaseScene(scene_);
    rtcReleaseDevice(device_);
  }
  Tracer(const Tracer&) = delete;
  Tracer& operator=(const Tracer&) = delete;

  // The nearest hit; geomID is RTC_INVALID_GEOMETRY_ID without one.
  [[nodiscard]] RTCRayHit intersect(const Ray& ray) const {
    RTCRayHit query{};
    query.ray.org_x = ray.origin.x;
    query.ray.org_y = ray.origin.y;
    query.ray.org_z = ray.origin.z;
    query.ray.dir_x = ray.direction.x;
    query.ray.dir_y = ray.direction.y;
    query.ray.dir_z = ray.direction.z;
    query.ray.tnear = ray.t_min;
    query.ray.tfar = ray.t_max;
    query.ray.mask = 0xFFFFFFFFU;
    query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
#if RTC_VERSION_MAJOR >= 4
    rtcIntersect1(scene_, &query);
#else
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcIntersect1(scene_, &context, &query);
#endif
    return query;
  }

 private:
  RTCDevice device_;
  RTCScene scene_{};
};

SurfaceHit surface_of(const Scene& scene, const RTCRayHit& query) {
  const Triangle& triangle = scene.triangles[query.hit.primID];
  const Vec3& a = scene.positions[triangle.vertices[0]];
  const Vec3& b = scene.positions[triangle.vertices[1]];
  const Vec3& c = scene.positions[triangle.vertices[2]];
  SurfaceHit hit;
  hit.position = a * (1.0F - query.hit.u - query.hit.v) + b * query.hit.u + c * query.hit.v;
  hit.position_error = kVoxelMargin;
  hit.normal_geometric = glm::normalize(glm::cross(b - a, c - a));
  hit.normal_shading = hit.normal_geometric;
  hit.distance = query.ray.tfar;
  hit.triangle = query.hit.primID;
  hit.material = triangle.material;
  return hit;
}

struct Counts {
  explicit Counts(std::size_t voxel_count) {
    for (auto& type : accesses) { type.resize(voxel_count, 0.0); }
  }
  std::array<std::vector<double>, 3> accesses;
  std::array<double, 3> rays{};
};

void count_ray(const SceneTables& tables, Ray ray, float t_hit, std::vector<double>& accesses) {
  ray.t_max = std::min(ray.t_max, t_hit);
  std::vector<std::uint32_t> pending{0};
  while (!pending.empty()) {
    const VoxelNode& node = tables.voxel_nodes[pending.back()];
    pending.pop_back();
    if (clip(ray, node.bounds).is_empty()) { continue; }
    if (node.count == 0) { accesses[node.first] += 1.0; }
    for (std::uint32_t i = 0; i < node.count; ++i) { pending.push_back(node.first + i); }
  }
}

void count_path(const CompiledScene& compiled, const Tracer& tracer, const Shading& shading,
                std::uint32_t pixel, std::uint32_t sample, Counts& counts) {
  PathState path;
  Ray ray = shading.start_path(pixel, sample, path);
  std::size_t type = 0;
  for (;;) {
    const RTCRayHit query = tracer.intersect(ray);
    const bool is_hit = query.hit.geomID != RTC_INVALID_GEOMETRY_ID;
    counts.rays[type] += 1.0;
    count_ray(compiled.tables, ray, query.ray.tfar, counts.accesses[type]);
    if (!is_hit) { return; }
    const ShadedVertex vertex = shading.shade_hit(ray, surface_of(compiled.scene, query), path);
    if (vertex.has_shadow_ray) {
      counts.rays[2] += 1.0;
      count_ray(compiled.tables, vertex.shadow, tracer.intersect(vertex.shadow).ray.tfar,
                counts.accesses[2]);
    }
    if (!vertex.has_scatter_ray) { return; }
    ray = vertex.scatter;
    type = 1;
  }
}

// ---- comparing ----

std::vector<double> all_rays(const Prediction& prediction) {
  std::vector<double> rays(prediction.rays_camera.size());
  for (std::size_t voxel = 0; voxel < rays.size(); ++voxel) {
    rays[voxel] = prediction.rays(voxel);
  }
  return rays;
}

// The share of `counted` in the voxels ranked by `ranked` per byte, within a share of the bytes;
// the last voxel counts in part.
double capture(const SceneTables& tables, const std::vector<double>& ranked,
               const std::vector<double>& counted, double share) {
  std::vector<std::size_t> order(ranked.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  const auto bytes = [&](std::size_t voxel) {
    return static_cast<double>(tables.voxels[voxel].resident_bytes);
  };
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    return ranked[a] / bytes(a) > ranked[b] / bytes(b);
  });
  double left = share * static_cast<double>(tables.resident_bytes());
  double sum = 0.0;
  for (const std::size_t voxel : order) {
    const double part = std::min(1.0, left / bytes(voxel));
    sum += part * counted[voxel];
    left -= part * bytes(voxel);
    if (left <= 0.0) { break; }
  }
  return sum / std::accumulate(counted.begin(), counted.end(), 0.0);
}

}  // namespace

CompiledScene compile_in_memory(Scene scene, std::uint32_t voxel_references_max) {
  CompiledScene compiled;
  compiled.scene = std::move(scene);
  compiled.octree = build_octree(compiled.scene, {});
  compiled.tables.triangle_count = compiled.scene.triangles.size();
  compiled.tables.materials = compiled.scene.materials;
  compiled.tables.lights = compiled.scene.lights;
  for (std::uint32_t id = 0; id < compiled.scene.triangles.size(); ++id) {
    const Triangle& triangle = compiled.scene.triangles[id];
    if (compiled.scene.materials[triangle.material].emission == Vec3(0.0F)) { continue; }
    EmissiveTriangle light{id, triangle.material, {}};
    for (std::size_t i = 0; i < 3; ++i) {
      light.vertices[i] = compiled.scene.positions[triangle.vertices[i]];
    }
    compiled.tables.emissive_triangles.push_back(light);
  }

  std::vector<PendingNode> pending{{0, 0, compiled.octree.root}};
  compiled.tables.voxel_nodes.resize(1);
  for (std::size_t at = 0; at < pending.size(); ++at) {
    const PendingNode here = pending[at];
    const OctreeNode& node = compiled.octree.nodes[here.octree_node];
    if (node.first_child == 0 || node.references_count <= voxel_references_max) {
      add_voxel(compiled, here);
      continue;
    }
    const auto first = static_cast<std::uint32_t>(compiled.tables.voxel_nodes.size());
    compiled.tables.voxel_nodes[here.voxel_node].first = first;
    for (unsigned octant = 0; octant < 8; ++octant) {
      const std::uint32_t child = node.first_child + octant;
      if (compiled.octree.nodes[child].references_count == 0) { continue; }
      const auto voxel_node = static_cast<std::uint32_t>(compiled.tables.voxel_nodes.size());
      pending.push_back({child, voxel_node, child_cell(here.cell, octant)});
      compiled.tables.voxel_nodes.emplace_back();
      ++compiled.tables.voxel_nodes[here.voxel_node].count;
    }
  }
  for (std::size_t at = compiled.tables.voxel_nodes.size(); at-- > 0;) {
    VoxelNode& node = compiled.tables.voxel_nodes[at];
    for (std::uint32_t i = 0; i < node.count; ++i) {
      node.bounds.extend(compiled.tables.voxel_nodes[node.first + i].bounds);
    }
  }
  compiled.proxy = build_proxy(compiled.scene, compiled.octree, compiled.voxel_roots);
  return compiled;
}

Scene make_room(std::uint32_t clutter, std::uint32_t seed) {
  Scene scene = empty_scene();
  scene.materials.resize(7);
  scene.materials[kWhite].base_color = Vec3(0.75F);
  scene.materials[kWood].base_color = Vec3(0.5F, 0.3F, 0.15F);
  scene.materials[kRed].base_color = Vec3(0.7F, 0.1F, 0.1F);
  scene.materials[kMetal].metallic = 1.0F;
  scene.materials[kMetal].roughness = 0.1F;
  scene.materials[kGlass].transmission = 1.0F;
  scene.materials[kGlass].base_color = Vec3(1.0F);
  scene.materials[kGlass].roughness = 0.0F;
  scene.materials[kGlass].thin_walled = false;
  scene.materials[kLamp].emission = Vec3(10.0F);
  scene.materials[kLamp].base_color = Vec3(0.0F);
  SoupRandom random(seed);
  add_box(scene, {0.0F, -0.6F, 0.0F}, {1.97F, 1.17F, 1.93F}, 0.0F, kWhite);
  add_quad(scene, {-0.3F, 0.56F, -0.2F}, {0.6F, 0.0F, 0.0F}, {0.0F, 0.0F, 0.4F}, kLamp);
  for (const float x : {-0.6F, 0.0F, 0.6F}) {
    for (const float z : {-0.65F, -0.1F, 0.5F}) {
      add_table(scene, {x, -0.6F, z}, random.in(-0.4F, 0.4F), clutter, random);
    }
  }
  // A cupboard that hides a corner of the room, full of things that no camera sees.
  add_box(scene, {0.75F, -0.6F, -0.78F}, {0.4F, 1.0F, 0.35F}, 0.0F, kWood);
  for (std::uint32_t i = 0; i < 2 * clutter; ++i) {
    const Vec3 at(random.in(0.6F, 0.9F), random.in(-0.5F, 0.3F), random.in(-0.9F, -0.65F));
    add_sphere(scene, at, 0.03F, 16, kRed);
  }
  return scene;
}

RenderSettings room_settings(std::uint32_t size, std::uint32_t spp) {
  RenderSettings settings;
  settings.width = size;
  settings.height = size;
  settings.spp = spp;
  settings.view.origin = Vec3(-0.85F, 0.25F, 0.85F);
  settings.view.forward = glm::normalize(Vec3(0.2F, -0.3F, -0.1F) - settings.view.origin);
  settings.view.right = glm::normalize(glm::cross(settings.view.forward, Vec3(0, 1, 0))) * 0.55F;
  settings.view.up = glm::normalize(glm::cross(settings.view.right, settings.view.forward)) * 0.55F;
  return settings;
}

Prediction count_accesses(const CompiledScene& compiled, const RenderSettings& settings) {
  const Tracer tracer(compiled.scene);
  const Shading shading(compiled.tables, settings);
  const std::size_t voxel_count = compiled.tables.voxels.size();
  tbb::enumerable_thread_specific<Counts> threads(voxel_count);
  tbb::parallel_for(0U, settings.height, [&](std::uint32_t y) {
    Counts& counts = threads.local();
    for (std::uint32_t x = 0; x < settings.width; ++x) {
      for (std::uint32_t sample = 0; sample < settings.spp; ++sample) {
        count_path(compiled, tracer, shading, y * settings.width + x, sample, counts);
      }
    }
  });
  Counts sum(voxel_count);
  for (const Counts& counts : threads) {  // whole numbers: exact in any order
    for (std::size_t type = 0; type < 3; ++type) {
      sum.rays[type] += counts.rays[type];
      for (std::size_t voxel = 0; voxel < voxel_count; ++voxel) {
        sum.accesses[type][voxel] += counts.accesses[type][voxel];
      }
    }
  }
  return {"counted",   sum.accesses[0], sum.accesses[1], sum.accesses[2],
          sum.rays[0], sum.rays[1],     sum.rays[2],     0.0};
}

Agreement compare(const SceneTables& tables, const Prediction& predicted,
                  const Prediction& counted) {
  const std::vector<double> e = all_rays(predicted);
  const std::vector<double> r = all_rays(counted);
  const auto n = static_cast<double>(e.size());
  const double sum_e = std::accumulate(e.begin(), e.end(), 0.0);
  const double sum_r = std::accumulate(r.begin(), r.end(), 0.0);
  double ee = 0.0;
  double rr = 0.0;
  double er = 0.0;
  for (std::size_t i = 0; i < e.size(); ++i) {
    ee += (e[i] - sum_e / n) * (e[i] - sum_e / n);
    rr += (r[i] - sum_r / n) * (r[i] - sum_r / n);
    er += (e[i] - sum_e / n) * (r[i] - sum_r / n);
  }
  Agreement agreement;
  agreement.pearson = er / std::sqrt(ee * rr);
  agreement.slope = er / rr;
  agreement.total = sum_e / sum_r;
  for (const double share : kCaptureShares) {
    agreement.capture.push_back(capture(tables, e, r, share));
    agreement.capture_best.push_back(capture(tables, r, r, share));
  }
  return agreement;
}

}  // namespace preheat::test
