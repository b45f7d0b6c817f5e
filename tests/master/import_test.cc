#include "master/import.h"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <map>
#include <string>

#include "tests/master/scene_files.h"

namespace preheat {
namespace {

TEST(ImportScene, RefusesWhatIsNoSceneFile) {
  const TemporaryFolder folder;

  EXPECT_TRUE(is_rejected(import_scene(folder.path() / "no.gltf"), "no.gltf: No such file"));
  EXPECT_TRUE(is_rejected(import_scene(folder.path()), "is a folder"));
  EXPECT_TRUE(is_rejected(import_scene(folder.write("a.obj", "")), "a.obj: the file is empty"));
  EXPECT_TRUE(is_rejected(import_scene("/dev/zero"), "not a regular file"));
}

TEST(ImportScene, NamesTheFormatsItDoesNotReadAndThoseItDoes) {
  const TemporaryFolder folder;

  EXPECT_TRUE(is_rejected(import_scene(folder.write("a.ply", "ply\n")),
                          "PLY files are not supported; supported are glTF 2.0 (.gltf, .glb) and "
                          "Wavefront OBJ (.obj)"));
  EXPECT_TRUE(is_rejected(import_scene(folder.write("a.STL", "solid\n")), "STL files"));
  EXPECT_TRUE(is_rejected(import_scene(folder.write("a", "x")), "not a known scene format"));
}

TEST(HashSceneFiles, ChangesWithEveryByteOfEveryFile) {
  const TemporaryFolder folder;
  const std::string gltf = triangle_gltf().dump();
  const auto file = folder.write("scene.gltf", gltf);
  folder.write("scene.bin", triangle_bin());
  const auto hash = hash_scene_files(file);
  ASSERT_TRUE(hash) << hash.error().message;

  EXPECT_EQ(hash_scene_files(file).value(), *hash);
  folder.write("scene.bin", triangle_bin() + "x");
  EXPECT_NE(hash_scene_files(file).value(), *hash);
  folder.write("scene.bin", triangle_bin());
  EXPECT_EQ(hash_scene_files(file).value(), *hash);
  folder.write("scene.gltf", gltf + " ");
  EXPECT_NE(hash_scene_files(file).value(), *hash);
}

TEST(HashSceneFiles, FollowsMaterialLibraries) {
  const TemporaryFolder folder;
  const auto file = folder.write("a.obj", "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
  const Hash128 without = hash_scene_files(file).value();
  folder.write("a.mtl", "newmtl a\n");
  const Hash128 with = hash_scene_files(file).value();
  folder.write("a.mtl", "newmtl b\n");

  EXPECT_NE(without, with);
  EXPECT_NE(hash_scene_files(file).value(), with);
}

TEST(HashSceneFiles, RefusesWhatImportWouldRefuseToOpen) {
  const TemporaryFolder folder;
  auto gltf = triangle_gltf();
  gltf["buffers"][0]["uri"] = "../scene.bin";

  const auto hash = hash_scene_files(folder.write("scene.gltf", gltf.dump()));

  ASSERT_FALSE(hash);
  EXPECT_EQ(hash.error().code, ExitCode::kSceneRejected);
}

struct SharedCase {
  const char* file;
  std::uint64_t triangles;  // in the world, as declared
  std::uint64_t dropped;
  std::size_t cameras;
  const char* camera;  // name of the first
  Vec3d eye;
};

class ImportShared : public ::testing::TestWithParam<SharedCase> {};

TEST_P(ImportShared, GivesTheKnownCounts) {
  SKIP_WITHOUT_SHARED_SCENES();
  const auto scene = import_scene(shared_scene(GetParam().file));

  ASSERT_TRUE(scene) << scene.error().message;
  EXPECT_EQ(scene->import.triangles_declared, GetParam().triangles);
  EXPECT_EQ(scene->import.triangles_non_finite + scene->import.triangles_zero_area,
            GetParam().dropped);
  EXPECT_EQ(scene->triangles.size(), GetParam().triangles - GetParam().dropped);
  ASSERT_EQ(scene->cameras.size(), GetParam().cameras);
  if (GetParam().cameras > 0) {
    EXPECT_EQ(scene->cameras[0].name, GetParam().camera);
    EXPECT_EQ(scene->cameras[0].position_file, GetParam().eye);
  }
  float farthest = 0.0F;
  for (const Vec3& position : scene->positions) {
    farthest =
        std::max({farthest, std::abs(position.x), std::abs(position.y), std::abs(position.z)});
  }
  EXPECT_GT(farthest, 0.5F);
  EXPECT_LE(farthest, 1.0F);
  for (const Triangle& triangle : scene->triangles) {
    ASSERT_LT(triangle.material, scene->materials.size());
  }
}

INSTANTIATE_TEST_SUITE_P(
    , ImportShared,
    ::testing::Values(
        SharedCase{"mgf_conference/conf.gltf", 202'314, 0, 2, "main", {10.5, 1.75, -0.4}},
        SharedCase{"mgf_office/office.gltf", 22'428, 0, 1, "main", {2.0, 3.4, -1.9}},
        SharedCase{"mgf_cruiser/cruiser_full.gltf",
                   2'425'197,
                   32,
                   4,
                   "default",
                   {20.1168, 1.6764, -7.0104}},
        SharedCase{"nrc_office_lamps/nrcoff.gltf", 153'780, 0, 2, "main", {1.4, 1.75, -0.7}},
        SharedCase{
            "crytek_sponza/sponza.gltf", 262'267, 0, 1, "main", {5.49696, 2.94685, -0.351245}},
        SharedCase{
            "dining_room/dining_room.gltf", 270'090, 0, 1, "main", {-0.587317, 2.7623, 9.71429}},
        SharedCase{"cornell_boxes/CornellBox-Original.obj", 36, 0, 0, "", {}},
        SharedCase{"cornell_boxes/CornellBox-Water.obj", 7'088, 0, 0, "", {}},
        SharedCase{"gltf_features/CornellBox/CornellBox.glb", 36, 0, 0, "", {}},
        SharedCase{"gltf_features/godot_truck_town/town_model.gltf", 30'477, 136, 0, "", {}},
        SharedCase{
            "gltf_features/polyhaven_dutch_ship/dutch_ship_medium_1k.gltf", 69'162, 0, 0, "", {}}),
    [](const auto& parameter) {
      return std::filesystem::path(parameter.param.file).stem().string().substr(0, 7) +
             std::to_string(parameter.index);
    });

const Material* find_material(const Scene& scene, std::string_view name) {
  for (const Material& material : scene.materials) {
    if (material.name == name) { return &material; }
  }
  return nullptr;
}

TEST(SharedScenes, ReadsEmissiveStrengthAndTransmission) {
  SKIP_WITHOUT_SHARED_SCENES();
  const auto scene = import_scene(shared_scene("mgf_office/office.gltf"));
  ASSERT_TRUE(scene);

  const Material* const lamp = find_material(*scene, "incandescent60");
  const Material* const glass = find_material(*scene, "window_glass");

  ASSERT_NE(lamp, nullptr);
  EXPECT_NEAR(lamp->emission.z, 159.71758F, 1e-4);
  EXPECT_NEAR(lamp->emission.x, 159.71758F * 0.99528F, 1e-3);
  ASSERT_NE(glass, nullptr);
  EXPECT_EQ(glass->transmission, 1.0F);
  EXPECT_EQ(glass->roughness, 0.0F);
  EXPECT_TRUE(glass->thin_walled);
}

TEST(SharedScenes, ReadsTheLightsOfSponza) {
  SKIP_WITHOUT_SHARED_SCENES();
  const auto scene = import_scene(shared_scene("crytek_sponza/sponza.gltf"));
  ASSERT_TRUE(scene);
  ASSERT_EQ(scene->lights.size(), 4U);
  const double units_per_scene_unit = std::ldexp(1.0, -scene->frame.scale_exponent);

  const PunctualLight& point = scene->lights[0];
  const Vec3d at = Vec3d(point.position) * units_per_scene_unit + scene->frame.centre;
  EXPECT_NEAR(glm::length(at - Vec3d{0.0, 2.0, 0.0}), 0.0, 1e-5);
  // Irradiance at a metre is what the file says, 30 cd / m^2 in red.
  const double metre = 1.0 / units_per_scene_unit;
  EXPECT_NEAR(static_cast<double>(point.intensity.x) / (metre * metre), 30.0, 1e-5);
  EXPECT_NEAR(static_cast<double>(point.range) * units_per_scene_unit, 4.0, 1e-6);
  EXPECT_EQ(scene->lights[2].kind, PunctualLightKind::kSpot);
  EXPECT_NEAR(scene->lights[2].cos_outer, std::cos(0.75), 1e-6);
  EXPECT_EQ(scene->lights[3].kind, PunctualLightKind::kDirectional);
  EXPECT_NEAR(scene->lights[3].direction.y, -0.97590F, 1e-4);
  EXPECT_NEAR(scene->lights[3].intensity.z, 3.0F, 1e-6);
  EXPECT_TRUE(has_note(*scene, "21 base colour textures"));
}

// Of each file of the collection it is known whether it is a scene; for the others listed nowhere
// only that the answer is one of the two.
TEST(SharedScenes, TortureEveryFileGivesASceneOrAnError) {
  SKIP_WITHOUT_SHARED_SCENES();
  const std::map<std::string, bool> known{{"BoxBadNormals.glb", true},
                                          {"BoxWithInfinites.glb", false},
                                          {"RecursiveNodes.gltf", false},
                                          {"IndexOutOfRange.gltf", false},
                                          {"AllIndicesOutOfRange.gltf", false},
                                          {"NoScene.gltf", false},
                                          {"SceneWithoutNodes.gltf", false},
                                          {"2CylinderEngine.gltf", false},
                                          {"SimpleMorph.gltf", true},
                                          {"MorphStressTest.gltf", true},
                                          {"box.obj", true},
                                          {"box_UTF16BE.obj", false},
                                          {"box_longline.obj", true},
                                          {"box_without_lineending.obj", true},
                                          {"concave_polygon.obj", true},
                                          {"number_formats.obj", false},
                                          {"point_cloud.obj", false},
                                          {"testline.obj", false},
                                          {"testmixed.obj", true},
                                          {"empty.obj", false},
                                          {"cube_binary.ply", false},
                                          {"triangle.stl", false},
                                          {"OutOfMemory.off", false},
                                          {"cornell_box.obj", true},
                                          {"invalid-face-definition.obj", false},
                                          {"issue-140-zero-face-idx.obj", false},
                                          {"invalid-relative-vertex-index.obj", false},
                                          {"test-nan.obj", true},
                                          {"mtl filename with whitespace issue46.obj", true},
                                          {"missing_material_file.obj", true},
                                          {"issue-295-trianguation-failure.obj", true},
                                          {"pbr-mat-ext.obj", true},
                                          {"Mesh_PrimitiveMode_03.gltf", false},
                                          {"Mesh_PrimitiveMode_04.gltf", true},
                                          {"Mesh_PrimitiveMode_05.gltf", true},
                                          {"Mesh_PrimitiveMode_06.gltf", true}};
  std::size_t files = 0;
  std::size_t scenes = 0;
  std::size_t found = 0;
  for (const auto& entry :
       std::filesystem::recursive_directory_iterator(shared_scene("import_torture"))) {
    if (!entry.is_regular_file()) { continue; }
    const auto scene = import_scene(entry.path());
    ++files;
    scenes += scene.has_value();
    if (!scene) {
      EXPECT_EQ(scene.error().code, ExitCode::kSceneRejected) << entry.path();
      EXPECT_NE(scene.error().message.find(entry.path().string()), std::string::npos)
          << scene.error().message;
    }
    const auto expected = known.find(entry.path().filename().string());
    if (expected != known.end() && entry.path().parent_path().filename() != "MissingBin") {
      ++found;
      EXPECT_EQ(scene.has_value(), expected->second)
          << entry.path() << ": " << (scene ? "accepted" : scene.error().message);
    }
  }
  EXPECT_GE(files, 100U);
  EXPECT_GE(scenes, 60U);
  EXPECT_GE(found, known.size());
}

}  // namespace
}  // namespace preheat
