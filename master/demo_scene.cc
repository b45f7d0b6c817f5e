#include "master/demo_scene.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <string>
#include <vector>

#include "master/demo_shapes.h"

namespace preheat {
namespace {

// The room: the window is in the wall x = 0, the bookshelf stands at z = 0.
constexpr double kWidth = 6.2;
constexpr double kHeight = 2.9;
constexpr double kDepth = 5.6;
constexpr double kTableTop = 0.745;
const Vec3d kTable(2.75, 0.0, 2.35);

class DemoRoom {
 public:
  DemoRoom(Scene& scene, std::uint64_t triangles_target)
      : scene_(scene),
        triangles_target_(triangles_target),
        amount_(static_cast<double>(triangles_target) / 1e6),
        coarse_(std::sqrt(std::max(1.0, 0.3 / amount_))),
        builder_(scene, std::sqrt(amount_)) {}

  void furnish();

 private:
  std::uint32_t material(const std::string& name, const Vec3& color, float roughness,
                         float metallic = 0.0F);
  std::uint32_t glass(const std::string& name, const Vec3& tint, float ior, float roughness = 0.0F);
  std::uint32_t light(const std::string& name, const Vec3& radiance);
  // A count that grows with the number of triangles asked for.
  [[nodiscard]] std::size_t many(double count) const {
    return static_cast<std::size_t>(std::max(1.0, count * amount_ + 0.5));
  }
  void define_materials();
  void wall_with_opening(const Vec3d& corner, const Vec3d& along, double length, double left,
                         double right, double bottom, double top);
  void shell();
  void parquet();
  void window();
  void curtain(double z_begin, double z_end, double seed);
  void ceiling_lights();
  void book(const Placement& place, double thickness, double height, double depth);
  void book_row(double x_begin, double x_end, double shelf_height);
  void bookshelf();
  void picture(double x_centre, double y_centre, double width, double height, std::size_t kind);
  void table();
  void chair(const Vec3d& origin, double turns);
  void wine_glass(const Vec3d& foot, double fill);
  void carafe(const Vec3d& foot);
  void fruit_bowl(const Vec3d& foot);
  void kettle(const Vec3d& foot, double turns);
  void candlestick(const Vec3d& foot, double height);
  void tableware();
  void pendant();
  void armchair(const Vec3d& origin, double turns);
  void floor_lamp(const Vec3d& foot);
  void side_table(const Vec3d& foot);
  void pot(const Vec3d& foot, double radius, double height, std::uint32_t pot_material);
  void leafy_plant(const Vec3d& foot, double height, std::size_t leaves, std::uint64_t seed);
  void fern(const Vec3d& foot, std::size_t fronds, std::uint64_t seed);
  void basket(const Vec3d& foot);
  void rug();

  Scene& scene_;
  std::uint64_t triangles_target_;
  double amount_;
  double coarse_;  // how many times larger the many small things are, where few triangles are asked
                   // for
  DemoBuilder builder_;
  DemoRandom random_{20260101};

  std::uint32_t plaster_{}, ceiling_{}, trim_{}, oak_{}, walnut_{}, linen_{}, paper_{};
  std::uint32_t brass_{}, copper_{}, steel_{}, mirror_{}, iron_{};
  std::uint32_t clear_{}, crystal_{}, wine_{}, water_{}, green_glass_{};
  std::uint32_t ceramic_{}, glaze_{}, terracotta_{}, soil_{}, leaf_{}, leaf_young_{}, bark_{};
  std::uint32_t apple_{}, orange_{}, grape_{}, lemon_{}, wax_{}, wicker_{}, velvet_{}, shade_{};
  std::uint32_t bulb_{}, flame_{}, sky_{}, panel_{};
  std::vector<std::uint32_t> planks_{}, covers_{}, yarns_{}, paints_{};
};

std::uint32_t DemoRoom::material(const std::string& name, const Vec3& color, float roughness,
                                 float metallic) {
  Material material;
  material.name = name;
  material.base_color = color;
  material.roughness = roughness;
  material.metallic = metallic;
  scene_.materials.push_back(material);
  return static_cast<std::uint32_t>(scene_.materials.size() - 1);
}

std::uint32_t DemoRoom::glass(const std::string& name, const Vec3& tint, float ior,
                              float roughness) {
  const std::uint32_t index = material(name, tint, roughness);
  scene_.materials[index].transmission = 1.0F;
  scene_.materials[index].ior = ior;
  scene_.materials[index].thin_walled = false;
  return index;
}

std::uint32_t DemoRoom::light(const std::string& name, const Vec3& radiance) {
  const std::uint32_t index = material(name, Vec3(0.8F), 1.0F);
  scene_.materials[index].emission = radiance;
  scene_.materials[index].specular_color = Vec3(0.0F);
  scene_.materials[index].double_sided = false;
  return index;
}

void DemoRoom::define_materials() {
  const auto matte = [this](const char* name, const Vec3& color) {
    const std::uint32_t index = material(name, color, 1.0F);
    scene_.materials[index].specular_color = Vec3(0.0F);
    return index;
  };
  plaster_ = matte("plaster", {0.72F, 0.69F, 0.62F});
  ceiling_ = matte("ceiling", {0.82F, 0.81F, 0.78F});
  trim_ = material("trim", {0.80F, 0.79F, 0.75F}, 0.4F);
  oak_ = material("oak", {0.42F, 0.25F, 0.12F}, 0.35F);
  walnut_ = material("walnut", {0.16F, 0.085F, 0.045F}, 0.32F);
  linen_ = matte("linen", {0.72F, 0.68F, 0.58F});
  paper_ = matte("paper", {0.78F, 0.73F, 0.62F});
  // No metal but the mirrors is smoother than this: the sun is a point, its highlight grows with
  // 1 / roughness^4, and a path that meets such a highlight by chance leaves a speck.
  brass_ = material("brass", {0.89F, 0.67F, 0.32F}, 0.34F, 1.0F);
  copper_ = material("copper", {0.93F, 0.55F, 0.40F}, 0.30F, 1.0F);
  steel_ = material("brushed steel", {0.66F, 0.66F, 0.68F}, 0.40F, 1.0F);
  mirror_ = material("mirror", {0.95F, 0.95F, 0.95F}, 0.0F, 1.0F);
  iron_ = material("blackened iron", {0.03F, 0.03F, 0.035F}, 0.45F);
  clear_ = glass("glass", Vec3(0.985F), 1.5F);
  crystal_ = glass("crystal", Vec3(0.98F), 1.65F);
  wine_ = glass("wine", {0.62F, 0.05F, 0.08F}, 1.34F);
  water_ = glass("water", {0.96F, 0.985F, 0.98F}, 1.33F);
  green_glass_ = glass("green glass", {0.45F, 0.82F, 0.55F}, 1.52F);
  ceramic_ = material("ceramic", {0.80F, 0.80F, 0.77F}, 0.25F);
  glaze_ = material("blue glaze", {0.05F, 0.16F, 0.33F}, 0.24F);
  terracotta_ = matte("terracotta", {0.52F, 0.22F, 0.12F});
  soil_ = matte("soil", {0.05F, 0.035F, 0.025F});
  leaf_ = material("leaf", {0.06F, 0.20F, 0.045F}, 0.35F);
  leaf_young_ = material("young leaf", {0.16F, 0.34F, 0.06F}, 0.4F);
  bark_ = matte("bark", {0.19F, 0.13F, 0.08F});
  apple_ = material("apple", {0.55F, 0.045F, 0.035F}, 0.3F);
  orange_ = material("orange", {0.85F, 0.32F, 0.03F}, 0.35F);
  lemon_ = material("lemon", {0.86F, 0.66F, 0.07F}, 0.35F);
  grape_ = material("grape", {0.13F, 0.04F, 0.14F}, 0.3F);
  wax_ = material("wax", {0.86F, 0.80F, 0.66F}, 0.5F);
  wicker_ = material("wicker", {0.45F, 0.29F, 0.14F}, 0.6F);
  velvet_ = matte("velvet", {0.055F, 0.17F, 0.16F});
  shade_ = matte("lampshade", {0.80F, 0.70F, 0.52F});
  bulb_ = light("bulb", {9.0F, 6.2F, 3.3F});
  flame_ = light("flame", {9.0F, 5.0F, 1.6F});
  sky_ = light("sky panel", {2.9F, 3.6F, 4.6F});
  panel_ = light("ceiling panel", {6.6F, 5.7F, 4.5F});
  for (const Vec3& tone : {Vec3(0.33F, 0.19F, 0.09F), Vec3(0.38F, 0.22F, 0.105F),
                           Vec3(0.29F, 0.16F, 0.075F), Vec3(0.43F, 0.26F, 0.13F)}) {
    planks_.push_back(material("plank", tone, 0.28F));
  }
  for (const Vec3& cover :
       {Vec3(0.35F, 0.04F, 0.04F), Vec3(0.05F, 0.10F, 0.24F), Vec3(0.05F, 0.17F, 0.09F),
        Vec3(0.48F, 0.33F, 0.10F), Vec3(0.10F, 0.075F, 0.06F), Vec3(0.55F, 0.50F, 0.40F),
        Vec3(0.42F, 0.15F, 0.05F), Vec3(0.17F, 0.24F, 0.30F), Vec3(0.26F, 0.09F, 0.19F)}) {
    covers_.push_back(material("book cover", cover, 0.5F));
  }
  for (const Vec3& yarn : {Vec3(0.55F, 0.48F, 0.38F), Vec3(0.36F, 0.055F, 0.045F),
                           Vec3(0.06F, 0.10F, 0.19F), Vec3(0.50F, 0.29F, 0.09F)}) {
    yarns_.push_back(matte("yarn", yarn));
  }
  for (const Vec3& paint :
       {Vec3(0.70F, 0.28F, 0.10F), Vec3(0.10F, 0.28F, 0.42F), Vec3(0.75F, 0.62F, 0.28F),
        Vec3(0.62F, 0.60F, 0.55F), Vec3(0.13F, 0.30F, 0.22F), Vec3(0.06F, 0.07F, 0.12F)}) {
    paints_.push_back(matte("paint", paint));
  }
}

// A vertical wall with a rectangular hole; `along` is horizontal and unit, the inside on its left
// seen from above.
void DemoRoom::wall_with_opening(const Vec3d& corner, const Vec3d& along, double length,
                                 double left, double right, double bottom, double top) {
  const auto at = [&](double distance, double height) {
    return corner + along * distance + Vec3d(0.0, height, 0.0);
  };
  const auto piece = [&](double from, double to, double low, double high) {
    builder_.quad(at(from, low), at(to, low), at(to, high), at(from, high), plaster_);
  };
  piece(0.0, left, 0.0, kHeight);
  piece(right, length, 0.0, kHeight);
  piece(left, right, 0.0, bottom);
  piece(left, right, top, kHeight);
}

void DemoRoom::shell() {
  builder_.quad({0, kHeight, 0}, {kWidth, kHeight, 0}, {kWidth, kHeight, kDepth},
                {0, kHeight, kDepth}, ceiling_);
  builder_.quad({0, -0.03, kDepth}, {kWidth, -0.03, kDepth}, {kWidth, -0.03, 0}, {0, -0.03, 0},
                walnut_);
  builder_.quad({0, 0, 0}, {kWidth, 0, 0}, {kWidth, kHeight, 0}, {0, kHeight, 0}, plaster_);
  // The evening sun comes in through the wall behind the camera.
  wall_with_opening({kWidth, 0, kDepth}, {-1, 0, 0}, kWidth, 0.5, 2.5, 0.8, 2.5);
  builder_.quad({kWidth, 0, 0}, {kWidth, 0, kDepth}, {kWidth, kHeight, kDepth},
                {kWidth, kHeight, 0}, plaster_);
  wall_with_opening({0, 0, kDepth}, {0, 0, -1}, kDepth, kDepth - 3.35, kDepth - 1.25, 0.75, 2.45);

  const Placement room;
  builder_.box(room, {0, 0, 0}, {kWidth, 0.13, 0.02}, trim_);
  builder_.box(room, {0, 0, 0.02}, {0.02, 0.13, kDepth}, trim_);
  builder_.box(room, {kWidth - 0.02, 0, 0}, {kWidth, 0.13, kDepth}, trim_);
  for (int step = 0; step < 3; ++step) {
    const double out = 0.035 * (3 - step);
    const double low = kHeight - 0.04 * (step + 1);
    builder_.box(room, {0, low, 0}, {kWidth, low + 0.04, out}, trim_);
    builder_.box(room, {0, low, out}, {out, low + 0.04, kDepth}, trim_);
    builder_.box(room, {kWidth - out, low, out}, {kWidth, low + 0.04, kDepth}, trim_);
  }
  // Bars of the window behind the camera, for their shadow.
  for (const double x : {3.7, 4.366, 5.033, 5.7}) {
    builder_.box(room, {x - 0.025, 0.8, kDepth}, {x + 0.025, 2.5, kDepth + 0.05}, trim_);
  }
  for (const double y : {0.8, 1.366, 1.933, 2.5}) {
    builder_.box(room, {3.7, y - 0.025, kDepth}, {5.7, y + 0.025, kDepth + 0.05}, trim_);
  }
}

// Herringbone: blocks of 4 : 1 laid at right angles, each a bevelled block of its own.
void DemoRoom::parquet() {
  const double width = 0.11 * coarse_;
  const double length = 4.0 * width;
  constexpr double kGap = 0.0012;
  const auto plank = [&](double x, double z, double size_x, double size_z) {
    if (x + size_x < 0.0 || z + size_z < 0.0 || x > kWidth || z > kDepth) { return; }
    const double top = random_.between(-0.0006, 0.0);
    builder_.box(Placement{}, {x + kGap, -0.02, z + kGap},
                 {x + size_x - kGap, top, z + size_z - kGap},
                 planks_[random_.below(planks_.size())]);
  };
  for (int row = -4; row * width < kDepth; ++row) {
    for (int column = -1; column * 2.0 * length < 2.5 * kWidth; ++column) {
      const double x = column * 2.0 * length - row * width;
      const double z = row * width;
      plank(x, z, length, width);
      plank(x + length, z, width, length);
    }
  }
}

void DemoRoom::window() {
  const Placement room;
  // The panel stands for the sky, right behind the bars, so that no ray looks for it in vain.
  builder_.quad({-0.14, 0.74, 1.24}, {-0.14, 2.46, 1.24}, {-0.14, 2.46, 3.36}, {-0.14, 0.74, 3.36},
                sky_);
  for (const double z : {1.25, 1.95, 2.65, 3.35}) {
    builder_.box(room, {-0.09, 0.75, z - 0.03}, {-0.03, 2.45, z + 0.03}, trim_);
  }
  for (const double y : {0.75, 1.6, 2.45}) {
    builder_.box(room, {-0.085, y - 0.03, 1.22}, {-0.035, y + 0.03, 3.38}, trim_);
  }
  builder_.box(room, {-0.12, 0.70, 1.12}, {0.16, 0.745, 3.48}, trim_);
  const std::vector<Vec3d> rod = {{0.12, 2.58, 0.75}, {0.12, 2.58, 2.3}, {0.12, 2.58, 3.85}};
  builder_.tube(rod, 0.014, 0.014, builder_.fine(20), brass_);
  builder_.sphere({0.12, 2.58, 0.74}, 0.03, builder_.fine(24), brass_);
  builder_.sphere({0.12, 2.58, 3.86}, 0.03, builder_.fine(24), brass_);
  curtain(0.80, 1.32, 0.13);
  curtain(3.28, 3.80, 0.71);
}

void DemoRoom::curtain(double z_begin, double z_end, double seed) {
  SurfaceGrid grid{builder_.fine(60), builder_.fine(160), false, {}};
  for (std::size_t row = 0; row < grid.rows; ++row) {
    const double v = static_cast<double>(row) / static_cast<double>(grid.rows - 1);
    for (std::size_t column = 0; column < grid.columns; ++column) {
      const double u = static_cast<double>(column) / static_cast<double>(grid.columns - 1);
      const double fold = sine_of_turns(6.0 * u + seed + 0.12 * sine_of_turns(v * 0.7 + 2.0 * u));
      const double depth = (0.055 - 0.02 * v) * fold + 0.012 * sine_of_turns(17.0 * u + v + seed);
      grid.points.emplace_back(0.12 + depth, 0.04 + 2.55 * v, z_begin + (z_end - z_begin) * u);
    }
  }
  builder_.surface(grid, Placement{}, linen_);
}

void DemoRoom::ceiling_lights() {
  constexpr double kHalf = 0.42;
  for (const double x : {1.5, 4.3}) {
    for (const double z : {1.9, 4.3}) {
      const double low = kHeight - 0.05;
      builder_.quad({x - kHalf, low, z - kHalf}, {x + kHalf, low, z - kHalf},
                    {x + kHalf, low, z + kHalf}, {x - kHalf, low, z + kHalf}, panel_);
      builder_.box(Placement{}, {x - kHalf - 0.03, low + 0.002, z - kHalf - 0.03},
                   {x + kHalf + 0.03, kHeight - 0.001, z + kHalf + 0.03}, trim_);
    }
  }
}

// Stands with its spine towards +z, its lower left corner at the placement's origin.
void DemoRoom::book(const Placement& place, double thickness, double height, double depth) {
  const std::uint32_t cover = covers_[random_.below(covers_.size())];
  constexpr double kBoard = 0.0025;
  builder_.box(place, {0, 0, -depth}, {kBoard, height, 0}, cover);
  builder_.box(place, {thickness - kBoard, 0, -depth}, {thickness, height, 0}, cover);
  builder_.box(place, {kBoard, 0.004, -depth + 0.005}, {thickness - kBoard, height - 0.005, -0.004},
               paper_);
  const std::size_t pieces = builder_.fine(8);
  SurfaceGrid spine{pieces + 1, 2, false, {}};
  for (std::size_t piece = 0; piece <= pieces; ++piece) {
    const double turns = 0.5 * static_cast<double>(piece) / static_cast<double>(pieces);
    const double x = thickness * 0.5 * (1.0 - cosine_of_turns(turns));
    const double z = 0.25 * thickness * sine_of_turns(turns);
    spine.points.emplace_back(x, 0.0, z);
    spine.points.emplace_back(x, height, z);
  }
  builder_.surface(spine, place, cover);
  // Gilt bands on some.
  if (random_.below(3) != 0) { return; }
  for (const double share : {0.12, 0.2, 0.82}) {
    SurfaceGrid band = spine;
    for (std::size_t index = 0; index < band.points.size(); ++index) {
      band.points[index].y = height * share + (index % 2 == 0 ? 0.0 : 0.004);
      band.points[index].z += 0.0006;
    }
    builder_.surface(band, place, brass_);
  }
}

void DemoRoom::book_row(double x_begin, double x_end, double shelf_height) {
  double x = x_begin;
  while (x < x_end) {
    const double thickness = random_.between(0.014, 0.05) * coarse_;
    const double height = random_.between(0.19, 0.285);
    const double depth = random_.between(0.15, 0.21);
    if (x + thickness > x_end) { break; }
    book(placed_at({x, shelf_height, random_.between(0.255, 0.285)}), thickness, height, depth);
    x += thickness + 0.0008;
  }
}

void DemoRoom::bookshelf() {
  constexpr double kLeft = 0.75;
  constexpr double kRight = 3.55;
  constexpr double kTop = 2.36;
  const Placement room;
  builder_.box(room, {kLeft, 0.0, 0.022}, {kRight, kTop, 0.04}, walnut_);
  for (int post = 0; post <= 4; ++post) {
    const double x = kLeft + (kRight - kLeft - 0.03) * post / 4.0;
    builder_.box(room, {x, 0.0, 0.04}, {x + 0.03, kTop, 0.33}, walnut_);
  }
  builder_.box(room, {kLeft - 0.03, kTop, 0.022}, {kRight + 0.03, kTop + 0.04, 0.36}, walnut_);
  constexpr double kBay = (kRight - kLeft - 0.03) / 4.0;
  for (int shelf = 0; shelf < 7; ++shelf) {
    const double y = 0.06 + 0.33 * shelf;
    builder_.box(room, {kLeft, y - 0.022, 0.04}, {kRight, y, 0.325}, walnut_);
    for (int bay = 0; bay < 4 && shelf < 7; ++bay) {
      const double left = kLeft + bay * kBay + 0.034;
      const double right = left + kBay - 0.042;
      const int kind = (shelf * 5 + bay * 3) % 7;
      if (kind == 2) {
        book_row(left, left + 0.34, y);
        pot({right - 0.14, y, 0.19}, 0.065, 0.10, glaze_);
        fern({right - 0.14, y + 0.10, 0.19}, 9, 77U + static_cast<unsigned>(shelf));
      } else if (kind == 5) {
        book_row(left + 0.28, right, y);
        builder_.sphere({left + 0.13, y + 0.09, 0.2}, 0.09, builder_.fine(64),
                        shelf % 2 == 0 ? mirror_ : copper_);
      } else {
        book_row(left, right - random_.between(0.0, 0.09), y);
      }
    }
  }
}

void DemoRoom::picture(double x_centre, double y_centre, double width, double height,
                       std::size_t kind) {
  const Placement room = placed_at({x_centre - width * 0.5, y_centre - height * 0.5, 0.0});
  constexpr double kFrame = 0.035;
  builder_.box(room, {-kFrame, -kFrame, 0.001}, {width + kFrame, 0.0, 0.03}, brass_);
  builder_.box(room, {-kFrame, height, 0.001}, {width + kFrame, height + kFrame, 0.03}, brass_);
  builder_.box(room, {-kFrame, 0.0, 0.001}, {0.0, height, 0.03}, brass_);
  builder_.box(room, {width, 0.0, 0.001}, {width + kFrame, height, 0.03}, brass_);
  const std::size_t columns = builder_.fine(48);
  const std::size_t rows = builder_.fine(48);
  for (std::size_t row = 0; row < rows; ++row) {
    for (std::size_t column = 0; column < columns; ++column) {
      const double u = static_cast<double>(column) / static_cast<double>(columns);
      const double v = static_cast<double>(row) / static_cast<double>(rows);
      const double hill = 0.33 + 0.12 * sine_of_turns(u * 0.9 + 0.2 * static_cast<double>(kind));
      const double ridge = hill + 0.16 + 0.07 * sine_of_turns(1.7 * u + 0.3);
      const double sun = (u - 0.66) * (u - 0.66) + (v - 0.74) * (v - 0.74);
      const std::size_t paint = kind == 1     ? (column / 6 * 5 + row / 8 * 3) % 6
                                : v < hill    ? 4
                                : v < ridge   ? 1
                                : sun < 0.012 ? 2
                                              : (v > 0.78 ? 3 : 0);
      const double x = width * u;
      const double y = height * v;
      const double dx = width / static_cast<double>(columns);
      const double dy = height / static_cast<double>(rows);
      builder_.quad(room({x, y, 0.012}), room({x + dx, y, 0.012}), room({x + dx, y + dy, 0.012}),
                    room({x, y + dy, 0.012}), paints_[paint]);
    }
  }
}

void DemoRoom::table() {
  const Profile edge = {{0.0, kTableTop - 0.035}, {0.66, kTableTop - 0.035}};
  const Profile rim = smooth_profile({{0.66, kTableTop - 0.035},
                                      {0.70, kTableTop - 0.028},
                                      {0.71, kTableTop - 0.014},
                                      {0.70, kTableTop - 0.003},
                                      {0.685, kTableTop}},
                                     builder_.fine(6));
  const Profile top = {{0.685, kTableTop}, {0.3, kTableTop}, {0.0, kTableTop}};
  const Placement place = placed_at(kTable);
  for (const Profile& part : {edge, rim, top}) {
    builder_.lathe(part, builder_.fine(160), place, oak_);
  }
  const Profile leg = smooth_profile({{0.0, 0.06},
                                      {0.12, 0.07},
                                      {0.10, 0.14},
                                      {0.05, 0.20},
                                      {0.045, 0.30},
                                      {0.085, 0.40},
                                      {0.095, 0.46},
                                      {0.06, 0.53},
                                      {0.05, 0.60},
                                      {0.12, 0.68},
                                      {0.20, kTableTop - 0.035}},
                                     builder_.fine(8));
  builder_.lathe(leg, builder_.fine(72), place, oak_);
  for (int foot = 0; foot < 4; ++foot) {
    const double turns = 0.125 + 0.25 * foot;
    const Vec3d out(cosine_of_turns(turns), 0.0, sine_of_turns(turns));
    const std::vector<Vec3d> path = smooth_path(
        {kTable + Vec3d(0, 0.14, 0), kTable + out * 0.16 + Vec3d(0, 0.13, 0),
         kTable + out * 0.34 + Vec3d(0, 0.06, 0), kTable + out * 0.46 + Vec3d(0, 0.028, 0)},
        builder_.fine(8));
    builder_.tube(path, 0.04, 0.024, builder_.fine(24), oak_);
  }
}

// A spindle-back chair that looks towards -z of its placement.
void DemoRoom::chair(const Vec3d& origin, double turns) {
  const Placement place = turned(origin, turns);
  const Profile seat = smooth_profile({{0.0, 0.43},
                                       {0.17, 0.43},
                                       {0.205, 0.437},
                                       {0.212, 0.45},
                                       {0.20, 0.463},
                                       {0.12, 0.457},
                                       {0.0, 0.455}},
                                      builder_.fine(5));
  builder_.lathe(seat, builder_.fine(64), place, walnut_);
  const Profile turning = smooth_profile({{0.0, 0.0},
                                          {0.011, 0.0},
                                          {0.014, 0.08},
                                          {0.019, 0.2},
                                          {0.014, 0.24},
                                          {0.021, 0.27},
                                          {0.015, 0.30},
                                          {0.02, 0.37},
                                          {0.014, 0.435},
                                          {0.0, 0.437}},
                                         builder_.fine(4));
  for (const double x : {-0.13, 0.13}) {
    for (const double z : {-0.13, 0.13}) {
      const Vec3d foot(x * 1.35, 0.0, z * 1.35);
      const Placement leg = pointing(foot, Vec3d(x, 0.437, z) - foot);
      builder_.lathe(turning, builder_.fine(20), place * leg, walnut_);
    }
  }
  std::vector<Vec3d> rail;
  for (int step = 0; step <= 12; ++step) {
    const double turn = 0.5 * step / 12.0;
    rail.emplace_back(0.21 * cosine_of_turns(turn), 0.88 + 0.03 * sine_of_turns(turn),
                      0.10 + 0.13 * sine_of_turns(turn));
  }
  for (int spindle = 1; spindle < 12; ++spindle) {
    const Vec3d top = rail[static_cast<std::size_t>(spindle)];
    const Vec3d foot(top.x * 0.8, 0.455, 0.06 + (top.z - 0.10) * 0.85);
    const std::vector<Vec3d> path = {place(foot), place((foot + top) * 0.5 + Vec3d(0, 0, 0.008)),
                                     place(top)};
    builder_.tube(path, 0.0075, 0.006, builder_.fine(12), walnut_);
  }
  for (Vec3d& point : rail) { point = place(point); }
  builder_.tube(smooth_path(rail, builder_.fine(3)), 0.016, 0.016, builder_.fine(20), walnut_);
  builder_.cushion(place * placed_at({0, 0.475, 0}), {0.18, 0.03, 0.18}, velvet_);
}

void DemoRoom::wine_glass(const Vec3d& foot, double fill) {
  const std::size_t steps = builder_.fine(6);
  // Out along the foot, up the stem and the bowl to the rim, and down inside: one closed solid.
  const Profile solid = smooth_profile({{0.0, 0.0},
                                        {0.034, 0.0005},
                                        {0.036, 0.002},
                                        {0.030, 0.004},
                                        {0.008, 0.008},
                                        {0.0042, 0.02},
                                        {0.0038, 0.06},
                                        {0.006, 0.078},
                                        {0.022, 0.092},
                                        {0.036, 0.118},
                                        {0.039, 0.145},
                                        {0.034, 0.19},
                                        {0.0332, 0.1915},
                                        {0.0326, 0.19},
                                        {0.0376, 0.145},
                                        {0.0346, 0.118},
                                        {0.021, 0.0945},
                                        {0.008, 0.0865},
                                        {0.0, 0.0855}},
                                       steps);
  builder_.lathe(solid, builder_.fine(64), placed_at(foot), clear_);
  if (fill <= 0.0) { return; }
  // A hair's breadth from the glass, so that no two surfaces coincide.
  const double level = 0.0945 + 0.045 * fill;
  const double radius = 0.0340 + 0.0033 * fill;
  const Profile wine = smooth_profile({{0.0, 0.0862},
                                       {0.0078, 0.0871},
                                       {0.0207, 0.0951},
                                       {0.0300, 0.1070},
                                       {radius - 0.002, level}},
                                      steps);
  builder_.lathe(wine, builder_.fine(64), placed_at(foot), wine_);
  builder_.lathe({{radius - 0.002, level}, {0.015, level}, {0.0, level}}, builder_.fine(64),
                 placed_at(foot), wine_);
}

void DemoRoom::carafe(const Vec3d& foot) {
  const Profile solid = smooth_profile({{0.0, 0.0},
                                        {0.05, 0.0},
                                        {0.064, 0.008},
                                        {0.070, 0.05},
                                        {0.060, 0.11},
                                        {0.030, 0.17},
                                        {0.026, 0.20},
                                        {0.038, 0.245},
                                        {0.0372, 0.2462},
                                        {0.0360, 0.245},
                                        {0.0238, 0.20},
                                        {0.0278, 0.17},
                                        {0.0574, 0.11},
                                        {0.0672, 0.05},
                                        {0.0605, 0.012},
                                        {0.046, 0.006},
                                        {0.0, 0.006}},
                                       builder_.fine(8));
  builder_.lathe(solid, builder_.fine(80), placed_at(foot), clear_);
  const Profile water = smooth_profile(
      {{0.0, 0.0066}, {0.0455, 0.0066}, {0.0598, 0.0125}, {0.0664, 0.05}, {0.0616, 0.09}},
      builder_.fine(8));
  builder_.lathe(water, builder_.fine(80), placed_at(foot), water_);
  builder_.lathe({{0.0616, 0.09}, {0.03, 0.09}, {0.0, 0.09}}, builder_.fine(80), placed_at(foot),
                 water_);
}

void DemoRoom::fruit_bowl(const Vec3d& foot) {
  const Profile bowl = smooth_profile({{0.0, 0.0},
                                       {0.06, 0.0},
                                       {0.065, 0.01},
                                       {0.055, 0.02},
                                       {0.10, 0.035},
                                       {0.155, 0.075},
                                       {0.172, 0.115},
                                       {0.170, 0.118},
                                       {0.166, 0.115},
                                       {0.148, 0.08},
                                       {0.095, 0.043},
                                       {0.0, 0.032}},
                                      builder_.fine(8));
  builder_.lathe(bowl, builder_.fine(120), placed_at(foot), ceramic_);
  const Profile apple = smooth_profile({{0.0, -0.026},
                                        {0.012, -0.034},
                                        {0.030, -0.022},
                                        {0.039, 0.004},
                                        {0.032, 0.028},
                                        {0.016, 0.036},
                                        {0.004, 0.027},
                                        {0.0, 0.022}},
                                       builder_.fine(6));
  const std::array<Vec3d, 7> places = {Vec3d(0.075, 0.088, 0.02),  Vec3d(-0.03, 0.085, 0.075),
                                       Vec3d(-0.085, 0.09, -0.01), Vec3d(0.01, 0.085, -0.078),
                                       Vec3d(0.01, 0.135, 0.01),   Vec3d(0.082, 0.105, -0.065),
                                       Vec3d(-0.065, 0.135, 0.05)};
  for (std::size_t index = 0; index < places.size(); ++index) {
    const Vec3d centre = foot + places[index];
    if (index % 3 == 1) {
      builder_.sphere(centre, 0.041, builder_.fine(72), index == 1 ? orange_ : lemon_);
      continue;
    }
    const Vec3d up(random_.between(-0.5, 0.5), 1.0, random_.between(-0.5, 0.5));
    const Placement place = pointing(centre, up, random_.between(0.0, 1.0));
    builder_.lathe(apple, builder_.fine(64), place, apple_);
    const std::vector<Vec3d> stalk = {place({0, 0.022, 0}), place({0.002, 0.036, 0}),
                                      place({0.006, 0.046, 0})};
    builder_.tube(stalk, 0.0012, 0.0016, builder_.fine(8), bark_);
  }
  for (std::size_t grape = 0; grape < 46; ++grape) {
    const double t = static_cast<double>(grape) / 46.0;
    const Vec3d along = foot + Vec3d(-0.10 - 0.13 * t, 0.15 - 0.118 * t * t, -0.05 - 0.04 * t);
    const double spread = 0.030 * (1.15 - t);
    builder_.sphere(
        along + Vec3d(random_.between(-spread, spread), random_.between(-spread, spread) * 0.5,
                      random_.between(-spread, spread)),
        random_.between(0.0095, 0.0115), builder_.fine(24), grape_);
  }
}

void DemoRoom::kettle(const Vec3d& foot, double turns) {
  const Placement place = turned(foot, turns);
  const Profile body = smooth_profile({{0.0, 0.0},
                                       {0.075, 0.0},
                                       {0.092, 0.012},
                                       {0.100, 0.05},
                                       {0.088, 0.10},
                                       {0.055, 0.132},
                                       {0.045, 0.138}},
                                      builder_.fine(10));
  const Profile lid = smooth_profile({{0.047, 0.136},
                                      {0.046, 0.143},
                                      {0.03, 0.153},
                                      {0.008, 0.158},
                                      {0.006, 0.166},
                                      {0.013, 0.175},
                                      {0.010, 0.184},
                                      {0.0, 0.187}},
                                     builder_.fine(8));
  builder_.lathe(body, builder_.fine(120), place, copper_);
  builder_.lathe(lid, builder_.fine(80), place, copper_);
  std::vector<Vec3d> spout = {
      {0.08, 0.045, 0}, {0.12, 0.06, 0}, {0.145, 0.10, 0}, {0.165, 0.132, 0}};
  std::vector<Vec3d> handle = {
      {0.07, 0.12, 0}, {0.072, 0.19, 0}, {0.0, 0.245, 0}, {-0.072, 0.19, 0}, {-0.07, 0.12, 0}};
  for (Vec3d& point : spout) { point = place(point); }
  for (Vec3d& point : handle) { point = place(point); }
  builder_.tube(smooth_path(spout, builder_.fine(8)), 0.024, 0.010, builder_.fine(32), copper_);
  builder_.tube(smooth_path(handle, builder_.fine(8)), 0.006, 0.006, builder_.fine(24), brass_);
}

void DemoRoom::candlestick(const Vec3d& foot, double height) {
  const double h = height;
  const Profile stick = smooth_profile({{0.0, 0.0},
                                        {0.045, 0.0},
                                        {0.047, 0.006},
                                        {0.03, 0.014},
                                        {0.010, 0.03},
                                        {0.008, 0.3 * h},
                                        {0.015, 0.34 * h},
                                        {0.008, 0.38 * h},
                                        {0.008, 0.7 * h},
                                        {0.02, 0.8 * h},
                                        {0.021, h},
                                        {0.017, h},
                                        {0.0, 0.97 * h}},
                                       builder_.fine(6));
  builder_.lathe(stick, builder_.fine(48), placed_at(foot), brass_);
  const double top = h + 0.11;
  const Profile candle = smooth_profile({{0.0105, 0.985 * h},
                                         {0.0105, top - 0.01},
                                         {0.0095, top},
                                         {0.006, top - 0.002},
                                         {0.0, top - 0.003}},
                                        builder_.fine(4));
  builder_.lathe(candle, builder_.fine(32), placed_at(foot), wax_);
  const Profile flame = smooth_profile(
      {{0.0, top + 0.004}, {0.005, top + 0.012}, {0.004, top + 0.024}, {0.0, top + 0.042}}, 3);
  builder_.lathe(flame, 10, placed_at(foot), flame_);
}

void DemoRoom::tableware() {
  const auto on_table = [](double x, double z) { return kTable + Vec3d(x, kTableTop, z); };
  fruit_bowl(on_table(-0.05, -0.12));
  wine_glass(on_table(0.36, 0.30), 0.9);
  wine_glass(on_table(-0.38, 0.34), 0.8);
  wine_glass(on_table(0.20, 0.42), 0.0);
  wine_glass(on_table(-0.44, -0.22), 0.7);
  wine_glass(on_table(0.46, -0.22), 0.0);
  carafe(on_table(0.30, -0.02));
  kettle(on_table(-0.22, 0.22), 0.62);
  candlestick(on_table(0.13, -0.36), 0.20);
  candlestick(on_table(0.03, -0.44), 0.14);
  const Profile plate = smooth_profile({{0.0, 0.001},
                                        {0.075, 0.001},
                                        {0.085, 0.004},
                                        {0.12, 0.014},
                                        {0.121, 0.016},
                                        {0.12, 0.017},
                                        {0.083, 0.007},
                                        {0.07, 0.005},
                                        {0.0, 0.005}},
                                       builder_.fine(5));
  for (const Vec3d& place : {on_table(0.08, 0.52), on_table(0.52, 0.06), on_table(-0.52, 0.06)}) {
    builder_.lathe(plate, builder_.fine(96), placed_at(place), ceramic_);
  }
  // A stack of books to read, and glass marbles.
  for (int index = 0; index < 3; ++index) {
    Placement flat = turned(
        on_table(0.34 + 0.01 * index, -0.50 + 0.03 * index) + Vec3d(0, 0.026 * (index + 1), 0),
        0.07 * index + 0.02);
    flat = {flat.origin, -flat.y, flat.x, flat.z};  // lying on its side
    book(flat, 0.025, 0.20, 0.15);
  }
  builder_.sphere(on_table(-0.02, 0.36) + Vec3d(0, 0.022, 0), 0.022, builder_.fine(48), crystal_);
  builder_.sphere(on_table(0.045, 0.375) + Vec3d(0, 0.015, 0), 0.015, builder_.fine(40),
                  green_glass_);
  builder_.sphere(on_table(0.015, 0.33) + Vec3d(0, 0.012, 0), 0.012, builder_.fine(40), mirror_);
}

void DemoRoom::pendant() {
  const Vec3d top = kTable + Vec3d(0, kHeight, 0);
  const double y = 1.72;
  const std::vector<Vec3d> cord = {top, {top.x, 2.3, top.z}, {top.x, y + 0.2, top.z}};
  builder_.tube(cord, 0.004, 0.004, builder_.fine(10), iron_);
  const Profile shade = smooth_profile(
      {{0.235, 0.0}, {0.22, 0.05}, {0.15, 0.13}, {0.05, 0.18}, {0.025, 0.22}, {0.0, 0.225}},
      builder_.fine(8));
  builder_.lathe(shade, builder_.fine(96), placed_at({top.x, y, top.z}), iron_);
  Profile inside;
  for (auto point = shade.rbegin(); point != shade.rend(); ++point) {
    inside.push_back({std::max(0.0, point->radius - 0.003), point->height - 0.003});
  }
  builder_.lathe(inside, builder_.fine(96), placed_at({top.x, y, top.z}), brass_);
  builder_.sphere({top.x, y + 0.07, top.z}, 0.09, 16, bulb_);
}

void DemoRoom::armchair(const Vec3d& origin, double turns) {
  const Placement place = turned(origin, turns);
  builder_.cushion(place * placed_at({0, 0.27, 0}), {0.40, 0.14, 0.38}, velvet_);
  builder_.cushion(place * placed_at({0, 0.43, 0.02}), {0.33, 0.085, 0.34}, velvet_);
  builder_.cushion(
      place * Placement{{0, 0.72, -0.33}, {1, 0, 0}, {0, 0.966, -0.259}, {0, 0.259, 0.966}},
      {0.40, 0.36, 0.12}, velvet_);
  for (const double side : {-1.0, 1.0}) {
    builder_.cushion(place * placed_at({side * 0.40, 0.42, 0.02}), {0.10, 0.20, 0.38}, velvet_);
    for (const double z : {-0.3, 0.3}) {
      const std::vector<Vec3d> leg = {place({side * 0.33, 0.16, z}), place({side * 0.345, 0.08, z}),
                                      place({side * 0.36, 0.0, z * 1.06})};
      builder_.tube(leg, 0.026, 0.014, builder_.fine(20), brass_);
    }
  }
  builder_.cushion(place * Placement{{0.06, 0.63, -0.13},
                                     {0.92, 0.39, 0},
                                     {-0.36, 0.85, -0.37},
                                     {-0.145, 0.34, 0.93}},
                   {0.19, 0.19, 0.075}, yarns_[3]);
}

void DemoRoom::floor_lamp(const Vec3d& foot) {
  const Profile base = smooth_profile(
      {{0.0, 0.0}, {0.14, 0.0}, {0.145, 0.01}, {0.12, 0.02}, {0.02, 0.03}, {0.010, 0.05}},
      builder_.fine(6));
  builder_.lathe(base, builder_.fine(72), placed_at(foot), brass_);
  const std::vector<Vec3d> pole = {foot + Vec3d(0, 0.04, 0), foot + Vec3d(0, 0.8, 0),
                                   foot + Vec3d(0, 1.5, 0)};
  builder_.tube(pole, 0.010, 0.010, builder_.fine(20), brass_);
  const Profile shade = {{0.235, 1.36}, {0.22, 1.46}, {0.19, 1.60}, {0.165, 1.70}};
  builder_.lathe(shade, builder_.fine(96), placed_at(foot), shade_);
  builder_.sphere(foot + Vec3d(0, 1.52, 0), 0.08, 16, bulb_);
}

void DemoRoom::side_table(const Vec3d& foot) {
  const Profile top = smooth_profile(
      {{0.0, 0.50}, {0.235, 0.50}, {0.245, 0.507}, {0.245, 0.515}, {0.235, 0.52}, {0.0, 0.52}},
      builder_.fine(4));
  builder_.lathe(top, builder_.fine(96), placed_at(foot), oak_);
  for (int leg = 0; leg < 3; ++leg) {
    const double turns = 0.08 + leg / 3.0;
    const Vec3d out(cosine_of_turns(turns), 0.0, sine_of_turns(turns));
    const std::vector<Vec3d> path = {foot + out * 0.22, foot + out * 0.17 + Vec3d(0, 0.25, 0),
                                     foot + out * 0.12 + Vec3d(0, 0.502, 0)};
    builder_.tube(path, 0.011, 0.014, builder_.fine(16), oak_);
  }
  builder_.sphere(foot + Vec3d(-0.09, 0.60, 0.06), 0.08, builder_.fine(96), mirror_);
  builder_.sphere(foot + Vec3d(0.07, 0.575, 0.10), 0.055, builder_.fine(80), crystal_);
  builder_.sphere(foot + Vec3d(0.10, 0.565, -0.07), 0.045, builder_.fine(64), steel_);
  const Profile vase = smooth_profile({{0.0, 0.52},
                                       {0.035, 0.52},
                                       {0.05, 0.56},
                                       {0.045, 0.63},
                                       {0.02, 0.70},
                                       {0.024, 0.75},
                                       {0.0225, 0.751},
                                       {0.021, 0.75},
                                       {0.017, 0.70},
                                       {0.042, 0.63},
                                       {0.0465, 0.56},
                                       {0.03, 0.53},
                                       {0.0, 0.53}},
                                      builder_.fine(8));
  builder_.lathe(vase, builder_.fine(80), placed_at(foot + Vec3d(0.0, 0.0, -0.13)), green_glass_);
}

void DemoRoom::pot(const Vec3d& foot, double radius, double height, std::uint32_t pot_material) {
  const Profile wall = smooth_profile({{0.0, 0.0},
                                       {0.7 * radius, 0.0},
                                       {0.76 * radius, 0.05 * height},
                                       {radius, 0.9 * height},
                                       {1.06 * radius, 0.93 * height},
                                       {1.06 * radius, height},
                                       {0.95 * radius, height},
                                       {0.9 * radius, 0.88 * height}},
                                      builder_.fine(4));
  builder_.lathe(wall, builder_.fine(56), placed_at(foot), pot_material);
  builder_.lathe({{0.91 * radius, 0.88 * height}, {0.0, 0.9 * height}}, builder_.fine(56),
                 placed_at(foot), soil_);
}

// A small tree: a crooked trunk, branches, and leaves around the branches' ends.
void DemoRoom::leafy_plant(const Vec3d& foot, double height, std::size_t leaves,
                           std::uint64_t seed) {
  DemoRandom random(seed);
  std::vector<Vec3d> trunk = {foot};
  for (int step = 1; step <= 4; ++step) {
    trunk.push_back(foot + Vec3d(random.between(-0.05, 0.05), height * 0.17 * step,
                                 random.between(-0.05, 0.05)));
  }
  const std::vector<Vec3d> stem = smooth_path(trunk, builder_.fine(8));
  builder_.tube(stem, 0.022, 0.010, builder_.fine(20), bark_);
  constexpr std::size_t kBranches = 16;
  for (std::size_t branch = 0; branch < kBranches; ++branch) {
    const double share = 0.35 + 0.65 * static_cast<double>(branch) / kBranches;
    const Vec3d begin =
        stem[static_cast<std::size_t>(share * static_cast<double>(stem.size() - 1))];
    const double turns = 0.382 * static_cast<double>(branch) + random.between(0.0, 0.1);
    const double reach = height * random.between(0.18, 0.30);
    const Vec3d out(cosine_of_turns(turns), 0.0, sine_of_turns(turns));
    const std::vector<Vec3d> path =
        smooth_path({begin, begin + out * (0.5 * reach) + Vec3d(0, 0.35 * reach, 0),
                     begin + out * reach + Vec3d(0, random.between(0.5, 0.9) * reach, 0)},
                    builder_.fine(6));
    builder_.tube(path, 0.007, 0.003, builder_.fine(10), bark_);
    for (std::size_t index = 0; index < leaves / kBranches; ++index) {
      const double t = random.between(0.3, 1.0);
      const Vec3d root = path[static_cast<std::size_t>(t * static_cast<double>(path.size() - 1))];
      const Vec3d direction =
          out * random.between(-0.4, 1.2) +
          Vec3d(random.between(-0.9, 0.9), random.between(-0.3, 0.7), random.between(-0.9, 0.9));
      const double length = random.between(0.07, 0.13) * height;
      builder_.leaf(pointing(root, direction, random.between(0.0, 1.0)), length, 0.42 * length,
                    random.between(0.1, 0.5), 8, random.below(4) == 0 ? leaf_young_ : leaf_);
    }
  }
}

void DemoRoom::fern(const Vec3d& foot, std::size_t fronds, std::uint64_t seed) {
  DemoRandom random(seed);
  fronds = static_cast<std::size_t>(static_cast<double>(fronds) / coarse_);
  for (std::size_t frond = 0; frond < fronds; ++frond) {
    const double turns =
        static_cast<double>(frond) / static_cast<double>(fronds) + random.between(-0.04, 0.04);
    const Vec3d out(cosine_of_turns(turns), 0.0, sine_of_turns(turns));
    const double reach = random.between(0.10, 0.17);
    const std::vector<Vec3d> path =
        smooth_path({foot, foot + out * (0.4 * reach) + Vec3d(0, 0.75 * reach, 0),
                     foot + out * reach + Vec3d(0, random.between(0.3, 0.75) * reach, 0)},
                    12);
    builder_.tube(path, 0.0016, 0.0006, 5, leaf_young_);
    for (std::size_t index = 4; index < path.size(); ++index) {
      const Vec3d tangent = glm::normalize(path[index] - path[index - 1]);
      const Vec3d side = glm::cross(tangent, Vec3d(0, 1, 0));
      for (const double sign : {-1.0, 1.0}) {
        const double length = 0.032 * (1.05 - static_cast<double>(index) / 24.0);
        builder_.leaf(pointing(path[index], side * sign + tangent * 0.5, 0.25), length,
                      0.35 * length, 0.3, 4, leaf_young_);
      }
    }
  }
}

// Woven of horizontal strands around upright stakes.
void DemoRoom::basket(const Vec3d& foot) {
  constexpr std::size_t kStakes = 28;
  constexpr int kRows = 22;
  const std::size_t pieces = builder_.fine(140);
  for (int row = 0; row < kRows; ++row) {
    const double y = 0.008 + 0.015 * row;
    const double radius = 0.17 + 0.045 * row / kRows;
    std::vector<Vec3d> strand;
    for (std::size_t piece = 0; piece <= pieces; ++piece) {
      const double turns = static_cast<double>(piece) / static_cast<double>(pieces);
      const double weave =
          0.006 * sine_of_turns(turns * kStakes * 0.5 + (row % 2 == 0 ? 0.0 : 0.5));
      strand.push_back(foot + Vec3d((radius + weave) * cosine_of_turns(turns), y,
                                    (radius + weave) * sine_of_turns(turns)));
    }
    builder_.tube(strand, 0.0072, 0.0072, builder_.fine(8), wicker_);
  }
  for (std::size_t stake = 0; stake < kStakes; ++stake) {
    const double turns = static_cast<double>(stake) / kStakes;
    const Vec3d out(cosine_of_turns(turns), 0.0, sine_of_turns(turns));
    const std::vector<Vec3d> path = {foot + out * 0.17, foot + out * 0.192 + Vec3d(0, 0.17, 0),
                                     foot + out * 0.215 + Vec3d(0, 0.35, 0)};
    builder_.tube(path, 0.005, 0.005, builder_.fine(8), wicker_);
  }
  for (int ball = 0; ball < 9; ++ball) {
    const double turns = 0.29 * ball;
    const double out = ball < 6 ? 0.10 : 0.03;
    builder_.sphere(foot + Vec3d(out * cosine_of_turns(turns), ball < 6 ? 0.30 : 0.36,
                                 out * sine_of_turns(turns)),
                    0.062, builder_.fine(64),
                    yarns_[static_cast<std::size_t>(ball) % yarns_.size()]);
  }
}

// Takes what is left of the triangles that were asked for: blades of yarn in a pattern.
void DemoRoom::rug() {
  constexpr double kHalfX = 1.55;
  constexpr double kHalfZ = 1.15;
  const Vec3d centre = kTable + Vec3d(0.0, 0.0, 0.05);
  builder_.box(placed_at(centre), {-kHalfX, 0.0, -kHalfZ}, {kHalfX, 0.004, kHalfZ}, yarns_[0]);
  const std::size_t used = builder_.triangle_count();
  const std::size_t left =
      triangles_target_ > used ? static_cast<std::size_t>(triangles_target_) - used : 0;
  const std::size_t blades = std::max(left / 3, many(5000));
  const double spacing = std::sqrt(4.0 * kHalfX * kHalfZ / static_cast<double>(blades));
  const auto columns = static_cast<std::size_t>(2.0 * kHalfX / spacing);
  for (std::size_t blade = 0; blade < blades; ++blade) {
    const double x =
        (static_cast<double>(blade % columns) + random_.between(0.0, 1.0)) * spacing - kHalfX;
    const double z =
        (static_cast<double>(blade / columns) + random_.between(0.0, 1.0)) * spacing - kHalfZ;
    const double edge = std::min(kHalfX - std::abs(x), kHalfZ - std::abs(z));
    const double lattice = sine_of_turns((x + z) * 1.7) * sine_of_turns((x - z) * 1.7);
    const std::size_t yarn = edge < 0.06       ? 0U
                             : edge < 0.20     ? 2U
                             : edge < 0.24     ? 3U
                             : lattice > 0.35  ? 0U
                             : lattice < -0.55 ? 3U
                                               : 1U;
    const double turns = random_.between(0.0, 1.0);
    const Vec3d side = Vec3d(cosine_of_turns(turns), 0.0, sine_of_turns(turns)) * (0.45 * spacing);
    const Vec3d lean(random_.between(-0.006, 0.006), random_.between(0.010, 0.016),
                     random_.between(-0.006, 0.006));
    const Vec3d root = centre + Vec3d(x, 0.003, z);
    const Vec3d middle = root + lean * 0.6;
    builder_.quad(root - side, root + side, middle + side * 0.8, middle - side * 0.8, yarns_[yarn]);
    builder_.triangle(middle - side * 0.8, middle + side * 0.8, root + lean * 1.1 + side * 0.2,
                      yarns_[yarn]);
  }
}

void DemoRoom::furnish() {
  define_materials();
  shell();
  parquet();
  window();
  ceiling_lights();
  bookshelf();
  picture(4.35, 1.62, 0.74, 0.56, 0);
  picture(5.25, 1.75, 0.42, 0.54, 1);
  table();
  tableware();
  pendant();
  chair(kTable + Vec3d(0.08, 0, 0.98), 0.02);
  chair(kTable + Vec3d(-0.98, 0, 0.10), -0.26);
  chair(kTable + Vec3d(0.05, 0, -0.95), 0.49);
  chair(kTable + Vec3d(1.05, 0, -0.15), 0.29);
  armchair({4.45, 0.0, 1.0}, -0.06);
  floor_lamp({5.18, 0.0, 0.55});
  side_table({3.80, 0.0, 0.50});
  pot({0.48, 0.0, 0.52}, 0.19, 0.34, terracotta_);
  leafy_plant({0.48, 0.30, 0.52}, 1.75, many(1900), 5);
  pot({0.52, 0.0, 3.75}, 0.16, 0.28, ceramic_);
  leafy_plant({0.52, 0.25, 3.75}, 1.15, many(1100), 9);
  pot({0.06, 0.745, 1.75}, 0.06, 0.10, glaze_);
  fern({0.06, 0.845, 1.75}, 14, 3);
  pot({0.06, 0.745, 2.85}, 0.06, 0.10, terracotta_);
  fern({0.06, 0.845, 2.85}, 14, 4);
  basket({4.55, 0.0, 2.1});
  rug();
}

// A far lamp whose cone just fills the window behind the camera. A directional light would look the
// same but would be sampled from everywhere in the room.
PunctualLight evening_sun(const Frame& frame) {
  const Vec3d window(4.7, 1.65, kDepth);
  const Vec3d direction = glm::normalize(Vec3d(-0.52, -0.22, -1.0));
  constexpr double kDistance = 10.0;
  constexpr double kRadius = 1.3;
  const double scale = std::ldexp(1.0, frame.scale_exponent);
  const double slant = std::sqrt(kDistance * kDistance + kRadius * kRadius);
  PunctualLight sun;
  sun.kind = PunctualLightKind::kSpot;
  sun.position = Vec3(scene_from_file(frame, window - direction * kDistance));
  sun.direction = Vec3(direction);
  sun.intensity = Vec3(Vec3d(8.5, 5.4, 2.7) * (kDistance * kDistance * scale * scale));
  sun.cos_outer = static_cast<float>(kDistance / slant);
  sun.cos_inner = sun.cos_outer + 1e-3F;
  return sun;
}

Camera standing_camera() {
  Camera camera;
  camera.name = "standing";
  camera.position_file = Vec3d(4.95, 1.6, 5.3);
  camera.forward = glm::normalize(Vec3d(2.80, 1.0, 1.5) - camera.position_file);
  camera.right = glm::normalize(glm::cross(camera.forward, Vec3d(0.0, 1.0, 0.0)));
  camera.up = glm::cross(camera.right, camera.forward);
  camera.vertical_fov_rad = 0.82;
  return camera;
}

Camera table_camera() {
  Camera camera;
  camera.name = "table";
  camera.position_file = kTable + Vec3d(0.75, 1.12, 1.15);
  camera.forward = glm::normalize(kTable + Vec3d(-0.02, 0.82, 0.0) - camera.position_file);
  camera.right = glm::normalize(glm::cross(camera.forward, Vec3d(0.0, 1.0, 0.0)));
  camera.up = glm::cross(camera.right, camera.forward);
  camera.vertical_fov_rad = 0.70;
  return camera;
}

}  // namespace

Scene make_demo_scene(std::uint64_t triangles_target) {
  Scene scene;
  scene.frame.centre = Vec3d(0.5 * kWidth, 0.5 * kHeight, 0.5 * kDepth);
  scene.frame.scale_exponent = -2;  // a half of 4 m becomes 1
  DemoRoom(scene, triangles_target).furnish();
  scene.lights.push_back(evening_sun(scene.frame));
  scene.cameras = {standing_camera(), table_camera()};
  scene.import.triangles_declared = scene.triangles.size();
  return scene;
}

}  // namespace preheat
