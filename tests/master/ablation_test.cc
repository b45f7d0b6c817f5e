#include "master/ablation.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace preheat {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

Material plain() {
  Material material;
  material.specular_color = Vec3(0.0F);
  return material;
}

// A scene with every term.
SceneTables everything() {
  SceneTables tables;
  tables.materials.assign(4, plain());
  tables.materials[0].emission = Vec3(1.0F);
  tables.materials[1].metallic = 1.0F;
  tables.materials[2].specular_color = Vec3(1.0F);
  tables.materials[3].transmission = 1.0F;
  tables.emissive_triangles.emplace_back();
  for (const auto kind :
       {PunctualLightKind::kPoint, PunctualLightKind::kSpot, PunctualLightKind::kDirectional}) {
    tables.lights.emplace_back().kind = kind;
  }
  return tables;
}

RenderSettings under_a_sky() {
  RenderSettings settings;
  settings.sky = Vec3(1.0F);
  return settings;
}

TEST(Ablation, FindsTheTermsThatASceneHas) {
  EXPECT_THAT(terms_of(everything(), under_a_sky()),
              ElementsAre(SceneTerm::kShadowRays, SceneTerm::kEmitters, SceneTerm::kPointLights,
                          SceneTerm::kSpotLights, SceneTerm::kDirectionalLights,
                          SceneTerm::kEnvironment, SceneTerm::kSpecular, SceneTerm::kRefraction));

  SceneTables bare;
  bare.materials.push_back(plain());
  EXPECT_THAT(terms_of(bare, {}), IsEmpty());
  EXPECT_THAT(terms_of(bare, under_a_sky()),
              ElementsAre(SceneTerm::kShadowRays, SceneTerm::kEnvironment));
}

// Removing a term leaves the others; without lights of any class there are no shadow rays either.
TEST(Ablation, TakesAwayOneTermAndLeavesTheRest) {
  const SceneTables tables = everything();
  const RenderSettings settings = under_a_sky();
  const std::vector<SceneTerm> all = terms_of(tables, settings);
  for (const SceneTerm term : all) {
    SCOPED_TRACE(name_of(term));
    const AblatedScene scene = without(term, tables, settings);
    std::vector<SceneTerm> expected;
    for (const SceneTerm other : all) {
      const bool is_light = other >= SceneTerm::kShadowRays && other <= SceneTerm::kEnvironment;
      if (other != term && !(term == SceneTerm::kShadowRays && is_light)) {
        expected.push_back(other);
      }
    }
    EXPECT_EQ(terms_of(scene.tables, scene.settings), expected);
    EXPECT_EQ(scene.tables.materials.size(), tables.materials.size());
  }
}

TEST(Ablation, TermsHaveNamesOfTheirOwn) {
  EXPECT_STREQ(name_of(SceneTerm::kShadowRays), "shadow_rays");
  EXPECT_STREQ(name_of(SceneTerm::kRefraction), "refraction");
}

}  // namespace
}  // namespace preheat
