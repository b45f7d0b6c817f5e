#include "master/inspect.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "master/compiler.h"
#include "tests/scenes/scratch_folder.h"
#include "tests/scenes/soups.h"

namespace preheat {
namespace {

using testing::HasSubstr;

Store compiled(const Scene& scene, const test::ScratchFolder& folder) {
  CHECK(compile_scene(scene, "room.gltf", {}, {}, folder / "a.store").has_value());
  return *Store::open(folder / "a.store");
}

TEST(Inspect, ShowsTheRowsOfThePapersTable) {
  const test::ScratchFolder folder;
  const Store store = compiled(test::sheet(60), folder);

  const std::string text = describe_store(store);

  for (const char* row : {"internal voxels", "leaf voxels", "empty voxels", "min level",
                          "max level", "mean depth", "mean blocking", "objects a leaf",
                          "traversal cost", "room.gltf", "resident size", "proxy"}) {
    EXPECT_THAT(text, HasSubstr(row));
  }
}

TEST(Inspect, JsonAddsUp) {
  const test::ScratchFolder folder;
  const Store store = compiled(test::sheet(60), folder);

  const nlohmann::json json = store_json(store);

  const nlohmann::json& octree = json["octree"];
  EXPECT_EQ(octree["voxels"].get<int>(), octree["internal_voxels"].get<int>() +
                                             octree["leaf_voxels"].get<int>() +
                                             octree["empty_voxels"].get<int>());
  std::uint64_t counted = 0;
  for (const auto& [bytes, count] : json["voxels"]["block_bytes_histogram"].items()) {
    counted += count.get<std::uint64_t>();
  }
  EXPECT_EQ(counted, store.tables().voxels.size());
  std::uint64_t sections = 0;
  for (const auto& [name, bytes] : json["store"]["sections"].items()) {
    sections += bytes.get<std::uint64_t>();
  }
  EXPECT_LE(sections, store.file_bytes());
  EXPECT_GT(sections + 4096 + 64, store.file_bytes());
  EXPECT_EQ(json["voxels"]["block_bytes"]["sum"], json["store"]["sections"]["blocks"]);
  EXPECT_EQ(json["scene"]["triangles"], 7200);
}

TEST(Inspect, TakesAnEmptyScene) {
  const test::ScratchFolder folder;
  const Store store = compiled(test::empty_scene(), folder);
  EXPECT_THAT(describe_store(store), HasSubstr("count           0"));
  EXPECT_EQ(store_json(store)["voxels"]["count"], 0);
}

}  // namespace
}  // namespace preheat
