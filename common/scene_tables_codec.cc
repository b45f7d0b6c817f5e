#include "common/scene_tables_codec.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdlib>

#include "common/bounded.h"
#include "common/check.h"

namespace preheat {

template <class Archive>
void serialize(Archive& archive, Frame& frame) {
  archive(frame.centre, frame.scale_exponent);
}

template <class Archive>
void serialize(Archive& archive, Material& material) {
  archive(at_most(material.name, kNameBytesMax), material.base_color, material.metallic,
          material.roughness, material.transmission, material.ior, material.thin_walled,
          material.specular_color, material.emission, material.double_sided);
}

template <class Archive>
void serialize(Archive& archive, PunctualLight& light) {
  archive(enum_up_to(light.kind, PunctualLightKind::kDirectional), light.position, light.direction,
          light.intensity, light.range, light.cos_inner, light.cos_outer);
}

template <class Archive>
void serialize(Archive& archive, EmissiveTriangle& triangle) {
  archive(triangle.triangle, triangle.material, triangle.vertices);
}

template <class Archive>
void serialize(Archive& archive, VoxelEntry& voxel) {
  archive(voxel.bounds, voxel.block_offset, voxel.block_bytes, voxel.triangle_count,
          voxel.resident_bytes, voxel.hash);
}

template <class Archive>
void serialize(Archive& archive, VoxelNode& node) {
  archive(node.bounds, node.first, node.count);
}

template <class Archive>
void serialize(Archive& archive, SceneTables& tables) {
  archive(tables.frame, tables.triangle_count, at_most(tables.materials, kMaterialCountMax),
          at_most(tables.lights, kLightCountMax),
          at_most(tables.emissive_triangles, kTriangleCountMax),
          at_most(tables.voxels, kVoxelCountMax), at_most(tables.voxel_nodes, 2 * kVoxelCountMax));
}

namespace {

constexpr std::size_t kBlockAlignment = 16;
constexpr std::int32_t kScaleExponentMax = 1100;  // covers every double

[[nodiscard]] tl::unexpected<Error> wrong(std::string what) {
  return fail(ExitCode::kStoreDamaged, "scene tables: " + std::move(what));
}

[[nodiscard]] bool is_share(float value) { return value >= 0.0F && value <= 1.0F; }
[[nodiscard]] bool is_colour(const Vec3& value) {
  return value.x >= 0.0F && value.y >= 0.0F && value.z >= 0.0F;
}
[[nodiscard]] bool holds(const Aabb& outer, const Aabb& inner) {
  for (int axis = 0; axis < 3; ++axis) {
    if (inner.low[axis] < outer.low[axis] || inner.high[axis] > outer.high[axis]) { return false; }
  }
  return true;
}

[[nodiscard]] Result<void> validate_materials(const SceneTables& tables) {
  if (tables.materials.empty()) { return wrong("no material"); }
  for (std::size_t i = 0; i < tables.materials.size(); ++i) {
    const Material& material = tables.materials[i];
    if (!is_share(material.metallic) || !is_share(material.roughness) ||
        !is_share(material.transmission) || material.ior < 1.0F ||
        !is_colour(material.base_color) || !is_colour(material.specular_color) ||
        !is_colour(material.emission)) {
      return wrong(fmt::format("material {} has a value out of range", i));
    }
  }
  return {};
}

[[nodiscard]] Result<void> validate_emissive(const SceneTables& tables) {
  std::uint64_t id_min = 0;
  for (const EmissiveTriangle& emissive : tables.emissive_triangles) {
    if (emissive.triangle < id_min || emissive.triangle >= tables.triangle_count) {
      return wrong(fmt::format("emissive triangle {} of {} does not ascend or is out of range",
                               emissive.triangle, tables.triangle_count));
    }
    if (emissive.material >= tables.materials.size()) {
      return wrong(fmt::format("emissive triangle {} has material {} of {}", emissive.triangle,
                               emissive.material, tables.materials.size()));
    }
    id_min = std::uint64_t{emissive.triangle} + 1;
  }
  return {};
}

[[nodiscard]] Result<void> validate_voxels(const SceneTables& tables) {
  std::uint64_t offset_min = 0;
  for (std::size_t i = 0; i < tables.voxels.size(); ++i) {
    const VoxelEntry& voxel = tables.voxels[i];
    const bool sized = voxel.block_bytes > 0 && voxel.block_bytes <= kVoxelBytesMax &&
                       voxel.resident_bytes >= voxel.block_bytes && voxel.triangle_count > 0 &&
                       voxel.triangle_count <= tables.triangle_count;
    const bool placed = voxel.block_offset >= offset_min &&
                        voxel.block_offset % kBlockAlignment == 0 &&
                        voxel.block_offset <= ~std::uint64_t{0} - kVoxelBytesMax;
    if (!sized || !placed || voxel.bounds.is_empty()) {
      return wrong(fmt::format("voxel {} ({} bytes at {}, {} triangles) is impossible", i,
                               voxel.block_bytes, voxel.block_offset, voxel.triangle_count));
    }
    offset_min = voxel.block_offset + voxel.block_bytes;
  }
  return {};
}

// Children behind their parents and one parent for every node but the root make it a tree without
// walking it.
[[nodiscard]] Result<void> validate_nodes(const SceneTables& tables) {
  const std::vector<VoxelNode>& nodes = tables.voxel_nodes;
  if (nodes.empty() != tables.voxels.empty()) { return wrong("voxels and nodes disagree"); }
  std::vector<bool> voxel_seen(tables.voxels.size(), false);
  std::uint64_t children_begin = 1;  // children come in the order of their parents
  std::size_t voxels_seen = 0;
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    const VoxelNode& node = nodes[i];
    if (node.count == 0) {
      if (node.first >= tables.voxels.size() || voxel_seen[node.first]) {
        return wrong(fmt::format("node {} is voxel {} of {}, again or out of range", i, node.first,
                                 tables.voxels.size()));
      }
      voxel_seen[node.first] = true;
      ++voxels_seen;
      if (!holds(node.bounds, tables.voxels[node.first].bounds)) {
        return wrong(fmt::format("node {} does not bound its voxel", i));
      }
      continue;
    }
    if (node.first != children_begin || node.first <= i || node.count > nodes.size() - node.first) {
      return wrong(fmt::format("node {} has {} children from {} of {}", i, node.count, node.first,
                               nodes.size()));
    }
    children_begin += node.count;
    for (std::uint32_t child = 0; child < node.count; ++child) {
      if (!holds(node.bounds, nodes[node.first + child].bounds)) {
        return wrong(fmt::format("node {} does not bound its children", i));
      }
    }
  }
  if (voxels_seen != tables.voxels.size() || (!nodes.empty() && children_begin != nodes.size())) {
    return wrong("nodes without a parent or voxels without a node");
  }
  return {};
}

}  // namespace

Result<void> validate_scene_tables(const SceneTables& tables) {
  if (tables.triangle_count > kTriangleCountMax) {
    return wrong(fmt::format("{} triangles, at most {}", tables.triangle_count, kTriangleCountMax));
  }
  if (std::abs(tables.frame.scale_exponent) > kScaleExponentMax) {
    return wrong(fmt::format("scale exponent {}", tables.frame.scale_exponent));
  }
  for (const auto validate :
       {validate_materials, validate_emissive, validate_voxels, validate_nodes}) {
    if (Result<void> valid = validate(tables); !valid) { return valid; }
  }
  return {};
}

std::vector<std::byte> encode_scene_tables(const SceneTables& tables) { return encode(tables); }

Result<SceneTables> decode_scene_tables(std::span<const std::byte> bytes) {
  Result<SceneTables> tables = decode<SceneTables>(bytes, "scene tables", ExitCode::kStoreDamaged);
  if (!tables) { return tables; }
  if (const Result<void> valid = validate_scene_tables(*tables); !valid) {
    return tl::unexpected(valid.error());
  }
  return tables;
}

}  // namespace preheat
