#include "master/import_obj.h"

#include <gtest/gtest.h>
#include <tiny_obj_loader.h>

#include <cmath>
#include <fstream>
#include <sstream>
#include <string>

#include "master/mtl_material.h"
#include "tests/master/scene_files.h"

namespace preheat {
namespace {

constexpr std::string_view kQuad =
    "v 0 0 0\n"
    "v 2 0 0\n"
    "v 2 1 0\n"
    "v 0 1 0\n";

std::string quad(std::string_view rest) { return std::string(kQuad) + std::string(rest); }

Material material_of(std::string_view keys) {
  MtlLibrary library;
  EXPECT_TRUE(library.add("newmtl m\n" + std::string(keys)));
  return library.materials().at(0);
}

TEST(ImportObj, ReadsPolygonsOverSharedVertices) {
  const auto scene = import_obj_text(quad("f 1 2 3 4\n"));

  ASSERT_TRUE(scene) << scene.error().message;
  EXPECT_EQ(scene->triangles.size(), 2U);
  EXPECT_EQ(scene->positions.size(), 4U);
  EXPECT_EQ(file_position(*scene, 0, 1), (Vec3d{2.0, 0.0, 0.0}));
  EXPECT_EQ(scene->materials.at(0).base_color, Vec3{0.8F});
  EXPECT_EQ(scene->materials.at(0).specular_color, Vec3{0.0F});
}

TEST(ImportObj, ReadsEveryFormOfCornerAndNegativeIndices) {
  for (const char* face : {"f 1/1 2/1 3/1", "f 1//1 2//1 3//1", "f 1/1/1 2/1/1 3/1/1", "f -4 -3 -2",
                           "f -4//-1 -3//-1 -2//-1", "f\t1  2\t3 # a comment"}) {
    const auto scene = import_obj_text(quad("vt 0 0\nvn 0 0 2\n" + std::string(face)));

    ASSERT_TRUE(scene) << face << ": " << scene.error().message;
    EXPECT_EQ(file_position(*scene, 0, 2), (Vec3d{2.0, 1.0, 0.0})) << face;
    const bool has_normal = std::string_view(face).find("//") != std::string_view::npos ||
                            std::string_view(face).find("/1/") != std::string_view::npos;
    EXPECT_EQ(scene->normals[0], (Vec3{0.0F, 0.0F, has_normal ? 1.0F : 0.0F})) << face;
  }
}

TEST(ImportObj, CountsNegativeIndicesFromWhatCameBefore) {
  const auto scene = import_obj_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 5 5 5\n");

  ASSERT_TRUE(scene) << scene.error().message;
  EXPECT_EQ(file_position(*scene, 0, 1), (Vec3d{1.0, 0.0, 0.0}));
}

TEST(ImportObj, SplitsVerticesThatDifferInNormal) {
  const auto scene =
      import_obj_text(quad("vn 0 0 1\nvn 1 0 0\nf 1//1 2//1 3//1\nf 1//2 3//1 4//1\n"));

  ASSERT_TRUE(scene);
  EXPECT_EQ(scene->positions.size(), 5U);
}

TEST(ImportObj, ReadsAnyLineEndAndJoinsContinuedLines) {
  EXPECT_EQ(import_obj_text("v 0 0 0\rv 1 0 0\rv 0 1 0\rf 1 2 3").value().triangles.size(), 1U);
  EXPECT_EQ(
      import_obj_text("v 0 0 0\r\nv 1 0 0\r\nv 0 1 0\r\nf 1 2 3\r\n").value().triangles.size(), 1U);
  EXPECT_EQ(import_obj_text("\xEF\xBB\xBFv 0 0 0\nv 1 \\\n0 0\nv 0 1 0\nf 1 \\\n 2 \\\n 3")
                .value()
                .triangles.size(),
            1U);
}

TEST(ImportObj, ReadsNumbersInEveryNotation) {
  const auto scene = import_obj_text("v +.5 1e1 -2.E+0\nv 1. 0 0\nv 0 1e-400 1\nf 1 2 3\n");

  ASSERT_TRUE(scene) << scene.error().message;
  EXPECT_EQ(file_position(*scene, 0, 0), (Vec3d{0.5, 10.0, -2.0}));
}

TEST(ImportObj, KeepsDetailInMapCoordinates) {
  const auto scene = import_obj_text(
      "v 4500000.001 5400000 0\nv 4500000.002 5400000 0\nv 4500000.001 5400000.001 0\nf 1 2 3\n");

  ASSERT_TRUE(scene);
  const Vec3d edge = file_position(*scene, 0, 1) - file_position(*scene, 0, 0);
  EXPECT_NEAR(edge.x, 0.001, 1e-8);
}

TEST(ImportObj, DropsTrianglesWithNanOrInfinity) {
  for (const char* number : {"nan", "-nan(ind)", "inf", "1e400", "1.#QNAN", "-1.#IND"}) {
    const auto scene =
        import_obj_text(quad("v 0 0 " + std::string(number) + "\nf 1 2 3\nf 1 2 5\n"));

    ASSERT_TRUE(scene) << number << ": " << scene.error().message;
    EXPECT_EQ(scene->triangles.size(), 1U) << number;
    EXPECT_EQ(scene->import.triangles_non_finite, 1U) << number;
  }
}

struct BrokenCase {
  const char* name;
  std::string rest;
  const char* message;
};

class ImportObjRefuses : public ::testing::TestWithParam<BrokenCase> {};

TEST_P(ImportObjRefuses, BrokenFilesByLine) {
  EXPECT_TRUE(is_rejected(import_obj_text(quad(GetParam().rest)), GetParam().message));
}

INSTANTIATE_TEST_SUITE_P(
    , ImportObjRefuses,
    ::testing::Values(BrokenCase{"IndexZero", "f 0 1 2", "line 5: vertex 0 is out of range"},
                      BrokenCase{"IndexTooLarge", "f 1 2 5", "line 5: vertex 5 is out of range"},
                      BrokenCase{"IndexTooNegative", "f 1 2 -5", "line 5: vertex -5"},
                      BrokenCase{"IndexBeyond32Bits", "f 1 2 4294967297", "line 5"},
                      BrokenCase{"IndexBeyond64Bits", "f 1 2 99999999999999999999", "not an index"},
                      BrokenCase{"IndexIsText", "f 1 2 x", "'x' is not an index"},
                      BrokenCase{"IndexMissing", "f 1 2 //1", "'' is not an index"},
                      BrokenCase{"NormalMissing", "f 1//1 2//1 3//1", "normal 1 is out of range"},
                      BrokenCase{"NumberIsText", "v 1 a 2\nf 1 2 3", "line 5: 'a' is not a number"},
                      BrokenCase{"NumberMissing", "v 1 2\nf 1 2 3", "line 5: '' is not a number"},
                      BrokenCase{"NoFaces", "", "no triangles"},
                      BrokenCase{"TwoCorners", "f 1 2", "no triangles"},
                      BrokenCase{"LinesOnly", "l 1 2 3", "no triangles"}),
    [](const auto& parameter) { return std::string(parameter.param.name); });

TEST(ImportObj, CutsConcavePolygonsUpToALimit) {
  std::string obj;
  std::string face = "f";
  const std::size_t count = 2000;
  for (std::size_t i = 0; i < count; ++i) {
    const double angle = 6.283185307179586 * static_cast<double>(i) / static_cast<double>(count);
    const double radius = i % 2 == 0 ? 1.0 : 0.9;
    std::ostringstream line;
    line << "v " << radius * std::cos(angle) << " " << radius * std::sin(angle) << " 0\n";
    obj += line.str();
    face.append(" ").append(std::to_string(i + 1));
  }

  EXPECT_TRUE(is_rejected(import_obj_text(obj + face), "concave polygon of 2000 vertices"));
}

TEST(ImportObj, SharesNoLongerThanItPays) {
  // One position with very many normals: the search for the right pair must not become long.
  std::string obj(kQuad);
  for (int i = 1; i <= 20'000; ++i) { obj += "vn 0 0 1\nf 1//" + std::to_string(i) + " 2 3\n"; }

  const auto scene = import_obj_text(obj);

  ASSERT_TRUE(scene);
  EXPECT_EQ(scene->triangles.size(), 20'000U);
}

TEST(ImportObj, ReadsMaterialLibraries) {
  const auto scene =
      import_obj_text(quad("mtllib scene.mtl\nusemtl red \nf 1 2 3\nusemtl unknown\nf 1 3 4\n"),
                      "newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1");

  ASSERT_TRUE(scene);
  ASSERT_EQ(scene->materials.size(), 3U);
  EXPECT_EQ(scene->materials[scene->triangles[0].material].name, "red");
  EXPECT_EQ(scene->materials[scene->triangles[1].material].name, "default");
  EXPECT_TRUE(has_note(*scene, "1 uses of materials that no library defines"));
}

TEST(ImportObj, NotesLibrariesThatAreMissingOrOutside) {
  const TemporaryFolder folder;
  folder.write("outside.mtl", "newmtl red\nKd 1 0 0\n");
  for (const char* name : {"missing.mtl", "../outside.mtl", "/etc/passwd", "C:\\a.mtl"}) {
    const auto scene = import_scene(folder.write(
        "inner/scene.obj", quad("mtllib " + std::string(name) + "\nusemtl red\nf 1 2 3\n")));

    ASSERT_TRUE(scene) << name;
    EXPECT_EQ(scene->materials.size(), 1U) << name;  // grey
    EXPECT_TRUE(has_note(*scene, "was not read")) << name;
  }
}

TEST(ImportObj, ReadsALibraryOnceHoweverOftenItIsNamed) {
  std::string obj(kQuad);
  for (int i = 0; i < 100'000; ++i) { obj += "mtllib scene.mtl\n"; }
  std::string mtl;
  for (int i = 0; i < 1000; ++i) { mtl.append("newmtl ").append(std::to_string(i)).append("\n"); }

  const auto scene = import_obj_text(obj + "usemtl 7\nf 1 2 3\n", mtl);

  ASSERT_TRUE(scene);
  EXPECT_EQ(scene->materials.size(), 1000U);
}

TEST(ImportObj, ReadsABoundedNumberOfLibrariesAndMaterials) {
  std::string obj(kQuad);
  for (int i = 0; i < 100'000; ++i) {
    obj.append("mtllib ").append(std::to_string(i)).append("\n");
  }
  std::string mtl;
  for (int i = 0; i < 100'000; ++i) { mtl += "newmtl a\n"; }

  const auto many_libraries = import_obj_text(obj + "f 1 2 3\n");
  const auto many_materials = import_obj_text(quad("mtllib scene.mtl\nusemtl a\nf 1 2 3\n"), mtl);

  ASSERT_TRUE(many_libraries);
  EXPECT_TRUE(has_note(*many_libraries, "the first 64 material libraries"));
  ASSERT_TRUE(many_materials);
  EXPECT_TRUE(has_note(*many_materials, "more than 32768 materials"));
}

TEST(ImportObj, SurvivesEveryTruncationAndFlippedByte) {
  const std::string obj = quad(
      "vn 0 0 1\nvt 0 0\nmtllib scene.mtl\nusemtl a\nf 1/1/1 2/1/1 3/1/1 4/1/1\nf -4//-1 -3//-1 "
      "-1//-1\n");
  const TemporaryFolder folder;
  folder.write("scene.mtl", "newmtl a\nKd 1 0 0\n");
  std::size_t accepted = 0;
  const auto try_text = [&](const std::string& text) {
    const auto scene = import_scene(folder.write("scene.obj", text));
    if (!scene) {
      EXPECT_EQ(scene.error().code, ExitCode::kSceneRejected);
      return;
    }
    ++accepted;
    for (const Triangle& triangle : scene->triangles) {
      for (const std::uint32_t vertex : triangle.vertices) {
        ASSERT_LT(vertex, scene->positions.size());
      }
      ASSERT_LT(triangle.material, scene->materials.size());
    }
  };
  for (std::size_t at = 0; at < obj.size(); ++at) {
    try_text(obj.substr(0, at));
    for (const int flip : {0x01, 0x02, 0x10, 0x80}) {
      std::string damaged = obj;
      damaged[at] = static_cast<char>(damaged[at] ^ flip);
      try_text(damaged);
    }
  }
  EXPECT_GT(accepted, 50U);
}

TEST(MtlMaterial, DiffuseWithoutSpecular) {
  const Material material = material_of("Kd 0.5 0.25 0\nKs 0 0 0\nNs 10\nNi 1\nillum 2\n");

  EXPECT_EQ(material.base_color, (Vec3{0.5F, 0.25F, 0.0F}));
  EXPECT_EQ(material.specular_color, Vec3{0.0F});
  EXPECT_EQ(material.metallic, 0.0F);
  EXPECT_EQ(material.transmission, 0.0F);
  EXPECT_TRUE(material.double_sided);
}

TEST(MtlMaterial, SpecularOfOneHalfReflectsFourPercentLikeGlass) {
  const Material material = material_of("Kd 0.5 0.5 0.5\nKs 0.5 0.25 0\nNs 30\n");

  EXPECT_NEAR(material.ior, 1.5F, 1e-5);
  EXPECT_EQ(material.specular_color, (Vec3{1.0F, 0.5F, 0.0F}));
  EXPECT_NEAR(material.roughness * material.roughness, 0.25F, 1e-6);  // sqrt(2 / 32)
}

TEST(MtlMaterial, SpecularWithoutDiffuseIsAMetal) {
  const Material mirror = material_of("Kd 0.01 0.01 0.01\nKs 0.95 0.9 0.8\nNs 1000\nillum 5\n");
  const Material brushed = material_of("Kd 0 0 0\nKs 0.9 0.9 0.9\nNs 30\nillum 3\n");

  EXPECT_EQ(mirror.metallic, 1.0F);
  EXPECT_EQ(mirror.base_color, (Vec3{0.95F, 0.9F, 0.8F}));
  EXPECT_EQ(mirror.roughness, 0.0F);
  EXPECT_EQ(brushed.metallic, 1.0F);
  EXPECT_NEAR(brushed.roughness, 0.5F, 1e-6);
}

TEST(MtlMaterial, GlassIsASolidOfItsIndex) {
  const Material glass =
      material_of("Kd 0.01 0.01 0.01\nKs 0.3 0.3 0.3\nTf 0.1 0.05 0.1\nNs 200\nNi 2.5\nillum 7\n");
  const Material opaque = material_of("Kd 1 1 1\nTf 1 1 1\nd 1\nNi 1.5\nillum 2\n");

  EXPECT_EQ(glass.transmission, 1.0F);
  EXPECT_EQ(glass.ior, 2.5F);
  EXPECT_FALSE(glass.thin_walled);
  EXPECT_EQ(glass.roughness, 0.0F);
  EXPECT_EQ(glass.base_color, (Vec3{1.0F, 0.5F, 1.0F}));
  EXPECT_EQ(opaque.transmission, 0.0F);
}

TEST(MtlMaterial, DissolveIsAThinWall) {
  const Material material = material_of("Kd 1 1 1\nKs 0 0 0\nd 0.25\nillum 2\n");

  EXPECT_EQ(material.transmission, 0.75F);
  EXPECT_TRUE(material.thin_walled);
}

TEST(MtlMaterial, PbrKeysWin) {
  const Material material = material_of("Kd 0.9 0.6 0.3\nKs 1 1 1\nNs 900\nPm 0.75\nPr 0.4\n");

  EXPECT_EQ(material.metallic, 0.75F);
  EXPECT_EQ(material.roughness, 0.4F);
  EXPECT_EQ(material.base_color, (Vec3{0.9F, 0.6F, 0.3F}));
}

TEST(MtlMaterial, EmissionIsNotClamped) {
  EXPECT_EQ(material_of("Ke 17 12 4\n").emission, (Vec3{17.0F, 12.0F, 4.0F}));
}

TEST(MtlMaterial, NonsenseStaysInRange) {
  const Material material = material_of(
      "Kd nan -1 9e99\nKs inf 0 0\nNs -5\nNi nan\nd 7\nKe nan 1e39 -1\nPr 1e30\nPm x\n");

  for (int axis = 0; axis < 3; ++axis) {
    EXPECT_TRUE(material.base_color[axis] >= 0.0F && material.base_color[axis] <= 1.0F);
    EXPECT_TRUE(material.emission[axis] >= 0.0F && std::isfinite(material.emission[axis]));
  }
  EXPECT_TRUE(material.roughness >= 0.0F && material.roughness <= 1.0F);
  EXPECT_GE(material.ior, 1.0F);
  EXPECT_EQ(material.transmission, 0.0F);
}

// tinyobjloader reads the same faces where a file holds nothing unusual.
TEST(ImportObj, AgreesWithTinyobjloader) {
  SKIP_WITHOUT_SHARED_SCENES();
  for (const char* name :
       {"cornell_boxes/CornellBox-Water.obj", "cornell_boxes/CornellBox-Glossy.obj",
        "cornell_boxes/CornellBox-Original.obj", "import_torture/assimp/OBJ/WusonOBJ.obj"}) {
    const auto file = shared_scene(name);
    tinyobj::attrib_t attributes;
    std::vector<tinyobj::shape_t> shapes;
    std::vector<tinyobj::material_t> materials;
    std::string warning;
    std::string error;
    std::ifstream stream(file);
    ASSERT_TRUE(tinyobj::LoadObj(&attributes, &shapes, &materials, &warning, &error, &stream));

    const auto scene = import_scene(file);

    ASSERT_TRUE(scene) << scene.error().message;
    ASSERT_EQ(scene->import.triangles_declared, scene->triangles.size());
    double area = 0.0;
    double area_expected = 0.0;
    for (std::uint32_t i = 0; i < scene->triangles.size(); ++i) {
      const Vec3d a = file_position(*scene, i, 0);
      area +=
          glm::length(glm::cross(file_position(*scene, i, 1) - a, file_position(*scene, i, 2) - a));
    }
    std::size_t count = 0;
    for (const auto& shape : shapes) {
      const auto& indices = shape.mesh.indices;
      count += indices.size() / 3;
      for (std::size_t i = 0; i + 2 < indices.size(); i += 3) {
        const auto point = [&](std::size_t corner) {
          const auto at = static_cast<std::size_t>(indices[i + corner].vertex_index) * 3;
          return Vec3d{static_cast<double>(attributes.vertices[at]),
                       static_cast<double>(attributes.vertices[at + 1]),
                       static_cast<double>(attributes.vertices[at + 2])};
        };
        area_expected += glm::length(glm::cross(point(1) - point(0), point(2) - point(0)));
      }
    }
    EXPECT_EQ(scene->triangles.size(), count) << name;
    EXPECT_NEAR(area, area_expected, 1e-5 * area_expected) << name;
  }
}

}  // namespace
}  // namespace preheat
