#include "master/import_gltf.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <deque>
#include <memory>
#include <numbers>
#include <optional>
#include <string_view>
#include <utility>
#include <vector>

#include "master/gltf_document.h"
#include "master/gltf_material.h"
#include "master/scene_builder.h"

namespace preheat {

namespace {

constexpr std::size_t kNodeDepthMax = 1000;
constexpr std::size_t kMeshInstancesMax = std::size_t{1} << 22U;

tl::unexpected<Error> rejected(std::string message) {
  return fail(ExitCode::kSceneRejected, std::move(message));
}

// x -> columns * x + origin.
struct Affine {
  std::array<Vec3d, 3> columns{Vec3d{1.0, 0.0, 0.0}, Vec3d{0.0, 1.0, 0.0}, Vec3d{0.0, 0.0, 1.0}};
  Vec3d origin{0.0};

  [[nodiscard]] Vec3d direction(const Vec3d& v) const {
    return columns[0] * v.x + columns[1] * v.y + columns[2] * v.z;
  }
  [[nodiscard]] Vec3d point(const Vec3d& p) const { return direction(p) + origin; }
  [[nodiscard]] double determinant() const {
    return glm::dot(columns[0], glm::cross(columns[1], columns[2]));
  }
};

// NaN where there is no direction. Scaled first, so that no square overflows.
Vec3d unit(const Vec3d& v) {
  return glm::normalize(v / std::max({std::abs(v.x), std::abs(v.y), std::abs(v.z)}));
}

Affine compose(const Affine& outer, const Affine& inner) {
  Affine result;
  for (std::size_t i = 0; i < 3; ++i) { result.columns[i] = outer.direction(inner.columns[i]); }
  result.origin = outer.point(inner.origin);
  return result;
}

// What maps normals: the inverse transpose, up to a positive factor, which also exists where the
// matrix flattens space.
Affine normal_transform(const Affine& matrix) {
  const double sign = matrix.determinant() < 0.0 ? -1.0 : 1.0;
  const auto& [x, y, z] = matrix.columns;
  return {{glm::cross(y, z) * sign, glm::cross(z, x) * sign, glm::cross(x, y) * sign}, Vec3d{0.0}};
}

Result<Affine> local_transform(const tinygltf::Node& node, std::size_t index) {
  const auto has_size = [](const std::vector<double>& values, std::size_t size) {
    return values.empty() || values.size() == size;
  };
  if (!has_size(node.matrix, 16) || !has_size(node.translation, 3) || !has_size(node.rotation, 4) ||
      !has_size(node.scale, 3)) {
    return rejected(fmt::format("node {}: its transform has the wrong number of values", index));
  }
  Affine result;
  if (!node.matrix.empty()) {
    const auto& m = node.matrix;  // column by column
    result.columns = {Vec3d{m[0], m[1], m[2]}, Vec3d{m[4], m[5], m[6]}, Vec3d{m[8], m[9], m[10]}};
    result.origin = {m[12], m[13], m[14]};
    return result;
  }
  if (!node.rotation.empty()) {
    const auto& q = node.rotation;  // x, y, z, w
    const double squared = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
    const double s = squared > 0.0 ? 2.0 / squared : 0.0;  // files hold almost-unit quaternions
    const double xx = q[0] * q[0] * s, yy = q[1] * q[1] * s, zz = q[2] * q[2] * s;
    const double xy = q[0] * q[1] * s, xz = q[0] * q[2] * s, yz = q[1] * q[2] * s;
    const double wx = q[3] * q[0] * s, wy = q[3] * q[1] * s, wz = q[3] * q[2] * s;
    result.columns = {Vec3d{1.0 - yy - zz, xy + wz, xz - wy},
                      Vec3d{xy - wz, 1.0 - xx - zz, yz + wx},
                      Vec3d{xz + wy, yz - wx, 1.0 - xx - yy}};
  }
  for (std::size_t i = 0; i < 3 && !node.scale.empty(); ++i) { result.columns[i] *= node.scale[i]; }
  if (!node.translation.empty()) {
    result.origin = {node.translation[0], node.translation[1], node.translation[2]};
  }
  return result;
}

// A primitive's arrays, shared by all nodes that show it.
struct Primitive {
  std::string label{};
  GltfAccessor positions{};
  std::optional<GltfAccessor> normals{};
  std::optional<GltfAccessor> indices{};
  int mode = TINYGLTF_MODE_TRIANGLES;
  std::uint32_t material = 0;

  [[nodiscard]] std::uint64_t triangle_count() const {
    const std::uint64_t corners = indices ? indices->count() : positions.count();
    if (mode == TINYGLTF_MODE_TRIANGLES) { return corners / 3; }
    return corners < 3 ? 0 : corners - 2;
  }
};

// Where a node puts what it shows.
struct Placement {
  explicit Placement(const Affine& world)
      : world_from_mesh(world),
        world_from_normal(normal_transform(world)),
        is_mirrored(world.determinant() < 0.0) {
    for (const Vec3d& column : world.columns) { scale = std::max(scale, glm::length(column)); }
  }

  Affine world_from_mesh;
  Affine world_from_normal;
  bool is_mirrored;
  double scale = 0.0;  // the largest, along an axis of the mesh
};

// One primitive under one node. A file may multiply these, so they are small.
class GltfMesh : public WorldMesh {
 public:
  // Keeps pointers to both.
  GltfMesh(const Primitive& primitive, const Placement& placement)
      : primitive_(&primitive), placement_(&placement) {}

  [[nodiscard]] std::string label() const override { return primitive_->label; }
  [[nodiscard]] std::uint32_t vertex_count() const override {
    return static_cast<std::uint32_t>(primitive_->positions.count());
  }
  [[nodiscard]] std::uint64_t triangle_count() const override {
    return primitive_->triangle_count();
  }

  // glTF 2.0 section 3.7.2.1.
  [[nodiscard]] Triangle triangle(std::uint64_t index) const override {
    std::array<std::uint64_t, 3> at{};
    switch (primitive_->mode) {
      case TINYGLTF_MODE_TRIANGLE_STRIP:
        at = {index, index + 1 + index % 2, index + 2 - index % 2};
        break;
      case TINYGLTF_MODE_TRIANGLE_FAN:
        at = {index + 1, index + 2, 0};
        break;
      default:
        at = {index * 3, index * 3 + 1, index * 3 + 2};
    }
    if (placement_->is_mirrored) { std::swap(at[1], at[2]); }
    return {{vertex(at[0]), vertex(at[1]), vertex(at[2])}, primitive_->material};
  }

  [[nodiscard]] Vec3d position(std::uint32_t vertex) const override {
    return placement_->world_from_mesh.point(primitive_->positions.vec3(vertex));
  }
  [[nodiscard]] Vec3d normal(std::uint32_t vertex) const override {
    if (!primitive_->normals) { return Vec3d{0.0}; }
    return placement_->world_from_normal.direction(primitive_->normals->vec3(vertex));
  }
  [[nodiscard]] double coordinate_spacing(std::uint32_t vertex) const override {
    if (!primitive_->positions.is_float()) { return 0.0; }
    const Vec3d p = primitive_->positions.vec3(vertex);
    const double largest = std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)});
    return largest > 0.0 ? std::ldexp(placement_->scale, std::ilogb(largest) - 23) : 0.0;
  }

 private:
  [[nodiscard]] std::uint32_t vertex(std::uint64_t corner) const {
    return primitive_->indices ? primitive_->indices->index(corner)
                               : static_cast<std::uint32_t>(corner);
  }

  const Primitive* primitive_;
  const Placement* placement_;
};

// Walks the nodes of a document and collects what they show. The draft points into it.
class GltfImport {
 public:
  explicit GltfImport(const GltfDocument& document) : document_(document), model_(document.model) {}

  Result<SceneDraft> run() {
    GltfMaterials materials = convert_gltf_materials(model_);
    draft_.materials = std::move(materials.materials);
    draft_.notes = std::move(materials.notes);
    if (auto done = read_meshes(); !done) { return tl::unexpected(done.error()); }
    if (auto done = walk_nodes(); !done) { return tl::unexpected(done.error()); }
    add_notes();
    return std::move(draft_);
  }

 private:
  struct PendingNode {
    int index = 0;
    std::size_t depth = 0;
    Affine world_from_parent{};
  };

  Result<void> read_meshes() {
    primitives_.resize(model_.meshes.size());
    for (std::size_t mesh = 0; mesh < model_.meshes.size(); ++mesh) {
      const auto& sources = model_.meshes[mesh].primitives;
      for (std::size_t i = 0; i < sources.size(); ++i) {
        const std::string label = fmt::format("mesh {} primitive {}", mesh, i);
        if (sources[i].mode < TINYGLTF_MODE_TRIANGLES) {
          ++primitives_without_triangles_;
          continue;
        }
        if (!sources[i].targets.empty()) { ++morphed_primitives_; }
        auto primitive = read_primitive(sources[i], label);
        if (!primitive) {
          return rejected(fmt::format("{}: {}", label, primitive.error().message));
        }
        if (primitive->triangle_count() > 0) { primitives_[mesh].push_back(*std::move(primitive)); }
      }
    }
    return {};
  }

  Result<Primitive> read_primitive(const tinygltf::Primitive& source, const std::string& label) {
    if (source.mode > TINYGLTF_MODE_TRIANGLE_FAN) {
      return rejected(fmt::format("there is no primitive mode {}", source.mode));
    }
    Primitive primitive;
    primitive.label = label;
    primitive.mode = source.mode;
    const auto material = material_index(source.material);
    if (!material) { return tl::unexpected(material.error()); }
    primitive.material = *material;
    const auto position = source.attributes.find("POSITION");
    if (position == source.attributes.end()) { return rejected("it has no POSITION"); }
    auto positions = GltfAccessor::make(document_, position->second);
    if (!positions) { return tl::unexpected(positions.error()); }
    if (!positions->is_coordinate()) { return rejected("POSITION is not a vector of 3 numbers"); }
    if (positions->count() > 0xFFFFFFFEU) { return rejected("it has more than 2^32 - 2 vertices"); }
    primitive.positions = *positions;
    if (const auto normal = source.attributes.find("NORMAL"); normal != source.attributes.end()) {
      auto normals = GltfAccessor::make(document_, normal->second);
      if (!normals) { return tl::unexpected(normals.error()); }
      if (!normals->is_coordinate() || normals->count() != positions->count()) {
        return rejected("NORMAL is not one vector of 3 numbers for each POSITION");
      }
      primitive.normals = *normals;
    }
    if (source.indices >= 0) {
      auto indices = GltfAccessor::make(document_, source.indices);
      if (!indices) { return tl::unexpected(indices.error()); }
      if (!indices->is_index()) { return rejected("its indices are not unsigned integers"); }
      primitive.indices = *indices;
    }
    return primitive;
  }

  // Without one, glTF's default material, which is added when the first primitive asks for it.
  Result<std::uint32_t> material_index(int index) {
    if (index >= 0) {
      if (static_cast<std::size_t>(index) >= model_.materials.size()) {
        return rejected(fmt::format("there is no material {}", index));
      }
      return static_cast<std::uint32_t>(index);
    }
    if (draft_.materials.size() == model_.materials.size()) {
      Material material;
      material.name = "glTF default";
      material.base_color = Vec3(1.0F);
      material.metallic = 1.0F;
      material.double_sided = false;
      draft_.materials.push_back(material);
    }
    return static_cast<std::uint32_t>(model_.materials.size());
  }

  // The default scene's roots; without one the first scene's, without any all nodes that are no
  // node's child.
  Result<std::vector<int>> root_nodes() const {
    if (!model_.scenes.empty()) {
      const int scene = std::max(model_.defaultScene, 0);
      if (static_cast<std::size_t>(scene) >= model_.scenes.size()) {
        return rejected(fmt::format("there is no scene {}", scene));
      }
      return model_.scenes[static_cast<std::size_t>(scene)].nodes;
    }
    std::vector<bool> is_child(model_.nodes.size(), false);
    for (const tinygltf::Node& node : model_.nodes) {
      for (const int child : node.children) {
        if (child >= 0 && static_cast<std::size_t>(child) < is_child.size()) {
          is_child[static_cast<std::size_t>(child)] = true;
        }
      }
    }
    std::vector<int> roots;
    for (std::size_t i = 0; i < is_child.size(); ++i) {
      if (!is_child[i]) { roots.push_back(static_cast<int>(i)); }
    }
    return roots;
  }

  // Depth first, in the order of the file, with a stack of our own.
  Result<void> walk_nodes() {
    const auto roots = root_nodes();
    if (!roots) { return tl::unexpected(roots.error()); }
    std::vector<bool> is_visited(model_.nodes.size(), false);
    std::vector<PendingNode> pending;
    for (std::size_t i = roots->size(); i-- > 0;) { pending.push_back({(*roots)[i], 1, {}}); }
    while (!pending.empty()) {
      const PendingNode current = pending.back();
      pending.pop_back();
      const auto index = static_cast<std::size_t>(current.index);
      if (current.index < 0 || index >= model_.nodes.size()) {
        return rejected(fmt::format("there is no node {}", current.index));
      }
      if (is_visited[index]) {
        return rejected(fmt::format("node {} has two parents or is its own ancestor", index));
      }
      if (current.depth > kNodeDepthMax) {
        return rejected(fmt::format("nodes nest deeper than {} levels", kNodeDepthMax));
      }
      is_visited[index] = true;
      const tinygltf::Node& node = model_.nodes[index];
      const auto local = local_transform(node, index);
      if (!local) { return tl::unexpected(local.error()); }
      const Affine world = compose(current.world_from_parent, *local);
      if (auto done = add_node(node, index, world); !done) { return done; }
      for (std::size_t i = node.children.size(); i-- > 0;) {
        pending.push_back({node.children[i], current.depth + 1, world});
      }
    }
    return {};
  }

  Result<void> add_node(const tinygltf::Node& node, std::size_t index, const Affine& world) {
    if (node.mesh >= 0) {
      if (static_cast<std::size_t>(node.mesh) >= primitives_.size()) {
        return rejected(fmt::format("node {}: there is no mesh {}", index, node.mesh));
      }
      if (node.skin >= 0) { ++skinned_nodes_; }
      const auto& primitives = primitives_[static_cast<std::size_t>(node.mesh)];
      if (draft_.meshes.size() + primitives.size() > kMeshInstancesMax) {
        return rejected(fmt::format("more than {} meshes in the nodes", kMeshInstancesMax));
      }
      const Placement& placement = placements_.emplace_back(world);
      for (const Primitive& primitive : primitives) {
        draft_.meshes.push_back(std::make_unique<GltfMesh>(primitive, placement));
      }
    }
    if (node.camera >= 0) {
      if (static_cast<std::size_t>(node.camera) >= model_.cameras.size()) {
        return rejected(fmt::format("node {}: there is no camera {}", index, node.camera));
      }
      add_camera(node, model_.cameras[static_cast<std::size_t>(node.camera)], world);
    }
    const auto light = node.extensions.find("KHR_lights_punctual");
    if (light == node.extensions.end()) { return {}; }
    const double number = gltf_number(light->second, "light", -1.0);
    if (!(number >= 0.0) || !(number < static_cast<double>(model_.lights.size()))) {
      return rejected(fmt::format("node {}: there is no light {}", index, number));
    }
    return add_light(model_.lights[static_cast<std::size_t>(number)], index, world);
  }

  void add_camera(const tinygltf::Node& node, const tinygltf::Camera& source, const Affine& world) {
    Camera camera;
    camera.name = source.name.empty() ? node.name : source.name;
    camera.position_file = world.origin;
    camera.orthographic = source.type == "orthographic";
    camera.vertical_fov_rad = source.perspective.yfov;
    camera.height_file = 2.0 * std::abs(source.orthographic.ymag);
    // A node's scale does not reach its camera, so only the axes' directions count.
    camera.forward = unit(-world.columns[2]);
    camera.right = unit(glm::cross(camera.forward, unit(world.columns[1])));
    camera.up = glm::cross(camera.right, camera.forward);
    const bool is_lens_valid = camera.orthographic ? camera.height_file > 0.0
                                                   : camera.vertical_fov_rad > 0.0 &&
                                                         camera.vertical_fov_rad < std::numbers::pi;
    const Vec3d sum = camera.up + camera.right + camera.position_file;
    if (!is_lens_valid || !std::isfinite(sum.x + sum.y + sum.z)) {
      ++invalid_cameras_;
      return;
    }
    if (camera.name.empty()) { camera.name = fmt::format("camera {}", draft_.cameras.size()); }
    draft_.cameras.push_back(std::move(camera));
  }

  Result<void> add_light(const tinygltf::Light& source, std::size_t index, const Affine& world) {
    WorldLight light;
    if (source.type == "point") {
      light.light.kind = PunctualLightKind::kPoint;
    } else if (source.type == "spot") {
      light.light.kind = PunctualLightKind::kSpot;
    } else if (source.type == "directional") {
      light.light.kind = PunctualLightKind::kDirectional;
    } else {
      return rejected(fmt::format("node {}: there is no light type '{}'", index, source.type));
    }
    Vec3d tint{1.0};
    for (std::size_t i = 0; i < 3 && source.color.size() == 3; ++i) {
      tint[static_cast<int>(i)] = std::max(source.color[i], 0.0);
    }
    light.position_file = world.origin;
    light.intensity_file = tint * std::max(source.intensity, 0.0);
    light.range_file = std::max(source.range, 0.0);
    light.light.direction = Vec3(unit(-world.columns[2]));
    const float sum = light.light.direction.x + light.light.direction.y + light.light.direction.z;
    if (light.light.kind != PunctualLightKind::kPoint && !std::isfinite(sum)) {
      return rejected(fmt::format("node {}: its light has no direction", index));
    }
    if (light.light.kind == PunctualLightKind::kSpot) {
      const double outer = std::clamp(source.spot.outerConeAngle, 0.0, std::numbers::pi / 2.0);
      const double inner = std::clamp(source.spot.innerConeAngle, 0.0, outer);
      // Rounding to float hides the last bit of a double, in which one libm differs from another.
      light.light.cos_inner = static_cast<float>(std::cos(inner));
      light.light.cos_outer = static_cast<float>(std::cos(outer));
    }
    draft_.lights.push_back(light);
    return {};
  }

  void add_notes() {
    const auto add = [&](std::size_t count, std::string_view what) {
      if (count > 0) { draft_.notes.push_back(fmt::format("{} {}", count, what)); }
    };
    add(primitives_without_triangles_, "primitives are points or lines and were left out");
    add(morphed_primitives_, "primitives have morph targets: their base shape is used");
    add(skinned_nodes_, "nodes have skins: their base pose is used");
    add(document_.animation_count, "animations left out");
    add(invalid_cameras_, "cameras have an invalid view and were left out");
    for (const std::string& name : document_.extensions_left_out) {
      draft_.notes.push_back(fmt::format("extension {} left out", name));
    }
  }

  const GltfDocument& document_;
  const tinygltf::Model& model_;
  SceneDraft draft_{};
  std::vector<std::vector<Primitive>> primitives_{};  // by mesh; those with triangles
  std::deque<Placement> placements_{};                // a deque, as meshes point into it
  std::size_t primitives_without_triangles_ = 0;
  std::size_t morphed_primitives_ = 0;
  std::size_t skinned_nodes_ = 0;
  std::size_t invalid_cameras_ = 0;
};

}  // namespace

Result<Scene> import_gltf(const std::filesystem::path& file) {
  const auto document = read_gltf_document(file);
  if (!document) { return tl::unexpected(document.error()); }
  GltfImport importer(*document);
  auto draft = importer.run();
  if (!draft) { return tl::unexpected(draft.error()); }
  return build_scene(*std::move(draft));
}

}  // namespace preheat
