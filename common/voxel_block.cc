#include "common/voxel_block.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>

#include "common/check.h"
#include "common/flat_index.h"
#include "common/triangle_order.h"

namespace preheat {
namespace {

static_assert(std::endian::native == std::endian::little, "blocks are used as they are stored");

constexpr std::uint32_t kMagic = 0x4C585650;  // "PVXL"
constexpr std::uint32_t kHasNormals = 1;
constexpr std::size_t kAlignment = 16;

struct Header {
  std::uint32_t magic = kMagic;
  std::uint32_t vertex_count = 0;
  std::uint32_t triangle_count = 0;
  std::uint32_t flags = 0;
};
static_assert(sizeof(Header) == kAlignment);

constexpr std::uint64_t aligned(std::uint64_t bytes) {
  return (bytes + kAlignment - 1) / kAlignment * kAlignment;
}

// Whether vertices are counted with 16 bits.
constexpr bool is_narrow(std::uint64_t vertex_count) { return vertex_count <= 0x10000U; }

// Where each section begins. The counts are 32-bit, so no sum here can overflow 64 bits.
struct Layout {
  std::uint64_t positions = 0;
  std::uint64_t normals = 0;
  std::uint64_t indices = 0;
  std::uint64_t materials = 0;
  std::uint64_t triangles = 0;
  std::uint64_t end = 0;

  Layout(std::uint64_t vertex_count, std::uint64_t triangle_count, bool has_normals) {
    constexpr std::uint64_t kWord = 4;
    constexpr std::uint64_t kHalf = 2;
    positions = sizeof(Header);
    normals = positions + aligned(3 * kWord * vertex_count + kWord);
    indices = normals + (has_normals ? aligned(kWord * vertex_count) : 0);
    materials = indices + aligned(3 * (is_narrow(vertex_count) ? kHalf : kWord) * triangle_count);
    triangles = materials + aligned(kHalf * triangle_count);
    end = triangles + aligned(kWord * triangle_count);
  }
};

template <class T>
[[nodiscard]] std::span<const T> section(std::span<const std::byte> bytes, std::uint64_t begin,
                                         std::uint64_t count) {
  return {reinterpret_cast<const T*>(bytes.data() + begin), static_cast<std::size_t>(count)};
}

template <class T>
void put(std::vector<std::byte>& bytes, std::uint64_t begin, const std::vector<T>& values) {
  if (!values.empty()) {
    std::memcpy(bytes.data() + begin, values.data(), values.size() * sizeof(T));
  }
}

[[nodiscard]] tl::unexpected<Error> malformed(const std::string& what) {
  return fail(ExitCode::kStoreDamaged, "voxel block: " + what);
}

// What a consistent layout cannot show. Written for the fast case: one pass over each array.
[[nodiscard]] Result<void> check_content(const VoxelBlockView& view, std::size_t material_count) {
  const std::size_t vertex_count = view.positions.size() / 3;
  for (std::size_t i = 0; i < view.positions.size(); ++i) {
    if (!std::isfinite(view.positions[i])) {
      return malformed(fmt::format("vertex {} is not finite", i / 3));
    }
  }
  for (std::size_t i = 0; i < view.indices.size(); ++i) {
    if (view.indices[i] >= vertex_count) {
      return malformed(fmt::format("triangle {} refers to vertex {} of {}", i / 3, view.indices[i],
                                   vertex_count));
    }
  }
  for (const std::uint16_t material : view.materials) {
    if (material >= material_count) {
      return malformed(fmt::format("material {} of {}", material, material_count));
    }
  }
  return {};
}

// Octahedral coordinates are stored as 1 to 65535 with the origin at 32768, so that no normal has
// the code 0.
constexpr float kOctahedralSteps = 32767.0F;
constexpr std::int32_t kOctahedralOrigin = 32768;

[[nodiscard]] float sign_of(float value) { return value < 0.0F ? -1.0F : 1.0F; }

[[nodiscard]] std::uint32_t octahedral_code(std::int32_t u, std::int32_t v) {
  return static_cast<std::uint32_t>(u + kOctahedralOrigin) |
         static_cast<std::uint32_t>(v + kOctahedralOrigin) << 16U;
}

}  // namespace

std::size_t voxel_block_bytes(std::size_t vertex_count, std::size_t triangle_count,
                              bool has_normals) {
  return Layout(vertex_count, triangle_count, has_normals).end;
}

std::vector<std::byte> encode_voxel_block(const Scene& scene,
                                          std::span<const std::uint32_t> triangle_ids) {
  FlatIndex vertices(triangle_ids.size());
  std::vector<Vec3> positions;
  std::vector<std::uint32_t> normals;
  std::vector<std::uint32_t> indices;
  std::vector<std::uint16_t> materials;
  const std::vector<std::uint32_t> triangles = order_for_tree(scene, triangle_ids);
  indices.reserve(3 * triangle_ids.size());
  materials.reserve(triangle_ids.size());
  bool has_normals = false;
  for (const std::uint32_t id : triangles) {
    const Triangle& triangle = scene.triangles[id];
    for (const std::uint32_t vertex : triangle.vertices) {
      const std::uint32_t number = vertices.number_of(vertex);
      indices.push_back(number);
      if (number == positions.size()) {
        positions.push_back(scene.positions[vertex]);
        normals.push_back(encode_normal(scene.normals[vertex]));
        has_normals |= normals.back() != 0;
      }
    }
    CHECK(triangle.material < kMaterialCountMax);
    materials.push_back(static_cast<std::uint16_t>(triangle.material));
  }

  const Layout layout(positions.size(), triangles.size(), has_normals);
  std::vector<std::byte> bytes(layout.end);
  const Header header{.vertex_count = static_cast<std::uint32_t>(positions.size()),
                      .triangle_count = static_cast<std::uint32_t>(triangles.size()),
                      .flags = has_normals ? kHasNormals : 0};
  std::memcpy(bytes.data(), &header, sizeof(header));
  put(bytes, layout.positions, positions);
  if (has_normals) { put(bytes, layout.normals, normals); }
  if (is_narrow(positions.size())) {
    put(bytes, layout.indices, std::vector<std::uint16_t>(indices.begin(), indices.end()));
  } else {
    put(bytes, layout.indices, indices);
  }
  put(bytes, layout.materials, materials);
  put(bytes, layout.triangles, triangles);
  return bytes;
}

Result<VoxelBlockView> view_voxel_block(std::span<const std::byte> bytes,
                                        std::size_t material_count) {
  CHECK(std::bit_cast<std::uintptr_t>(bytes.data()) % kAlignment == 0);
  if (bytes.size() < sizeof(Header)) {
    return malformed(fmt::format("{} bytes are less than a header", bytes.size()));
  }
  Header header;
  std::memcpy(&header, bytes.data(), sizeof(header));
  if (header.magic != kMagic) { return malformed(fmt::format("magic {:#x}", header.magic)); }
  if ((header.flags & ~kHasNormals) != 0) {
    return malformed(fmt::format("unknown flags {:#x}", header.flags));
  }
  const bool has_normals = (header.flags & kHasNormals) != 0;
  const Layout layout(header.vertex_count, header.triangle_count, has_normals);
  if (layout.end != bytes.size()) {
    return malformed(fmt::format("{} vertices and {} triangles need {} bytes, not {}",
                                 header.vertex_count, header.triangle_count, layout.end,
                                 bytes.size()));
  }
  const std::uint64_t vertex_count = header.vertex_count;
  const std::uint64_t triangle_count = header.triangle_count;
  const VoxelBlockView view{
      .positions = section<float>(bytes, layout.positions, 3 * vertex_count),
      .normals = section<std::uint32_t>(bytes, layout.normals, has_normals ? vertex_count : 0),
      .indices =
          is_narrow(vertex_count)
              ? PackedIndices(section<std::uint16_t>(bytes, layout.indices, 3 * triangle_count))
              : PackedIndices(section<std::uint32_t>(bytes, layout.indices, 3 * triangle_count)),
      .materials = section<std::uint16_t>(bytes, layout.materials, triangle_count),
      .triangles = section<std::uint32_t>(bytes, layout.triangles, triangle_count)};
  if (const Result<void> checked = check_content(view, material_count); !checked) {
    return tl::unexpected(checked.error());
  }
  return view;
}

// Rounding each coordinate by itself is not the best choice near the octahedron's edges: of the
// four grid points around the projection the nearest to the direction is taken.
std::uint32_t encode_normal(const Vec3& unit) {
  const double sum = std::abs(static_cast<double>(unit.x)) + std::abs(static_cast<double>(unit.y)) +
                     std::abs(static_cast<double>(unit.z));
  if (!(sum > 0.0) || !std::isfinite(sum)) { return 0; }
  double u = static_cast<double>(unit.x) / sum;
  double v = static_cast<double>(unit.y) / sum;
  if (unit.z < 0.0F) {
    const double folded_u = (1.0 - std::abs(v)) * static_cast<double>(sign_of(unit.x));
    v = (1.0 - std::abs(u)) * static_cast<double>(sign_of(unit.y));
    u = folded_u;
  }
  const auto floor_step = [](double value) {
    const double step = std::floor(value * static_cast<double>(kOctahedralSteps));
    return std::clamp(static_cast<std::int32_t>(step), -32767, 32766);
  };
  const std::int32_t u_step = floor_step(u);
  const std::int32_t v_step = floor_step(v);
  const Vec3d wanted = Vec3d(unit) / std::sqrt(glm::dot(Vec3d(unit), Vec3d(unit)));
  std::uint32_t best = 0;
  double best_distance = 4.0;
  for (const std::int32_t du : {0, 1}) {
    for (const std::int32_t dv : {0, 1}) {
      const std::uint32_t code = octahedral_code(u_step + du, v_step + dv);
      const Vec3d off = Vec3d(decode_normal(code)) - wanted;
      const double distance = glm::dot(off, off);
      if (distance < best_distance) {
        best = code;
        best_distance = distance;
      }
    }
  }
  return best;
}

Vec3 decode_normal(std::uint32_t code) {
  const auto coordinate = [](std::uint32_t half) {
    return static_cast<float>(static_cast<std::int32_t>(half) - kOctahedralOrigin) /
           kOctahedralSteps;
  };
  float x = coordinate(code & 0xFFFFU);
  float y = coordinate(code >> 16U);
  const float z = 1.0F - std::abs(x) - std::abs(y);
  if (z < 0.0F) {
    const float folded_x = (1.0F - std::abs(y)) * sign_of(x);
    y = (1.0F - std::abs(x)) * sign_of(y);
    x = folded_x;
  }
  const float length = std::sqrt(x * x + y * y + z * z);
  return {x / length, y / length, z / length};
}

}  // namespace preheat
