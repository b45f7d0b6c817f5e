#include "master/import_gltf.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <string>
#include <vector>

#include "tests/master/scene_files.h"

namespace preheat {
namespace {

using Json = nlohmann::json;

Vec3d normal_of(const Scene& scene, std::uint32_t triangle) {
  const Vec3d a = file_position(scene, triangle, 0);
  return glm::normalize(
      glm::cross(file_position(scene, triangle, 1) - a, file_position(scene, triangle, 2) - a));
}

void expect_near(const Vec3d& actual, const Vec3d& expected, double tolerance = 1e-6) {
  EXPECT_LE(glm::length(actual - expected), tolerance)
      << actual.x << " " << actual.y << " " << actual.z;
}

// A triangle with 12 positions' worth of corners, drawn in the given mode over 5 vertices.
Json gltf_in_mode(int mode) {
  Json gltf = triangle_gltf();
  gltf["meshes"][0]["primitives"][0] = {{"attributes", {{"POSITION", 0}}}, {"mode", mode}};
  gltf["accessors"] = {
      {{"bufferView", 0}, {"componentType", 5126}, {"count", 5}, {"type", "VEC3"}}};
  gltf["bufferViews"] = {{{"buffer", 0}, {"byteLength", 60}}};
  gltf["buffers"][0]["byteLength"] = 60;
  return gltf;
}

// A band of triangles in the plane z = 0 that a strip winds counter-clockwise.
std::string band() { return bytes_of<float>({0, 0, 0, 1, 0, 0, 0.5F, 1, 0, 1.5F, 1, 0, 1, 2, 0}); }

TEST(ImportGltf, ReadsATriangle) {
  const auto scene = import_gltf_json(triangle_gltf());

  ASSERT_TRUE(scene) << scene.error().message;
  ASSERT_EQ(scene->triangles.size(), 1U);
  expect_near(file_position(*scene, 0, 1), {2.0, 0.0, 0.0});
  expect_near(file_position(*scene, 0, 2), {0.0, 1.0, 0.0});
  EXPECT_EQ(scene->normals[0], Vec3{0.0F});
  EXPECT_EQ(scene->materials.at(0).name, "paint");
  EXPECT_TRUE(scene->import.notes.empty());
}

TEST(ImportGltf, ReadsStripsAndFansWithTheirWinding) {
  const auto strip = import_gltf_json(gltf_in_mode(5), band());
  const auto fan = import_gltf_json(gltf_in_mode(6), band());

  ASSERT_TRUE(strip) << strip.error().message;
  ASSERT_TRUE(fan) << fan.error().message;
  EXPECT_EQ(strip->import.triangles_declared, 3U);
  for (std::uint32_t i = 0; i < strip->triangles.size(); ++i) {
    expect_near(normal_of(*strip, i), {0.0, 0.0, 1.0});
  }
  EXPECT_EQ(fan->import.triangles_declared, 3U);
  expect_near(file_position(*fan, 0, 2), {0.0, 0.0, 0.0});
  expect_near(file_position(*fan, 2, 0), {1.5, 1.0, 0.0});
}

TEST(ImportGltf, SkipsPointsAndLines) {
  Json gltf = triangle_gltf();
  Json line = gltf["meshes"][0]["primitives"][0];
  line["mode"] = 1;
  gltf["meshes"][0]["primitives"].push_back(line);

  const auto scene = import_gltf_json(gltf);

  ASSERT_TRUE(scene);
  EXPECT_EQ(scene->triangles.size(), 1U);
  EXPECT_TRUE(has_note(*scene, "1 primitives are points or lines"));
}

TEST(ImportGltf, AppliesTransformsFromTheRootDown) {
  Json gltf = triangle_gltf();
  // 90 degrees about z, then a shift; below it a scale.
  gltf["nodes"] = {{{"children", {1}},
                    {"translation", {10.0, 0.0, 0.0}},
                    {"rotation", {0.0, 0.0, std::sqrt(0.5), std::sqrt(0.5)}}},
                   {{"mesh", 0}, {"scale", {3.0, 1.0, 1.0}}}};

  const auto scene = import_gltf_json(gltf);

  ASSERT_TRUE(scene);
  expect_near(file_position(*scene, 0, 0), {10.0, 0.0, 0.0});
  expect_near(file_position(*scene, 0, 1), {10.0, 6.0, 0.0});
  expect_near(file_position(*scene, 0, 2), {9.0, 0.0, 0.0});
}

TEST(ImportGltf, ReadsMatricesByColumn) {
  Json gltf = triangle_gltf();
  gltf["nodes"][0]["matrix"] = {0, 1, 0, 0, 0, 0, 1, 0, 1, 0, 0, 0, 5, 6, 7, 1};

  const auto scene = import_gltf_json(gltf);

  ASSERT_TRUE(scene);
  expect_near(file_position(*scene, 0, 1), {5.0, 8.0, 7.0});
  expect_near(file_position(*scene, 0, 2), {5.0, 6.0, 8.0});
}

// The triangle with a normal for each vertex, all (0, 0.6, 0.8).
Json gltf_with_normals() {
  Json gltf = triangle_gltf();
  gltf["meshes"][0]["primitives"][0] = {{"attributes", {{"POSITION", 0}, {"NORMAL", 1}}}};
  gltf["accessors"][1] = gltf["accessors"][0];
  gltf["accessors"][1]["bufferView"] = 1;
  gltf["bufferViews"][1]["byteLength"] = 36;
  gltf["buffers"][0]["byteLength"] = 72;
  return gltf;
}

std::string bin_with_normals() {
  return triangle_bin().substr(0, 36) +
         bytes_of<float>({0, 0.6F, 0.8F, 0, 0.6F, 0.8F, 0, 0.6F, 0.8F});
}

TEST(ImportGltf, TransformsNormalsByTheInverseTranspose) {
  Json gltf = gltf_with_normals();
  gltf["nodes"][0]["scale"] = {1.0, 2.0, 4.0};

  const auto scene = import_gltf_json(gltf, bin_with_normals());

  ASSERT_TRUE(scene);
  expect_near(Vec3d(scene->normals[0]), glm::normalize(Vec3d{0.0, 0.3, 0.2}));
}

TEST(ImportGltf, KeepsTheOutsideOutsideInAMirror) {
  Json gltf = gltf_with_normals();
  gltf["nodes"][0]["scale"] = {-1.0, 1.0, 1.0};

  const auto scene = import_gltf_json(gltf, bin_with_normals());

  ASSERT_TRUE(scene);
  expect_near(normal_of(*scene, 0), {0.0, 0.0, 1.0});
  expect_near(Vec3d(scene->normals[0]), {0.0, 0.6, 0.8});
}

TEST(ImportGltf, TakesTheDefaultSceneElseTheFirstElseAllRoots) {
  Json gltf = triangle_gltf();
  gltf["nodes"] = {{{"mesh", 0}}, {{"mesh", 0}, {"children", {2}}}, {{"mesh", 0}}};
  gltf["scenes"] = {{{"nodes", {0}}}, {{"nodes", {1}}}};
  gltf["scene"] = 1;
  EXPECT_EQ(import_gltf_json(gltf).value().triangles.size(), 2U);

  gltf.erase("scene");
  EXPECT_EQ(import_gltf_json(gltf).value().triangles.size(), 1U);

  gltf.erase("scenes");
  EXPECT_EQ(import_gltf_json(gltf).value().triangles.size(), 3U);
}

TEST(ImportGltf, ReadsInterleavedVertices) {
  Json gltf = gltf_with_normals();
  gltf["bufferViews"] = {{{"buffer", 0}, {"byteLength", 72}, {"byteStride", 24}}};
  gltf["accessors"][1]["bufferView"] = 0;
  gltf["accessors"][1]["byteOffset"] = 12;
  const std::string bin = bytes_of<float>({0, 0, 0, 0, 0, 1, 2, 0, 0, 0, 0, 1, 0, 1, 0, 0, 1, 0});

  const auto scene = import_gltf_json(gltf, bin);

  ASSERT_TRUE(scene) << scene.error().message;
  expect_near(file_position(*scene, 0, 2), {0.0, 1.0, 0.0});
  EXPECT_EQ(scene->normals[2], (Vec3{0.0F, 1.0F, 0.0F}));
}

TEST(ImportGltf, ReadsQuantisedPositions) {
  Json gltf = triangle_gltf();
  gltf["extensionsRequired"] = {"KHR_mesh_quantization"};
  gltf["accessors"][0] = {{"bufferView", 0},
                          {"componentType", 5122},
                          {"count", 3},
                          {"type", "VEC3"},
                          {"normalized", true}};
  gltf["bufferViews"][0] = {{"buffer", 0}, {"byteLength", 24}, {"byteStride", 8}};
  gltf["bufferViews"][1]["byteOffset"] = 24;
  const std::string bin = bytes_of<std::int16_t>({0, 0, 0, 0, 32767, 0, 0, 0, 0, -32768, 0, 0}) +
                          triangle_bin().substr(36) + std::string(12, '\0');

  const auto scene = import_gltf_json(gltf, bin);

  ASSERT_TRUE(scene) << scene.error().message;
  expect_near(file_position(*scene, 0, 1), {1.0, 0.0, 0.0});
  expect_near(file_position(*scene, 0, 2), {0.0, -1.0, 0.0});
}

Json gltf_with_sparse_positions() {
  Json gltf = triangle_gltf();
  gltf["bufferViews"].push_back({{"buffer", 0}, {"byteOffset", 44}, {"byteLength", 2}});
  gltf["bufferViews"].push_back({{"buffer", 0}, {"byteOffset", 48}, {"byteLength", 24}});
  gltf["accessors"][0]["sparse"] = {{"count", 2},
                                    {"indices", {{"bufferView", 2}, {"componentType", 5121}}},
                                    {"values", {{"bufferView", 3}}}};
  gltf["buffers"][0]["byteLength"] = 72;
  return gltf;
}

std::string sparse_bin(std::uint8_t first, std::uint8_t second) {
  return triangle_bin() + bytes_of<std::uint8_t>({first, second, 0, 0}) +
         bytes_of<float>({4, 0, 0, 0, 8, 0});
}

TEST(ImportGltf, ReadsSparseAccessors) {
  const auto scene = import_gltf_json(gltf_with_sparse_positions(), sparse_bin(1, 2));

  ASSERT_TRUE(scene) << scene.error().message;
  expect_near(file_position(*scene, 0, 0), {0.0, 0.0, 0.0});
  expect_near(file_position(*scene, 0, 1), {4.0, 0.0, 0.0});
  expect_near(file_position(*scene, 0, 2), {0.0, 8.0, 0.0});
}

TEST(ImportGltf, RefusesSparseIndicesOutOfRangeOrOrder) {
  const Json gltf = gltf_with_sparse_positions();

  EXPECT_TRUE(is_rejected(import_gltf_json(gltf, sparse_bin(1, 3)), "sparse index 3"));
  EXPECT_TRUE(is_rejected(import_gltf_json(gltf, sparse_bin(2, 1)), "sparse index 1"));
  EXPECT_TRUE(is_rejected(import_gltf_json(gltf, sparse_bin(1, 1)), "sparse index 1"));
}

TEST(ImportGltf, ReadsDataUrisAndPercentEscapes) {
  Json embedded = triangle_gltf();
  embedded["buffers"][0]["uri"] =
      "data:application/"
      "octet-stream;base64,AAAAAAAAAAAAAAAAAAAAQAAAAAAAAAAAAAAAAAAAgD8AAAAAAAABAAIAAAA=";
  EXPECT_EQ(import_gltf_json(embedded).value().triangles.size(), 1U);

  Json escaped = triangle_gltf();
  escaped["buffers"][0]["uri"] = "%73cene%2Ebin";
  EXPECT_EQ(import_gltf_json(escaped).value().triangles.size(), 1U);
}

TEST(ImportGltf, ReadsMaterialsAndTheirExtensions) {
  Json gltf = triangle_gltf();
  gltf["materials"][0] = {
      {"name", "all"},
      {"doubleSided", true},
      {"pbrMetallicRoughness",
       {{"baseColorFactor", {0.1, 0.2, 0.3, 1.0}},
        {"metallicFactor", 0.25},
        {"roughnessFactor", 0.0}}},
      {"emissiveFactor", {1.0, 0.5, 0.25}},
      {"extensions",
       {{"KHR_materials_emissive_strength", {{"emissiveStrength", 40.0}}},
        {"KHR_materials_ior", {{"ior", 1.33}}},
        {"KHR_materials_transmission", {{"transmissionFactor", 0.75}}},
        {"KHR_materials_volume", {{"thicknessFactor", 0.1}}},
        {"KHR_materials_specular",
         {{"specularFactor", 0.5}, {"specularColorFactor", {1.0, 0.5, 0.0}}}}}}};

  const auto scene = import_gltf_json(gltf);

  ASSERT_TRUE(scene);
  const Material& material = scene->materials.at(0);
  EXPECT_EQ(material.base_color, (Vec3{0.1F, 0.2F, 0.3F}));
  EXPECT_EQ(material.metallic, 0.25F);
  EXPECT_EQ(material.roughness, 0.0F);
  EXPECT_EQ(material.transmission, 0.75F);
  EXPECT_EQ(material.ior, 1.33F);
  EXPECT_FALSE(material.thin_walled);
  EXPECT_EQ(material.specular_color, (Vec3{0.5F, 0.25F, 0.0F}));
  EXPECT_EQ(material.emission, (Vec3{40.0F, 20.0F, 10.0F}));
  EXPECT_TRUE(material.double_sided);
}

TEST(ImportGltf, UsesTheDefaultsOfTheSpecification) {
  Json gltf = triangle_gltf();
  gltf["materials"][0] = {
      {"extensions", {{"KHR_materials_transmission", {{"transmissionFactor", 1}}}}}};
  Json without_material = triangle_gltf();
  without_material["meshes"][0]["primitives"][0].erase("material");

  const Material material = import_gltf_json(gltf).value().materials.at(0);
  const Scene plain = import_gltf_json(without_material).value();

  EXPECT_EQ(material.base_color, Vec3{1.0F});
  EXPECT_EQ(material.metallic, 1.0F);
  EXPECT_EQ(material.roughness, 1.0F);
  EXPECT_EQ(material.ior, 1.5F);
  EXPECT_TRUE(material.thin_walled);
  EXPECT_FALSE(material.double_sided);
  EXPECT_EQ(plain.triangles[0].material, 1U);
  EXPECT_EQ(plain.materials.at(1).metallic, 1.0F);
}

TEST(ImportGltf, SaysWhatItLeavesOut) {
  Json gltf = triangle_gltf();
  gltf["extensionsUsed"] = {"KHR_materials_clearcoat", "KHR_texture_transform",
                            "KHR_materials_ior"};
  gltf["materials"] = {
      {{"alphaMode", "MASK"}, {"pbrMetallicRoughness", {{"baseColorTexture", {{"index", 0}}}}}},
      {{"pbrMetallicRoughness", {{"baseColorTexture", {{"index", 7}}}}}}};
  gltf["textures"] = {{{"source", 0}}};
  gltf["images"] = {{{"uri", "../../etc/passwd"}}};  // must not even be looked at
  gltf["animations"] = Json::array({Json::object()});
  gltf["nodes"][0]["skin"] = 0;

  const auto scene = import_gltf_json(gltf);

  ASSERT_TRUE(scene) << scene.error().message;
  EXPECT_TRUE(has_note(*scene, "2 base colour textures left out"));
  EXPECT_TRUE(has_note(*scene, "1 materials are cut out by alpha"));
  EXPECT_TRUE(has_note(*scene, "extension KHR_materials_clearcoat left out"));
  EXPECT_TRUE(has_note(*scene, "1 animations"));
  EXPECT_TRUE(has_note(*scene, "1 nodes have skins"));
  EXPECT_EQ(scene->import.notes.size(), 5U);
}

TEST(ImportGltf, ReadsCameras) {
  Json gltf = triangle_gltf();
  gltf["cameras"] = {
      {{"name", "eye"}, {"type", "perspective"}, {"perspective", {{"yfov", 0.7}, {"znear", 0.1}}}},
      {{"type", "orthographic"},
       {"orthographic", {{"xmag", 3.0}, {"ymag", 2.0}, {"zfar", 9.0}, {"znear", 0.1}}}},
      {{"type", "perspective"}, {"perspective", {{"yfov", 4.0}, {"znear", 0.1}}}}};
  gltf["nodes"] = {{{"mesh", 0}, {"children", {1, 2, 3}}, {"scale", {2.0, 2.0, 2.0}}},
                   // Looks along -x: 90 degrees about y.
                   {{"camera", 0},
                    {"translation", {1.0, 2.0, 3.0}},
                    {"rotation", {0.0, std::sqrt(0.5), 0.0, std::sqrt(0.5)}}},
                   {{"camera", 1}, {"name", "plan"}},
                   {{"camera", 2}}};

  const auto scene = import_gltf_json(gltf);

  ASSERT_TRUE(scene) << scene.error().message;
  ASSERT_EQ(scene->cameras.size(), 2U);
  const Camera& eye = scene->cameras[0];
  EXPECT_EQ(eye.name, "eye");
  expect_near(eye.position_file, {2.0, 4.0, 6.0});
  expect_near(eye.forward, {-1.0, 0.0, 0.0});
  expect_near(eye.up, {0.0, 1.0, 0.0});
  expect_near(glm::cross(eye.right, eye.up), -eye.forward);
  EXPECT_EQ(eye.vertical_fov_rad, 0.7);
  EXPECT_EQ(scene->cameras[1].name, "plan");
  EXPECT_TRUE(scene->cameras[1].orthographic);
  EXPECT_EQ(scene->cameras[1].height_file, 4.0);
  EXPECT_TRUE(has_note(*scene, "1 cameras"));
}

TEST(ImportGltf, ReadsPunctualLights) {
  Json gltf = triangle_gltf();
  gltf["extensions"]["KHR_lights_punctual"]["lights"] = {
      {{"type", "spot"},
       {"color", {1.0, 0.5, 0.0}},
       {"intensity", 8.0},
       {"range", 6.0},
       {"spot", {{"innerConeAngle", 0.3}, {"outerConeAngle", 0.6}}}},
      {{"type", "directional"}, {"intensity", 2.0}}};
  gltf["nodes"] = {
      {{"mesh", 0}},
      {{"translation", {1.0, 0.5, 2.0}}, {"extensions", {{"KHR_lights_punctual", {{"light", 0}}}}}},
      // Shines along -y: -90 degrees about x.
      {{"rotation", {-std::sqrt(0.5), 0.0, 0.0, std::sqrt(0.5)}},
       {"extensions", {{"KHR_lights_punctual", {{"light", 1}}}}}}};
  gltf["scenes"][0]["nodes"] = {0, 1, 2};

  const auto scene = import_gltf_json(gltf);

  ASSERT_TRUE(scene) << scene.error().message;
  ASSERT_EQ(scene->frame.scale_exponent, 0);
  ASSERT_EQ(scene->lights.size(), 2U);
  const PunctualLight& spot = scene->lights[0];
  EXPECT_EQ(spot.kind, PunctualLightKind::kSpot);
  expect_near(Vec3d(spot.position), {0.0, 0.0, 2.0});
  expect_near(Vec3d(spot.direction), {0.0, 0.0, -1.0});
  EXPECT_EQ(spot.intensity, (Vec3{8.0F, 4.0F, 0.0F}));
  EXPECT_EQ(spot.range, 6.0F);
  EXPECT_NEAR(spot.cos_inner, std::cos(0.3), 1e-6);
  EXPECT_NEAR(spot.cos_outer, std::cos(0.6), 1e-6);
  EXPECT_EQ(scene->lights[1].kind, PunctualLightKind::kDirectional);
  expect_near(Vec3d(scene->lights[1].direction), {0.0, -1.0, 0.0});
  EXPECT_EQ(scene->lights[1].intensity, Vec3{2.0F});
}

std::string glb_of(std::string json, std::string binary) {
  json.resize((json.size() + 3) / 4 * 4, ' ');
  binary.resize((binary.size() + 3) / 4 * 4, '\0');
  const auto u32 = [](std::size_t value) {
    return bytes_of<std::uint32_t>({static_cast<std::uint32_t>(value)});
  };
  return "glTF" + u32(2) + u32(28 + json.size() + binary.size()) + u32(json.size()) + "JSON" +
         json + u32(binary.size()) + std::string("BIN\0", 4) + binary;
}

std::string triangle_glb() {
  Json gltf = triangle_gltf();
  gltf["buffers"][0].erase("uri");
  return glb_of(gltf.dump(), triangle_bin());
}

TEST(ImportGltf, ReadsGlb) {
  const TemporaryFolder folder;

  // The content, not the name, says what it is.
  EXPECT_EQ(import_scene(folder.write("a.glb", triangle_glb())).value().triangles.size(), 1U);
  EXPECT_EQ(import_scene(folder.write("b.gltf", triangle_glb())).value().triangles.size(), 1U);
}

TEST(ImportGltf, RefusesEveryTruncationOfAGlb) {
  const TemporaryFolder folder;
  const std::string glb = triangle_glb();
  for (std::size_t size = 0; size < glb.size(); ++size) {
    EXPECT_TRUE(is_rejected(import_scene(folder.write("a.glb", glb.substr(0, size))), "a.glb"))
        << size;
  }
}

void expect_scene_holds_together(const Scene& scene) {
  for (const Triangle& triangle : scene.triangles) {
    ASSERT_LT(triangle.material, scene.materials.size());
    for (const std::uint32_t vertex : triangle.vertices) {
      ASSERT_LT(vertex, scene.positions.size());
      const Vec3& position = scene.positions[vertex];
      ASSERT_LE(std::max({std::abs(position.x), std::abs(position.y), std::abs(position.z)}), 1.0F);
    }
  }
  for (const Material& material : scene.materials) {
    for (int axis = 0; axis < 3; ++axis) {
      ASSERT_TRUE(material.base_color[axis] >= 0.0F && material.base_color[axis] <= 1.0F);
      ASSERT_TRUE(material.emission[axis] >= 0.0F && std::isfinite(material.emission[axis]));
    }
    ASSERT_TRUE(material.ior >= 1.0F && std::isfinite(material.ior));
  }
  for (const PunctualLight& light : scene.lights) {
    ASSERT_TRUE(std::isfinite(glm::dot(light.position, light.intensity)));
    ASSERT_NEAR(glm::length(light.direction), 1.0F, 1e-5F);
  }
  for (const Camera& camera : scene.cameras) {
    ASSERT_NEAR(glm::length(camera.forward), 1.0, 1e-9);
    ASSERT_NEAR(glm::dot(camera.up, camera.right), 0.0, 1e-9);
  }
}

TEST(ImportGltf, SurvivesEveryFlippedByteOfAGlb) {
  const TemporaryFolder folder;
  const std::string glb = triangle_glb();
  std::size_t accepted = 0;
  for (std::size_t at = 0; at < glb.size(); ++at) {
    for (const int flip : {0x01, 0x10, 0x80}) {
      std::string damaged = glb;
      damaged[at] = static_cast<char>(damaged[at] ^ flip);
      const auto scene = import_scene(folder.write("a.glb", damaged));
      if (!scene) {
        EXPECT_EQ(scene.error().code, ExitCode::kSceneRejected);
        continue;
      }
      ++accepted;
      expect_scene_holds_together(*scene);
    }
  }
  EXPECT_GT(accepted, 100U);  // names, padding, coordinates
}

struct HostileCase {
  const char* name;
  const char* message;
  std::function<void(Json&)> damage;
};

class ImportGltfRefuses : public ::testing::TestWithParam<HostileCase> {};

TEST_P(ImportGltfRefuses, HostileFiles) {
  Json gltf = triangle_gltf();
  GetParam().damage(gltf);

  EXPECT_TRUE(is_rejected(import_gltf_json(gltf), GetParam().message));
}

Json& primitive(Json& gltf) { return gltf["meshes"][0]["primitives"][0]; }

// A chain of `length` nodes, the last of which shows the mesh.
void make_chain(Json& gltf, int length) {
  gltf["nodes"] = Json::array();
  for (int i = 1; i < length; ++i) { gltf["nodes"].push_back({{"children", {i}}}); }
  gltf["nodes"].push_back({{"mesh", 0}});
}

const HostileCase kHostileCases[] = {
    {"AccessorOutOfRange", "no accessor 99",
     [](Json& gltf) { primitive(gltf)["attributes"]["POSITION"] = 99; }},
    {"AccessorNegative", "no accessor -3",
     [](Json& gltf) { primitive(gltf)["attributes"]["POSITION"] = -3; }},
    {"IndicesOutOfRange", "out of bounds", [](Json& gltf) { primitive(gltf)["indices"] = 99; }},
    {"MaterialOutOfRange", "no material 5", [](Json& gltf) { primitive(gltf)["material"] = 5; }},
    {"ModeUnknown", "mode 9", [](Json& gltf) { primitive(gltf)["mode"] = 9; }},
    {"NoPosition", "no POSITION",
     [](Json& gltf) {
       primitive(gltf)["attributes"] = {{"COLOR_0", 0}};
     }},
    {"NoAttributes", "attributes", [](Json& gltf) { primitive(gltf).erase("attributes"); }},
    {"NormalsOfAnotherCount", "NORMAL",
     [](Json& gltf) {
       gltf["accessors"].push_back(gltf["accessors"][0]);
       gltf["accessors"][2]["count"] = 2;
       primitive(gltf)["attributes"]["NORMAL"] = 2;
     }},
    {"MeshOutOfRange", "no mesh 1", [](Json& gltf) { gltf["nodes"][0]["mesh"] = 1; }},
    {"CameraOutOfRange", "no camera 0", [](Json& gltf) { gltf["nodes"][0]["camera"] = 0; }},
    {"LightOutOfRange", "no light 2",
     [](Json& gltf) { gltf["nodes"][0]["extensions"]["KHR_lights_punctual"]["light"] = 2; }},
    {"SceneOutOfRange", "no scene 1", [](Json& gltf) { gltf["scene"] = 1; }},
    {"NodeOutOfRange", "no node 4", [](Json& gltf) { gltf["scenes"][0]["nodes"] = {4}; }},
    {"ChildNegative", "no node -1", [](Json& gltf) { gltf["nodes"][0]["children"] = {-1}; }},
    {"NodeIsItsOwnChild", "its own ancestor",
     [](Json& gltf) { gltf["nodes"][0]["children"] = {0}; }},
    {"NodeCycle", "its own ancestor",
     [](Json& gltf) {
       gltf["nodes"] = {{{"children", {1}}}, {{"children", {2}}}, {{"children", {0}}}};
     }},
    {"SharedChild", "two parents",
     [](Json& gltf) {
       gltf["nodes"] = {
           {{"children", {1, 2}}}, {{"children", {3}}}, {{"children", {3}}}, {{"mesh", 0}}};
     }},
    {"ChainTooDeep", "nest deeper", [](Json& gltf) { make_chain(gltf, 100'000); }},
    {"MatrixTooShort", "transform",
     [](Json& gltf) {
       gltf["nodes"][0]["matrix"] = {1, 0, 0};
     }},
    {"RotationTooLong", "transform",
     [](Json& gltf) {
       gltf["nodes"][0]["rotation"] = {0, 0, 0, 1, 0};
     }},
    {"IndexValueOutOfRange", "vertex index 2, but there are 2",
     [](Json& gltf) { gltf["accessors"][0]["count"] = 2; }},
    {"CountHuge", "do not fit",
     [](Json& gltf) { gltf["accessors"][0]["count"] = std::uint64_t{1} << 62U; }},
    {"CountJustTooLarge", "do not fit", [](Json& gltf) { gltf["accessors"][1]["count"] = 4; }},
    {"CountNegative", "count", [](Json& gltf) { gltf["accessors"][0]["count"] = -3; }},
    {"AccessorOffsetTooLarge", "do not fit",
     [](Json& gltf) { gltf["accessors"][0]["byteOffset"] = 4; }},
    {"AccessorOffsetHuge", "beyond buffer view",
     [](Json& gltf) { gltf["accessors"][0]["byteOffset"] = ~std::uint64_t{0}; }},
    {"ComponentTypeDouble", "component type 5130",
     [](Json& gltf) { gltf["accessors"][0]["componentType"] = 5130; }},
    {"ComponentTypeUnknown", "componentType",
     [](Json& gltf) { gltf["accessors"][0]["componentType"] = 1; }},
    {"PositionsAreScalars", "POSITION",
     [](Json& gltf) { gltf["accessors"][0]["type"] = "SCALAR"; }},
    {"IndicesAreFloats", "unsigned integers",
     [](Json& gltf) {
       gltf["accessors"][1] = {
           {"bufferView", 0}, {"componentType", 5126}, {"count", 3}, {"type", "SCALAR"}};
     }},
    {"StrideBelowElement", "overlap", [](Json& gltf) { gltf["bufferViews"][0]["byteStride"] = 4; }},
    {"NoBufferView", "buffer view", [](Json& gltf) { gltf["accessors"][0].erase("bufferView"); }},
    {"BufferViewOutOfRange", "no buffer view 7",
     [](Json& gltf) { gltf["accessors"][0]["bufferView"] = 7; }},
    {"BufferOutOfRange", "no buffer 3", [](Json& gltf) { gltf["bufferViews"][0]["buffer"] = 3; }},
    {"ViewBeyondBuffer", "beyond buffer 0",
     [](Json& gltf) { gltf["bufferViews"][0]["byteLength"] = 45; }},
    {"ViewWrapsAround", "beyond buffer 0",
     [](Json& gltf) { gltf["bufferViews"][0]["byteOffset"] = ~std::uint64_t{0} - 8; }},
    {"BufferShort", "declares 45 bytes, but there are 44",
     [](Json& gltf) { gltf["buffers"][0]["byteLength"] = 45; }},
    {"BufferHuge", "declares", [](Json& gltf) { gltf["buffers"][0]["byteLength"] = 1ULL << 60U; }},
    {"BufferLengthNegative", "byteLength",
     [](Json& gltf) { gltf["buffers"][0]["byteLength"] = -1; }},
    {"BufferWithoutUri", "beyond buffer 0", [](Json& gltf) { gltf["buffers"][0].erase("uri"); }},
    {"BufferMissing", "No such file", [](Json& gltf) { gltf["buffers"][0]["uri"] = "no.bin"; }},
    {"BufferIsFolder", "folder", [](Json& gltf) { gltf["buffers"][0]["uri"] = "."; }},
    {"UriOutside", "leaves the scene's folder",
     [](Json& gltf) { gltf["buffers"][0]["uri"] = "../outside.bin"; }},
    {"UriOutsideEscaped", "leaves the scene's folder",
     [](Json& gltf) { gltf["buffers"][0]["uri"] = "%2e%2e%2foutside.bin"; }},
    {"UriAbsolute", "not a relative path",
     [](Json& gltf) { gltf["buffers"][0]["uri"] = "/etc/passwd"; }},
    {"UriBackslash", "backslash",
     [](Json& gltf) { gltf["buffers"][0]["uri"] = "..\\outside.bin"; }},
    {"UriFileScheme", "not a relative path",
     [](Json& gltf) { gltf["buffers"][0]["uri"] = "file:///etc/passwd"; }},
    {"UriNul", "NUL", [](Json& gltf) { gltf["buffers"][0]["uri"] = "scene.bin%00.png"; }},
    {"DataUriNotBase64", "base64",
     [](Json& gltf) { gltf["buffers"][0]["uri"] = "data:text/plain,hello"; }},
    {"DataUriBroken", "outside base64",
     [](Json& gltf) { gltf["buffers"][0]["uri"] = "data:;base64,AA*A"; }},
    {"VersionOne", "version 1.0", [](Json& gltf) { gltf["asset"]["version"] = "1.0"; }},
    {"NoAsset", "asset.version", [](Json& gltf) { gltf.erase("asset"); }},
    {"RequiredExtension", "EXT_nothing_known",
     [](Json& gltf) { gltf["extensionsRequired"] = {"EXT_nothing_known"}; }},
    {"RequiredDraco", "KHR_draco_mesh_compression",
     [](Json& gltf) { gltf["extensionsRequired"] = {"KHR_draco_mesh_compression"}; }},
    {"NoMeshes", "no mesh 0", [](Json& gltf) { gltf.erase("meshes"); }},
    {"NothingToSee", "no triangles", [](Json& gltf) { gltf["nodes"][0].erase("mesh"); }},
    {"BuffersNoArray", "not an array", [](Json& gltf) { gltf["buffers"] = 7; }},
    {"Array", "not an object",
     [](Json& gltf) {
       gltf = Json::array({1, 2});
     }},
};

INSTANTIATE_TEST_SUITE_P(, ImportGltfRefuses, ::testing::ValuesIn(kHostileCases),
                         [](const auto& parameter) { return std::string(parameter.param.name); });

// Everything that the importer reads, once.
Json rich_gltf() {
  Json gltf = gltf_with_sparse_positions();
  gltf["extensionsUsed"] = {"KHR_lights_punctual"};
  gltf["extensionsRequired"] = {"KHR_lights_punctual"};
  gltf["materials"][0] = {
      {"name", "all"},
      {"doubleSided", true},
      {"alphaMode", "MASK"},
      {"normalTexture", {{"index", 0}}},
      {"pbrMetallicRoughness",
       {{"baseColorFactor", {0.1, 0.2, 0.3, 1.0}},
        {"metallicFactor", 0.25},
        {"baseColorTexture", {{"index", 0}}}}},
      {"emissiveFactor", {1.0, 0.5, 0.25}},
      {"extensions",
       {{"KHR_materials_emissive_strength", {{"emissiveStrength", 40.0}}},
        {"KHR_materials_ior", {{"ior", 1.33}}},
        {"KHR_materials_pbrSpecularGlossiness", {{"specularFactor", {0.1, 0.1, 0.1}}}},
        {"KHR_materials_specular", {{"specularColorFactor", {1.0, 0.5, 0.0}}}},
        {"KHR_materials_volume", {{"thicknessFactor", 0.1}}}}}};
  gltf["cameras"] = {{{"type", "perspective"}, {"perspective", {{"yfov", 0.7}, {"znear", 0.1}}}}};
  gltf["extensions"]["KHR_lights_punctual"]["lights"] = {
      {{"type", "spot"}, {"color", {1.0, 0.5, 0.0}}, {"spot", {{"outerConeAngle", 0.6}}}}};
  gltf["nodes"] = {
      {{"mesh", 0}, {"children", {1, 2}}, {"rotation", {0.0, 0.0, 0.0, 1.0}}},
      {{"camera", 0}, {"matrix", {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 5, 1}}},
      {{"extensions", {{"KHR_lights_punctual", {{"light", 0}}}}}, {"scale", {1, 2, 3}}}};
  return gltf;
}

// The places of all values in a document, containers too.
void list_places(const Json& json, std::vector<Json::json_pointer>& places) {
  std::vector<Json::json_pointer> pending{Json::json_pointer("")};
  while (!pending.empty()) {
    const Json::json_pointer place = pending.back();
    pending.pop_back();
    const Json& value = json[place];
    if (!place.empty()) { places.push_back(place); }
    if (value.is_object()) {
      for (const auto& [key, ignored] : value.items()) { pending.push_back(place / key); }
    }
    for (std::size_t i = 0; value.is_array() && i < value.size(); ++i) {
      pending.push_back(place / i);
    }
  }
}

TEST(ImportGltf, SurvivesAnyValueInAnyPlace) {
  const Json gltf = rich_gltf();
  ASSERT_TRUE(import_gltf_json(gltf, sparse_bin(1, 2)));
  const std::vector<Json> values{-1,
                                 1,
                                 255,
                                 1e308,
                                 -1e308,
                                 1e-300,
                                 4294967295U,
                                 4294967296U,
                                 ~std::uint64_t{0},
                                 "x",
                                 nullptr,
                                 true,
                                 Json::array(),
                                 Json::object(),
                                 Json::array({nullptr}),
                                 Json::array({7, 7})};
  std::vector<Json::json_pointer> places;
  list_places(gltf, places);
  const TemporaryFolder folder;
  folder.write("scene.bin", sparse_bin(1, 2));
  std::size_t accepted = 0;
  for (const auto& place : places) {
    for (const Json& value : values) {
      SCOPED_TRACE(place.to_string() + " = " + value.dump());
      Json damaged = gltf;
      damaged[place] = value;
      const auto scene = import_scene(folder.write("scene.gltf", damaged.dump()));
      if (scene) {
        ++accepted;
        expect_scene_holds_together(*scene);
      } else {
        EXPECT_EQ(scene.error().code, ExitCode::kSceneRejected);
      }
    }
  }
  EXPECT_GT(places.size(), 100U);
  EXPECT_GT(accepted, 500U);
}

TEST(ImportGltf, RefusesMoreElementsThanItHasRoomFor) {
  const TemporaryFolder folder;
  std::string nodes = "{}";
  for (int doubling = 0; doubling < 21; ++doubling) { nodes += "," + nodes; }

  const auto scene = import_scene(
      folder.write("a.gltf", R"({"asset":{"version":"2.0"},"nodes":[)" + nodes + "]}"));

  EXPECT_TRUE(is_rejected(scene, "2097152 nodes"));
}

TEST(ImportGltf, RefusesMeshesThatMultiplyInTheNodes) {
  Json gltf = triangle_gltf();
  for (int i = 0; i < 3000; ++i) {
    gltf["meshes"][0]["primitives"].push_back(gltf["meshes"][0]["primitives"][0]);
    gltf["nodes"].push_back({{"mesh", 0}});
    gltf["scenes"][0]["nodes"].push_back(i + 1);
  }

  EXPECT_TRUE(is_rejected(import_gltf_json(gltf), "meshes in the nodes"));
}

TEST(ImportGltf, WalksADeepChainWithinTheLimit) {
  Json gltf = triangle_gltf();
  make_chain(gltf, 1000);

  EXPECT_EQ(import_gltf_json(gltf).value().triangles.size(), 1U);
}

TEST(ImportGltf, RefusesJsonThatIsMalformedOrTooDeep) {
  const TemporaryFolder folder;
  const std::string deep = R"({"asset":{"version":"2.0"},"extras":)" + std::string(1'000'000, '[');

  EXPECT_TRUE(is_rejected(import_scene(folder.write("a.gltf", deep)), "nests deeper"));
  EXPECT_TRUE(is_rejected(import_scene(folder.write("a.gltf", "{\"asset\": ")), "malformed"));
  EXPECT_TRUE(is_rejected(import_scene(folder.write("a.gltf", "\xff\xfe{}")), "malformed"));
  EXPECT_TRUE(is_rejected(import_scene(folder.write("a.gltf", R"({"x": 1e999})")), "malformed"));
}

TEST(ImportGltf, RefusesInstancesThatMultiplyBeyondMemory) {
  // 2^20 nodes, each with 2^20 triangles, from a file of some megabytes.
  Json gltf = triangle_gltf();
  std::string indices;
  for (int i = 0; i < (1 << 20); ++i) { indices += triangle_bin().substr(36, 6); }
  gltf["accessors"][1]["count"] = 3 << 20;
  gltf["bufferViews"][1]["byteLength"] = indices.size();
  gltf["buffers"][0]["byteLength"] = 36 + indices.size();
  gltf["nodes"] = Json::array();
  gltf["scenes"][0]["nodes"] = Json::array();
  for (int i = 0; i < 50'000; ++i) {
    gltf["nodes"].push_back({{"mesh", 0}});
    gltf["scenes"][0]["nodes"].push_back(i);
  }

  EXPECT_TRUE(
      is_rejected(import_gltf_json(gltf, triangle_bin().substr(0, 36) + indices), "memory"));
}

}  // namespace
}  // namespace preheat
