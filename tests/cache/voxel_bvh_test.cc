#include "cache/voxel_bvh.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <iostream>
#include <map>
#include <random>
#include <string>

#include "cache/renderer.h"
#include "tests/cache/embree_triangles.h"
#include "tests/scenes/grid_store.h"
#include "tests/scenes/soups.h"

namespace preheat {
namespace {

using test::AlignedBytes;
using test::SoupRandom;

struct Met {
  float t = 0.0F;
  float u = 0.0F;
  float v = 0.0F;
};

bool same_bits(const Met& a, const Met& b) { return std::memcmp(&a, &b, sizeof a) == 0; }

using MetTriangles = std::map<std::uint32_t, Met>;

struct CollectingContext : test::EmbreeContext {
  MetTriangles* met = nullptr;
};

void collect_and_refuse(const RTCFilterFunctionNArguments* arguments) {
  const auto& ray = *reinterpret_cast<const RTCRay*>(arguments->ray);
  const auto& hit = *reinterpret_cast<const RTCHit*>(arguments->hit);
  (*static_cast<CollectingContext*>(arguments->context)->met)[hit.primID] = {ray.tfar, hit.u,
                                                                             hit.v};
  arguments->valid[0] = 0;
}

// Embree over the triangles of a block, told to report every triangle that a ray meets.
class EmbreeBlock {
 public:
  EmbreeBlock(const VoxelBlockView& block, const std::string& isa)
      : device_(rtcNewDevice(("isa=" + isa).c_str())),
        indices_(block.indices.unpacked()),
        scene_(test::triangle_scene(device_, block.positions, indices_, collect_and_refuse, nullptr,
                                    nullptr)) {}
  ~EmbreeBlock() {
    rtcReleaseScene(scene_);
    rtcReleaseDevice(device_);
  }
  EmbreeBlock(const EmbreeBlock&) = delete;
  EmbreeBlock& operator=(const EmbreeBlock&) = delete;

  [[nodiscard]] MetTriangles trace(const Ray& ray) const {
    MetTriangles met;
    CollectingContext context;
    context.met = &met;
    RTCRayHit query{};
    query.ray = test::embree_ray(ray);
    query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    test::init(context);
    test::intersect(scene_, context, query);
    return met;
  }

 private:
  RTCDevice device_;
  std::vector<std::uint32_t> indices_;
  RTCScene scene_;
};

MetTriangles trace_all(const VoxelBvh& bvh, VoxelKernel kernel, const Ray& ray) {
  struct Collected {
    MetTriangles met{};
    float t_far = 0.0F;
  } collected{{}, ray.t_max};
  const auto collect = [](void* context, std::uint32_t triangle, float t, float u, float v) {
    auto& into = *static_cast<Collected*>(context);
    into.met[triangle] = {t, u, v};
    return into.t_far;
  };
  kernel(bvh.tree(), kernel_ray(ray, ray.t_max), collect, &collected);
  return collected.met;
}

struct KernelCase {
  const char* name;
  VoxelKernel kernel;
  bool available;
};

class VoxelKernelOfIsa : public testing::TestWithParam<KernelCase> {};

Ray random_ray(const Scene& scene, SoupRandom& random) {
  Ray ray{random.in_cube(-1.0F, 1.0F), random.in_cube(-1.0F, 1.0F)};
  const Triangle& triangle =
      scene.triangles[random.below(static_cast<std::uint32_t>(scene.triangles.size()))];
  const auto vertex = [&](unsigned corner) { return scene.positions[triangle.vertices[corner]]; };
  switch (random.below(6)) {
    case 0:  // in or beside an edge
      ray.direction = vertex(1) - ray.origin;
      break;
    case 1:  // from a vertex along an edge
      ray.origin = vertex(0);
      ray.direction = vertex(1) - vertex(0);
      break;
    case 2:  // along an axis
      ray.direction = Vec3(0.0F);
      ray.direction[static_cast<int>(random.below(3))] = 1.0F;
      break;
    case 3:  // from the surface
      ray.origin = (vertex(0) + vertex(1) + vertex(2)) / 3.0F;
      break;
    default:
      break;
  }
  const float length = std::sqrt(glm::dot(ray.direction, ray.direction));
  ray.direction = length > 0.0F ? ray.direction / length : Vec3(0.0F, 0.0F, 1.0F);
  if (random.below(4) == 0) { ray.t_max = random.in(0.0F, 2.0F); }
  return ray;
}

// Of every triangle that both report the bits must agree; what one alone reports would be a box
// that lost it.
TEST_P(VoxelKernelOfIsa, MeetsTheTrianglesThatEmbreeMeetsWithTheSameBits) {
  if (!GetParam().available) { GTEST_SKIP() << "this processor lacks " << GetParam().name; }
  const auto seed = static_cast<std::uint32_t>(std::random_device{}());
  std::cout << "seed=" << seed << '\n';
  SoupRandom random(seed);
  std::size_t met_count = 0;
  std::size_t lost = 0;
  std::size_t different = 0;
  std::size_t only_ours = 0;
  for (const float size : {0.3F, 0.05F, 1e-3F, 1e-6F, 1e-9F}) {
    Scene scene = test::soup(600, size, seed);
    const AlignedBytes bytes(encode_voxel_block(scene, [&] {
      std::vector<std::uint32_t> ids(scene.triangles.size());
      for (std::uint32_t id = 0; id < ids.size(); ++id) { ids[id] = id; }
      return ids;
    }()));
    const VoxelBlockView block = view_voxel_block(bytes.bytes(), 1).value();
    const EmbreeBlock embree(block, GetParam().name);
    const VoxelBvh bvh(block);
    for (int index = 0; index < 100000; ++index) {
      const Ray ray = random_ray(scene, random);
      const MetTriangles expected = embree.trace(ray);
      const MetTriangles found = trace_all(bvh, GetParam().kernel, ray);
      met_count += expected.size();
      for (const auto& [triangle, met] : expected) {
        const auto ours = found.find(triangle);
        lost += ours == found.end() ? 1U : 0U;
        different += ours != found.end() && !same_bits(ours->second, met) ? 1U : 0U;
      }
      for (const auto& [triangle, met] : found) {
        only_ours += expected.contains(triangle) ? 0U : 1U;
      }
    }
  }
  std::cout << met_count << " met, " << only_ours << " only by the kernel\n";

  EXPECT_EQ(different, 0U);
  EXPECT_EQ(lost, 0U);
  EXPECT_GT(met_count, 200000U);
  // Rays that lie in the face of a box, which the filter of hits judges.
  EXPECT_LT(only_ours, met_count / 100);
}

TEST_P(VoxelKernelOfIsa, MeetsTheSameWithIndicesOf32Bits) {
  if (!GetParam().available) { GTEST_SKIP() << "this processor lacks " << GetParam().name; }
  SoupRandom random(5);
  const Scene scene = test::soup(601, 0.2F, 5);
  std::vector<std::uint32_t> ids(scene.triangles.size());
  for (std::uint32_t id = 0; id < ids.size(); ++id) { ids[id] = id; }
  const AlignedBytes bytes(encode_voxel_block(scene, ids));
  const VoxelBlockView block = view_voxel_block(bytes.bytes(), 1).value();
  ASSERT_TRUE(block.indices.is_narrow());
  const std::vector<std::uint32_t> wide = block.indices.unpacked();
  VoxelBlockView wide_block = block;
  wide_block.indices = PackedIndices(std::span(wide));
  const VoxelBvh narrow_bvh(block);
  const VoxelBvh wide_bvh(wide_block);
  std::size_t met_count = 0;

  for (int index = 0; index < 10000; ++index) {
    const Ray ray = random_ray(scene, random);
    const MetTriangles expected = trace_all(narrow_bvh, GetParam().kernel, ray);
    const MetTriangles found = trace_all(wide_bvh, GetParam().kernel, ray);
    ASSERT_EQ(found.size(), expected.size());
    met_count += expected.size();
    for (const auto& [triangle, met] : expected) {
      const auto same = found.find(triangle);
      ASSERT_TRUE(same != found.end() && same_bits(same->second, met)) << triangle;
    }
  }

  EXPECT_GT(met_count, 10000U);
}

INSTANTIATE_TEST_SUITE_P(Isa, VoxelKernelOfIsa,
                         testing::Values(KernelCase{"avx2", trace_voxel_avx2,
                                                    __builtin_cpu_supports("avx2") &&
                                                        __builtin_cpu_supports("fma")},
                                         KernelCase{"sse4.2", trace_voxel_sse42, true}),
                         [](const auto& of) { return std::string(of.param.name).substr(0, 4); });

TEST(VoxelBvh, StaysWithinItsBoundAtAnySize) {
  const Scene scene = test::soup(9000, 0.05F, 7);
  for (std::uint32_t count = 1; count <= scene.triangles.size(); count += 1 + count / 9) {
    std::vector<std::uint32_t> ids(count);
    for (std::uint32_t id = 0; id < count; ++id) { ids[id] = id; }
    const AlignedBytes bytes(encode_voxel_block(scene, ids));

    const VoxelBvh bvh(view_voxel_block(bytes.bytes(), 1).value());

    EXPECT_LE(bvh.bytes(), VoxelBvh::bytes_max(count)) << count << " triangles";
    EXPECT_LE(VoxelBvh::bytes_max(count), bvh_bytes_bound(count)) << count << " triangles";
  }
}

TEST(VoxelBvh, TakesTrianglesThatAllLieInOnePlace) {
  Scene scene = test::empty_scene();
  for (int index = 0; index < 1000; ++index) {
    test::add_triangle(scene, Vec3(0.0F), Vec3(0.5F, 0.0F, 0.0F), Vec3(0.0F, 0.5F, 0.0F));
  }
  std::vector<std::uint32_t> ids(1000);
  for (std::uint32_t id = 0; id < 1000; ++id) { ids[id] = id; }
  const AlignedBytes bytes(encode_voxel_block(scene, ids));
  const VoxelBvh bvh(view_voxel_block(bytes.bytes(), 1).value());

  const MetTriangles met =
      trace_all(bvh, voxel_kernel(), {Vec3(0.1F, 0.1F, 1.0F), Vec3(0.0F, 0.0F, -1.0F)});

  EXPECT_EQ(met.size(), 1000U);
}

}  // namespace
}  // namespace preheat
