// The image is a pure function of scene and settings: real processes over TCP against `--local`.
//
// PREHEAT_IDENTITY=full runs every combination; the default is a cross-section of them.

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace preheat {
namespace {

const std::string kProgram = PREHEAT_PROGRAM_DIR "/preheat";

struct Combination {
  unsigned workers = 1;
  const char* cache = "25%";
  const char* preload = "transport";
  unsigned tile_size = 32;
  unsigned threads = 1;
  bool peers = true;
};

std::vector<Combination> every_combination() {
  std::vector<Combination> all;
  for (const unsigned workers : {1U, 2U, 4U}) {
    for (const char* cache : {"1%", "3%", "25%", "100%"}) {
      for (const char* preload : {"none", "random", "transport"}) {
        for (const unsigned tile_size : {16U, 32U}) {
          for (const unsigned threads : {1U, 2U}) {
            for (const bool peers : {true, false}) {
              all.push_back({workers, cache, preload, tile_size, threads, peers});
            }
          }
        }
      }
    }
  }
  return all;
}

class Identity : public testing::Test {
 protected:
  void SetUp() override {
    std::string name =
        (std::filesystem::temp_directory_path() / "preheat-identity-XXXXXX").string();
    ASSERT_NE(::mkdtemp(name.data()), nullptr);
    folder_ = name;
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }

  // The report of a render that must succeed.
  nlohmann::json render(const std::string& scene, const std::string& arguments) const {
    const std::string report = (folder_ / "report.json").string();
    const std::string command = kProgram + " render " + scene + " -o " +
                                (folder_ / "image.exr").string() + " --report " + report +
                                " --store-cache " + (folder_ / "stores").string() + " " +
                                arguments + " 2>" + (folder_ / "log").string();
    const int status = std::system(command.c_str());
    EXPECT_EQ(status, 0) << command << '\n' << std::ifstream(folder_ / "log").rdbuf();
    if (status != 0) { return {}; }
    return nlohmann::json::parse(std::ifstream(report));
  }

  void expect_one_image(const std::string& scene, const std::string& view) const {
    const nlohmann::json local = render(scene, view + " --local");
    ASSERT_FALSE(local.is_null());
    const std::string expected = local["image"]["pixels_sha256"];
    const char* const mode = std::getenv("PREHEAT_IDENTITY");
    const bool full = mode != nullptr && std::string(mode) == "full";
    int rendered = 0;
    int different = 0;
    const std::vector<Combination> combinations = every_combination();
    // 23 is coprime to every count of choices, so the cross-section meets each of them.
    for (std::size_t index = 0; index < combinations.size(); index += full ? 1 : 23) {
      const Combination& with = combinations[index];
      const std::string arguments = view + " --workers " + std::to_string(with.workers) +
                                    " --cache " + with.cache + " --preload " + with.preload +
                                    " --tile-size " + std::to_string(with.tile_size) +
                                    " --threads " + std::to_string(with.threads) +
                                    (with.peers ? "" : " --no-peers");
      const nlohmann::json report = render(scene, arguments);
      ASSERT_FALSE(report.is_null());
      ++rendered;
      different += report["image"]["pixels_sha256"] == expected ? 0 : 1;
      EXPECT_EQ(report["image"]["pixels_sha256"], expected) << arguments;
      EXPECT_EQ(report["leases"]["mismatches"], 0) << arguments;
      EXPECT_LE(report["cache"]["peak_bytes"], report["cache"]["limit_bytes"]) << arguments;
    }
    std::cout << rendered << " combinations, " << different << " differ\n";
  }

 private:
  std::filesystem::path folder_;
};

TEST_F(Identity, OfTheDemoSceneOverWorkersCachesPreloadsTilesAndThreads) {
  expect_one_image("demo:200k", "--size 72x56 --spp 2");
}

TEST_F(Identity, OfAnOfficeOverWorkersCachesPreloadsTilesAndThreads) {
  const std::string scene = PREHEAT_SHARED_DIR "/scenes/mgf_office/office.gltf";
  if (!std::filesystem::exists(scene)) { GTEST_SKIP() << "no " << scene; }
  expect_one_image(scene, "--size 72x56 --spp 2");
}

}  // namespace
}  // namespace preheat
