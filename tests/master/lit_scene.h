// A compiled scene with lights and several materials, for tests that need a store and rays.
#pragma once

#include <gtest/gtest.h>

#include "common/check.h"
#include "common/math.h"
#include "common/render_settings.h"
#include "common/store.h"
#include "master/compiler.h"
#include "tests/scenes/scratch_folder.h"
#include "tests/scenes/soups.h"

namespace preheat::test {

class LitScene {
 public:
  explicit LitScene(std::uint32_t seed = 7, std::size_t triangles = 1200) {
    Scene scene = soup(triangles, 0.1F, seed);
    scene.materials.resize(4);
    scene.materials[1].emission = Vec3(8.0F);
    scene.materials[2].metallic = 1.0F;
    scene.materials[2].roughness = 0.3F;
    scene.materials[3].transmission = 1.0F;
    scene.materials[3].roughness = 0.0F;
    for (std::size_t id = 0; id < scene.triangles.size(); ++id) {
      scene.triangles[id].material =
          id % 40 == 0 ? 1U : static_cast<std::uint32_t>(id % 3 + id % 2);
    }
    CompileOptions options;
    options.voxel_size_bytes = 4096;
    const auto compiled = compile_scene(scene, "lit", {1, 2}, options, file());
    CHECK(compiled.has_value());
  }
  [[nodiscard]] std::filesystem::path file() const { return folder_ / "lit.store"; }
  [[nodiscard]] Store open() const { return *Store::open(file()); }

  [[nodiscard]] static RenderSettings settings(std::uint32_t side, std::uint32_t spp) {
    RenderSettings settings;
    settings.width = side;
    settings.height = side;
    settings.spp = spp;
    settings.bounces = 3;
    settings.view.origin = Vec3(0.9F, 0.7F, 0.95F);
    settings.view.forward = glm::normalize(-settings.view.origin);
    const OrthonormalFrame frame(settings.view.forward);
    settings.view.right = frame.tangent * 0.6F;
    settings.view.up = frame.bitangent * 0.6F;
    return settings;
  }

 private:
  ScratchFolder folder_{};
};

}  // namespace preheat::test
