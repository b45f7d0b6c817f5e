// From a file's coordinates to the image: what scale, place, octree and rounding may not change.

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <iostream>
#include <iterator>
#include <limits>
#include <memory>
#include <numbers>
#include <optional>
#include <random>
#include <semaphore>
#include <string>
#include <variant>
#include <vector>

#include "cache/local_residency.h"
#include "cache/renderer.h"
#include "common/path.h"
#include "master/compiler.h"
#include "master/local_render.h"
#include "master/scene_builder.h"
#include "master/view.h"
#include "tests/scenes/scratch_folder.h"
#include "tests/scenes/soups.h"

namespace preheat {
namespace {

using test::SoupRandom;

// A scene as a file has it: in double, anywhere and of any size.
struct FileScene {
  std::vector<Vec3d> positions{};  // three a triangle
  std::vector<std::uint32_t> material_of{};
  std::vector<Material> materials{};
  std::vector<WorldLight> lights{};
  Vec3d eye{0.0};
  Vec3d look_at{0.0};

  void add_triangle(const Vec3d& a, const Vec3d& b, const Vec3d& c, std::uint32_t material) {
    positions.insert(positions.end(), {a, b, c});
    material_of.push_back(material);
  }
  // Twelve triangles, their normals inwards.
  void add_room(const Vec3d& low, const Vec3d& high, std::uint32_t material) {
    for (int axis = 0; axis < 3; ++axis) {
      for (const bool is_high : {false, true}) {
        Vec3d corner = low;
        if (is_high) { corner[axis] = high[axis]; }
        Vec3d u(0.0);
        Vec3d v(0.0);
        const int first = (axis + (is_high ? 2 : 1)) % 3;
        const int second = (axis + (is_high ? 1 : 2)) % 3;
        u[first] = high[first] - low[first];
        v[second] = high[second] - low[second];
        add_triangle(corner, corner + u, corner + u + v, material);
        add_triangle(corner, corner + u + v, corner + v, material);
      }
    }
  }
};

FileScene placed(FileScene scene, double scale, const Vec3d& offset) {
  const auto place = [&](const Vec3d& point) { return point * scale + offset; };
  for (Vec3d& position : scene.positions) { position = place(position); }
  for (WorldLight& light : scene.lights) {
    light.position_file = place(light.position_file);
    light.range_file *= scale;
    if (light.light.kind != PunctualLightKind::kDirectional) {
      light.intensity_file *= scale * scale;
    }
  }
  scene.eye = place(scene.eye);
  scene.look_at = place(scene.look_at);
  return scene;
}

class FileMesh : public WorldMesh {
 public:
  explicit FileMesh(const FileScene& scene) : scene_(scene) {}
  [[nodiscard]] std::string label() const override { return "mesh"; }
  [[nodiscard]] std::uint32_t vertex_count() const override {
    return static_cast<std::uint32_t>(scene_.positions.size());
  }
  [[nodiscard]] std::uint64_t triangle_count() const override { return scene_.material_of.size(); }
  [[nodiscard]] Triangle triangle(std::uint64_t index) const override {
    const auto first = static_cast<std::uint32_t>(3 * index);
    return {{first, first + 1, first + 2}, scene_.material_of[index]};
  }
  [[nodiscard]] Vec3d position(std::uint32_t vertex) const override {
    return scene_.positions[vertex];
  }
  [[nodiscard]] Vec3d normal(std::uint32_t) const override { return Vec3d(0.0); }
  [[nodiscard]] double coordinate_spacing(std::uint32_t) const override { return 0.0; }

 private:
  const FileScene& scene_;
};

struct Rendered {
  Film film;
  RenderSettings settings{};
  Frame frame{};
  std::size_t voxels = 0;
};

ViewOptions small_view(std::uint32_t spp, std::uint32_t bounces) {
  ViewOptions view;
  view.size = {48, 40};
  view.spp = spp;
  view.bounces = bounces;
  view.fov_deg = 60.0;
  view.sky = Vec3(0.3F, 0.4F, 0.5F);
  return view;
}

// Every voxel in memory, as `render --local` does.
Film render_hot(const Store& store, const RenderSettings& settings) {
  const std::atomic<int> no_signal{0};
  return render_local(store, settings, {.threads = 1}, no_signal, [](const MasterProgress&) {})
      .value()
      .film;
}

// One voxel in memory at a time, as a worker with the smallest cache does.
Film render_cold(const Store& store, const RenderSettings& settings) {
  std::counting_semaphore<> woken{0};
  RendererOptions options;
  options.cache_limit_bytes = store.tables().resident_bytes_min();
  options.paths_per_thread = 4096;
  Renderer renderer(store.tables(), settings, options, [&] { woken.release(); });
  renderer.set_hot_voxels({});
  const TileGrid grid{settings.width, settings.height, options.tile_size};
  for (std::uint32_t tile = 0; tile < grid.count(); ++tile) { renderer.add_tile(TileId{tile}); }
  Film film(settings.width, settings.height);
  for (std::uint32_t done = 0; done < grid.count();) {
    woken.acquire();
    for (const RendererEvent& event : renderer.take_events()) {
      if (const auto* needed = std::get_if<VoxelNeeded>(&event)) {
        EXPECT_TRUE(deliver_from(store, needed->voxel, renderer));
      }
      if (const auto* tile = std::get_if<TileDone>(&event)) {
        film.assign(grid.rect(tile->tile), tile->pixels);
        ++done;
      }
    }
  }
  return film;
}

std::optional<Rendered> render(const FileScene& file, ViewOptions options,
                               const CompileOptions& compile = {},
                               Film (*render_store)(const Store&,
                                                    const RenderSettings&) = render_hot) {
  SceneDraft draft;
  draft.meshes.push_back(std::make_unique<FileMesh>(file));
  draft.materials = file.materials;
  draft.lights = file.lights;
  const Result<Scene> scene = build_scene(std::move(draft));
  const test::ScratchFolder folder;
  if (!scene || !compile_scene(*scene, "file", {1, 2}, compile, folder / "a.store")) {
    ADD_FAILURE() << (scene ? "the store" : scene.error().message);
    return std::nullopt;
  }
  const Result<Store> store = Store::open(folder / "a.store");
  options.eye = file.eye;
  options.look_at = file.look_at;
  const auto view = resolve_view(store->tables(), {}, options);
  if (!view) {
    ADD_FAILURE() << view.error().message;
    return std::nullopt;
  }
  return Rendered{render_store(*store, view->settings), view->settings, store->tables().frame,
                  store->tables().voxels.size()};
}

std::string bits_of(const std::optional<Rendered>& rendered) {
  return rendered ? rendered->film.pixels_sha256() : "nothing";
}

Material diffuse(const Vec3& albedo) {
  Material material;
  material.base_color = albedo;
  material.specular_color = Vec3(0.0F);
  return material;
}

// Every material and light, on coordinates that are multiples of 2^-24 so that they can be moved
// without rounding.
FileScene lit_scene(std::uint32_t seed) {
  FileScene file;
  file.materials.resize(4);
  file.materials[1].emission = Vec3(8.0F, 7.0F, 6.0F);
  file.materials[2].metallic = 1.0F;
  file.materials[2].roughness = 0.3F;
  file.materials[3].transmission = 1.0F;
  file.materials[3].roughness = 0.0F;
  file.materials[3].thin_walled = false;
  const Scene soup = test::soup(1000, 0.1F, seed);
  for (std::size_t id = 0; id < soup.triangles.size(); ++id) {
    for (const std::uint32_t vertex : soup.triangles[id].vertices) {
      const Vec3d steps = Vec3d(soup.positions[vertex]) * 0x1p24;
      file.positions.push_back(glm::floor(steps) * 0x1p-24);
    }
    file.material_of.push_back(id % 30 == 0 ? 1U : static_cast<std::uint32_t>(id % 3 + id % 2));
  }
  WorldLight point;
  point.position_file = Vec3d(0.75, 0.5, 0.875);
  point.intensity_file = Vec3d(0.5, 0.25, 1.0);
  point.range_file = 4.0;
  WorldLight sun;
  sun.light.kind = PunctualLightKind::kDirectional;
  sun.light.direction = glm::normalize(Vec3(-1.0F, -2.0F, -1.5F));
  sun.intensity_file = Vec3d(1.0);
  file.lights = {point, sun};
  file.eye = Vec3d(0.875, 0.75, 0.9375);
  return file;
}

class WholeRender : public testing::Test {
 protected:
  void SetUp() override { std::cout << "seed=" << seed_ << '\n'; }
  const std::uint32_t seed_ = static_cast<std::uint32_t>(std::random_device{}());
};

TEST_F(WholeRender, HasTheSameBitsAtAnyPowerOfTwoOfScale) {
  const FileScene file = lit_scene(seed_);
  const std::string expected = bits_of(render(file, small_view(2, 4)));
  for (const int exponent : {-59, -20, 1, 20, 59}) {
    const FileScene scaled = placed(file, std::ldexp(1.0, exponent), Vec3d(0.0));
    EXPECT_EQ(bits_of(render(scaled, small_view(2, 4))), expected) << "2^" << exponent;
  }
}

// Coordinates in double keep all their digits there.
TEST_F(WholeRender, HasTheSameBitsAMillionUnitsFromTheOrigin) {
  const FileScene file = lit_scene(seed_);
  const std::string expected = bits_of(render(file, small_view(2, 4)));
  for (const Vec3d& offset : {Vec3d(1e6, 0.0, 0.0), Vec3d(-1e6, 1e6, 1e6), Vec3d(1e7, -3.0, 5e5)}) {
    EXPECT_EQ(bits_of(render(placed(file, 1.0, offset), small_view(2, 4))), expected) << offset.x;
  }
}

TEST_F(WholeRender, HasTheSameBitsWhateverTheOctree) {
  const FileScene file = lit_scene(seed_);
  CompileOptions one_leaf;
  one_leaf.octree.depth_max = 0;
  const auto reference = render(file, small_view(2, 4), one_leaf);
  ASSERT_TRUE(reference);
  ASSERT_EQ(reference->voxels, 1U);
  std::size_t voxels_max = 0;
  for (const std::uint32_t depth : {1U, 4U, kOctreeDepthMax}) {
    for (const std::uint32_t leaf : {1U, 64U}) {
      CompileOptions options;
      options.voxel_size_bytes = 4096;
      options.octree = {.leaf_references_max = leaf, .depth_max = depth};
      const auto hot = render(file, small_view(2, 4), options);
      const auto cold = render(file, small_view(2, 4), options, render_cold);
      ASSERT_TRUE(hot && cold);
      voxels_max = std::max(voxels_max, hot->voxels);
      EXPECT_EQ(bits_of(hot), bits_of(reference)) << "depth " << depth << " leaf " << leaf;
      EXPECT_EQ(bits_of(cold), bits_of(reference)) << "depth " << depth << " leaf " << leaf;
    }
  }
  EXPECT_GT(voxels_max, 30U);
}

// A room with nothing in it, in a brighter one: walls without thickness, of one side or two, along
// the axes or not. The paths are always the same: coordinates have 24 bits, and in a room of a
// sixteenth of the scene's size one of 262,144 went on from behind the wall beside its own.
TEST_F(WholeRender, LetsNoLightIntoAClosedRoom) {
  for (const bool turned : {false, true}) {
    for (const bool double_sided : {true, false}) {
      FileScene file;
      file.materials = {diffuse(Vec3(0.9F)), diffuse(Vec3(0.5F))};
      file.materials[0].double_sided = double_sided;
      file.materials[1].emission = Vec3(1e6F);
      file.add_room({-0.5, -0.4, -0.3}, {0.5, 0.6, 0.45}, 0);
      const auto turn = [turned](const Vec3d& p) {  // by 3-4-5 triangles around two axes
        const Vec3d once(0.8 * p.x - 0.6 * p.y, 0.6 * p.x + 0.8 * p.y, p.z);
        return turned ? Vec3d(once.x, 0.8 * once.y - 0.6 * once.z, 0.6 * once.y + 0.8 * once.z) : p;
      };
      for (Vec3d& position : file.positions) { position = turn(position); }
      file.add_room(Vec3d(-1.0), Vec3d(1.0), 1);
      file.eye = turn({0.1, 0.2, 0.25});
      file.look_at = turn({-0.35, 0.05, -0.1});
      WorldLight outside;
      outside.position_file = turn({0.75, 0.05, 0.05});
      outside.intensity_file = Vec3d(1e6);
      file.lights.push_back(outside);
      for (const auto& [scale, offset] : {std::pair{1.0, Vec3d(0.0)},
                                          {0x1p-20, Vec3d(0.0)},
                                          {0x1p20, Vec3d(0.0)},
                                          {0.7, Vec3d(1e6, -1e6, 1e6)},
                                          {1.0, Vec3d(0.1, 1e6, 0.3)}}) {
        const auto rendered = render(placed(file, scale, offset), small_view(4, 8));
        ASSERT_TRUE(rendered);
        const std::vector<float>& rgb = rendered->film.rgb();
        EXPECT_EQ(std::count(rgb.begin(), rgb.end(), 0.0F), std::ssize(rgb))
            << "turned " << turned << " scale " << scale << " offset " << offset.y;
      }
    }
  }
}

// A ball of facets around a point, in double.
FileScene faceted_ball(int rows, int columns) {
  FileScene file;
  file.materials = {diffuse(Vec3(0.75F, 0.5F, 0.25F))};
  const auto at = [&](int row, int column) {
    const double theta = std::numbers::pi * row / rows;
    const double phi = 2.0 * std::numbers::pi * (column % columns) / columns;
    return Vec3d(std::sin(theta) * std::cos(phi), std::cos(theta),
                 -std::sin(theta) * std::sin(phi));
  };
  for (int row = 0; row < rows; ++row) {
    for (int column = 0; column < columns; ++column) {
      const Vec3d a = at(row, column);
      const Vec3d b = at(row + 1, column);
      const Vec3d c = at(row + 1, column + 1);
      const Vec3d d = at(row, column + 1);
      if (row + 1 < rows) { file.add_triangle(a, b, c, 0); }
      if (row > 0) { file.add_triangle(a, c, d, 0); }
    }
  }
  return file;
}

// The cosine at the facet that a ray meets first, towards the light; 0 for facets that look away;
// nothing where no facet is met.
std::optional<double> cosine_seen(const FileScene& file, const Vec3d& origin,
                                  const Vec3d& direction, const Vec3d& to_light) {
  double nearest = std::numeric_limits<double>::infinity();
  std::optional<double> cosine;
  for (std::size_t first = 0; first < file.positions.size(); first += 3) {
    const Vec3d a = file.positions[first] - origin;
    const Vec3d b = file.positions[first + 1] - origin;
    const Vec3d c = file.positions[first + 2] - origin;
    const double u = glm::dot(glm::cross(b, a), direction);
    const double v = glm::dot(glm::cross(c, b), direction);
    const double w = glm::dot(glm::cross(a, c), direction);
    if (!(u >= 0.0 && v >= 0.0 && w >= 0.0)) { continue; }  // a convex ball: its front is enough
    const Vec3d normal = glm::normalize(glm::cross(b - a, c - a));
    const double t = glm::dot(a, normal) / glm::dot(direction, normal);
    if (t > 0.0 && t < nearest) {
      nearest = t;
      cosine = std::max(0.0, glm::dot(normal, to_light));
    }
  }
  return cosine;
}

// A convex ball shadows itself only where it looks away: every pixel against its rays in double,
// which would show acne, a shifted terminator, and facets at the wrong place.
TEST_F(WholeRender, ShadesABallAsDoubleDoesWhereverItLies) {
  const Vec3d to_light = glm::normalize(Vec3d(0.5, 1.0, 0.75));
  for (const auto& [scale, offset] :
       {std::pair{1.0, Vec3d(0.0)}, {1.0, Vec3d(1e6, -1e6, 1e6)}, {1e-3, Vec3d(1e6, 0.1, 0.2)}}) {
    FileScene file = faceted_ball(24, 40);
    WorldLight sun;
    sun.light.kind = PunctualLightKind::kDirectional;
    sun.light.direction = Vec3(-to_light);
    sun.intensity_file = Vec3d(std::numbers::pi);
    file.lights.push_back(sun);
    file.eye = Vec3d(-1.0, 1.5, 2.0);
    file = placed(file, scale, offset);
    ViewOptions view = small_view(4, 1);
    view.sky = Vec3(0.0F);

    const auto rendered = render(file, view);

    ASSERT_TRUE(rendered);
    const RenderSettings& settings = rendered->settings;
    const Shading shading(SceneTables{}, settings);
    double sum = 0.0;
    double off_most = 0.0;
    std::size_t on_ball = 0;
    for (std::uint32_t pixel = 0; pixel < settings.width * settings.height; ++pixel) {
      double expected = 0.0;
      for (std::uint32_t sample = 0; sample < settings.spp; ++sample) {
        PathState path;
        const Ray ray = shading.start_path(pixel, sample, path);
        const Vec3d origin = Vec3d(ray.origin) * std::ldexp(1.0, -rendered->frame.scale_exponent) +
                             rendered->frame.centre;
        const auto cosine = cosine_seen(file, origin, Vec3d(ray.direction), to_light);
        on_ball += cosine ? 1U : 0U;
        expected += 0.75 * cosine.value_or(0.0) / settings.spp;
      }
      sum += expected;
      const auto found = static_cast<double>(rendered->film.rgb()[std::size_t{3} * pixel]);
      off_most = std::max(off_most, std::abs(found - expected));
    }
    const double mean = sum / (settings.width * settings.height);
    std::cout << on_ball << " rays on the ball, mean " << mean << ", off by " << off_most << '\n';
    EXPECT_GT(on_ball, 1000U);
    EXPECT_LE(off_most, 1e-3 * mean) << "scale " << scale << " offset " << offset.x;
  }
}

// Where two triangles coincide the first one shows, at every sample.
TEST_F(WholeRender, ShowsTheFirstOfTwoTrianglesThatCoincide) {
  SoupRandom random(seed_);
  for (int repeat = 0; repeat < 8; ++repeat) {
    FileScene file;
    file.materials.resize(3, diffuse(Vec3(0.0F)));
    file.materials[0].emission = Vec3(1.0F, 0.0F, 0.0F);
    file.materials[1].emission = Vec3(0.0F, 1.0F, 0.0F);
    const auto corner = [&](double x, double y) {
      return Vec3d(x, y, 0.0) + 0.2 * Vec3d(random.in_cube(-1.0F, 1.0F));
    };
    const Vec3d a = corner(-1.0, -1.0);
    const Vec3d b = corner(1.0, -1.0);
    const Vec3d c = corner(0.0, 1.0);
    file.add_triangle(a, b, c, 0);
    file.add_triangle(a, b, c, 1);
    file.eye = Vec3d(0.1, 0.2, 2.0);
    ViewOptions view = small_view(4, 2);
    view.sky = Vec3(0.0F);

    const auto rendered = render(file, view);

    ASSERT_TRUE(rendered);
    double red = 0.0;
    double green = 0.0;
    for (std::size_t at = 0; at < rendered->film.rgb().size(); at += 3) {
      red += static_cast<double>(rendered->film.rgb()[at]);
      green += static_cast<double>(rendered->film.rgb()[at + 1]);
    }
    EXPECT_GT(red, 100.0);
    EXPECT_EQ(green, 0.0);
  }
}

}  // namespace
}  // namespace preheat
