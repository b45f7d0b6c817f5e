// The `preheat` program as its users meet it: exit codes, one clear line, files.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>

#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <regex>
#include <set>
#include <string>

namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

struct Outcome {
  int exit_code = -1;
  std::string standard_output{};
  std::string standard_error{};
};

class Program : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = (fs::temp_directory_path() / "preheat_program_XXXXXX").string();
    folder_ = ::mkdtemp(name.data());
    std::ofstream(path("scene.obj")) << "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n";
  }
  void TearDown() override { fs::remove_all(folder_); }

  [[nodiscard]] std::string path(const std::string& name) const {
    return (folder_ / name).string();
  }
  [[nodiscard]] std::string content(const std::string& name) const {
    std::ifstream stream(path(name), std::ios::binary);
    return {std::istreambuf_iterator<char>(stream), {}};
  }
  [[nodiscard]] Outcome preheat(const std::string& arguments) const {
    const std::string command = "cd " + folder_.string() + " && XDG_CACHE_HOME=" + path("cache") +
                                " " PREHEAT_PROGRAM_DIR "/preheat " + arguments +
                                " >stdout.txt 2>stderr.txt";
    const int status = std::system(command.c_str());
    return {WEXITSTATUS(status), content("stdout.txt"), content("stderr.txt")};
  }

  fs::path folder_{};
};

constexpr const char* kSmall = " --local --size 32x24 --spp 2 --threads 1 ";

TEST_F(Program, RendersAnObjectUnderTheSkyAndReportsIt) {
  const Outcome outcome =
      preheat(std::string("render scene.obj -o a.exr --report a.json") + kSmall);

  ASSERT_EQ(outcome.exit_code, 0) << outcome.standard_error;
  EXPECT_EQ(outcome.standard_output, "");
  EXPECT_THAT(outcome.standard_error, HasSubstr("compiling scene.obj"));
  const auto report = nlohmann::json::parse(content("a.json"));
  EXPECT_EQ(report["image"]["width"], 32);
  EXPECT_EQ(report["rays"]["camera"], 32 * 24 * 2);
  EXPECT_EQ(report["scene"]["triangles"], 2);
  EXPECT_EQ(report["prediction"]["model"], "transport");
  EXPECT_GT(report["prediction"]["error"]["total_ratio"], 0.5);
  EXPECT_THAT(report["settings"]["sky_source"].get<std::string>(), HasSubstr("no light"));
}

TEST_F(Program, WhoLooksOnChangesNoPixel) {
  const std::string alone = "render scene.obj -o a.png --report a.json";
  const std::string watched =
      "render scene.obj -o b.png --report b.json --html b.html --status 127.0.0.1:0 "
      "--display 127.0.0.1:9";
  for (const std::string& how : {std::string(kSmall), std::string(" --size 32x24 --spp 2")}) {
    const Outcome unseen = preheat(alone + how);
    const Outcome seen = preheat(watched + how);

    ASSERT_EQ(unseen.exit_code, 0) << unseen.standard_error;
    ASSERT_EQ(seen.exit_code, 0) << seen.standard_error;
    EXPECT_THAT(seen.standard_error, HasSubstr("event=status_page url=http://127.0.0.1:"));
    EXPECT_EQ(content("a.png"), content("b.png"));
    const std::string page = content("b.html");
    EXPECT_THAT(page, HasSubstr("Predicted over counted"));
    EXPECT_THAT(page, HasSubstr("<th scope=\"row\">worker 0</th>"));
    EXPECT_TRUE(page.ends_with("</html>\n"));
  }
}

TEST_F(Program, WorkersCountVoxelByVoxelWhatOneProcessCounts) {
  const std::string view = " --size 64x48 --spp 4 --count-accesses exact";
  const Outcome workers =
      preheat("render scene.obj -o w.png --report w.json --workers 2 --tile-size 16" + view);
  const Outcome local = preheat("render scene.obj -o l.png --report l.json --local" + view);

  ASSERT_EQ(workers.exit_code, 0) << workers.standard_error;
  ASSERT_EQ(local.exit_code, 0) << local.standard_error;
  const auto by_workers = nlohmann::json::parse(content("w.json"))["prediction"]["error"];
  EXPECT_GT(by_workers["total_ratio"], 0.5);
  EXPECT_EQ(by_workers, nlohmann::json::parse(content("l.json"))["prediction"]["error"]);
}

TEST_F(Program, TheSecondRunCompilesNothingAndGivesTheSameBits) {
  ASSERT_EQ(preheat(std::string("render scene.obj -o a.exr") + kSmall).exit_code, 0);
  const Outcome second = preheat(std::string("render scene.obj -o b.exr") + kSmall);
  const Outcome compared = preheat("compare a.exr b.exr --json -");

  EXPECT_EQ(second.exit_code, 0);
  EXPECT_EQ(second.standard_error.find("compiling"), std::string::npos);
  ASSERT_EQ(compared.exit_code, 0) << compared.standard_error;
  EXPECT_EQ(nlohmann::json::parse(compared.standard_output)["pixels_differing"], 0);
}

TEST_F(Program, ACompiledStoreRendersToTheSameBitsAsItsSource) {
  ASSERT_EQ(preheat("compile scene.obj -o scene.store").exit_code, 0);
  ASSERT_EQ(preheat(std::string("render scene.obj -o a.exr") + kSmall).exit_code, 0);
  ASSERT_EQ(preheat(std::string("render scene.store -o b.exr") + kSmall).exit_code, 0);

  EXPECT_EQ(nlohmann::json::parse(preheat("compare a.exr b.exr --json -").standard_output)["mse"],
            0.0);
}

TEST_F(Program, PredictsAsTableJsonAndCsv) {
  const Outcome table = preheat("predict scene.obj --size 32x24 --spp 2 --json p.json --csv p.csv");

  ASSERT_EQ(table.exit_code, 0) << table.standard_error;
  EXPECT_THAT(table.standard_output, HasSubstr("rays expected"));
  const auto json = nlohmann::json::parse(content("p.json"));
  EXPECT_EQ(json["rays_expected"]["camera"], 32.0 * 24.0 * 2.0);
  EXPECT_THAT(content("p.csv"),
              HasSubstr("voxel,rays_camera,rays_scatter,rays_shadow,rays,resident_bytes\n0,"));
}

TEST_F(Program, EvaluatesModelsAsTableJsonCsvAndPage) {
  const Outcome table = preheat(
      "evaluate scene.obj --size 32x24 --spp 2 --threads 1 --models transport,profile "
      "--json e.json --csv e.csv --html e.html --sweep --ablate");

  ASSERT_EQ(table.exit_code, 0) << table.standard_error;
  EXPECT_THAT(table.standard_output, HasSubstr("best possible"));
  const auto json = nlohmann::json::parse(content("e.json"));
  ASSERT_EQ(json["models"].size(), 2U);
  EXPECT_EQ(json["models"][0]["name"], "transport");
  EXPECT_GT(json["rays_counted"], 32 * 24 * 2);
  EXPECT_GT(json["one_spp_seconds"], 0.0);
  EXPECT_FALSE(json["sweep"].empty());
  EXPECT_EQ(json["ablation"][0]["without"], "none");
  EXPECT_THAT(content("e.csv"), HasSubstr("transport,0,"));
  EXPECT_THAT(content("e.html"), HasSubstr("</html>"));

  const Outcome leaves =
      preheat("evaluate scene.obj --size 32x24 --spp 2 --models transport --unit node:1 --json -");
  ASSERT_EQ(leaves.exit_code, 0) << leaves.standard_error;
  const auto nodes = nlohmann::json::parse(leaves.standard_output);
  EXPECT_EQ(nodes["unit"], "node:1");
  EXPECT_TRUE(nodes["models"][0]["capture"].is_null());
}

TEST_F(Program, PredictsWithTheModelOfThePaperAndItsKnobs) {
  const Outcome table = preheat(
      "predict scene.obj --size 32x24 --spp 2 --model paper --paper-depth 1 --paper-bins 4x8 "
      "--json p.json");

  ASSERT_EQ(table.exit_code, 0) << table.standard_error;
  EXPECT_THAT(table.standard_output, HasSubstr("cells of the octree cut at depth 1"));
  const auto json = nlohmann::json::parse(content("p.json"));
  EXPECT_EQ(json["model"], "paper");
  EXPECT_EQ(json["nodes"]["depth"], 1);
  EXPECT_EQ(json["nodes"]["unit"], "leaf traversals");
  EXPECT_FALSE(json["nodes"]["rays_camera"].empty());
}

struct Case {
  const char* name;
  const char* arguments;
  int exit_code;
  const char* message;  // somewhere in the one line on stderr
};

class Refused : public Program, public ::testing::WithParamInterface<Case> {};

TEST_P(Refused, WithItsExitCodeAndOneLine) {
  const Outcome outcome = preheat(GetParam().arguments);

  EXPECT_EQ(outcome.exit_code, GetParam().exit_code);
  EXPECT_EQ(outcome.standard_output, "");
  EXPECT_THAT(outcome.standard_error, HasSubstr(GetParam().message));
  EXPECT_EQ(std::count(outcome.standard_error.begin(), outcome.standard_error.end(), '\n'), 1)
      << outcome.standard_error;
  EXPECT_FALSE(fs::exists(path("a.png")));
}

INSTANTIATE_TEST_SUITE_P(
    Program, Refused,
    ::testing::Values(
        Case{"no_command", "", 2, "the commands are: compile inspect"},
        Case{"unknown_command", "rendr scene.obj", 2, "'rendr' is not a command"},
        Case{"no_scene", "render -o a.png", 2, "SCENE is required"},
        Case{"no_output", "render scene.obj", 2, "--output is required"},
        Case{"unknown_option", "render scene.obj -o a.png --frobnicate", 2, "--frobnicate"},
        Case{"paper_bins", "predict scene.obj --model paper --paper-bins 6x200", 2, "64x128"},
        Case{"image_format", "render scene.obj -o a.jpg", 2, ".png or .exr"},
        Case{"image_size", "render scene.obj -o a.png --size 0x5", 2, "1..65536"},
        Case{"samples", "render scene.obj -o a.png --spp 0", 2, "--spp: Value 0 not in range 1"},
        Case{"bounces", "render scene.obj -o a.png --bounces 65", 2, "64"},
        Case{"cache_text", "render scene.obj -o a.png --cache 101%", 2, "'101%'"},
        Case{"address", "render scene.obj -o a.png --listen localhost", 2, "tcp://"},
        Case{"two_places", "render scene.obj -o a.png --local --workers 2", 2, "excludes"},
        Case{"model", "render scene.obj -o a.png --preload guess", 2, "guess"},
        Case{"evaluate_model", "evaluate scene.obj --models transport,guess", 2, "guess"},
        Case{"evaluate_unit", "evaluate scene.obj --unit node:99", 2, "node:99"},
        Case{"demo_size", "render demo:7 -o a.png", 2, "demo:7"},
        Case{"output_folder", "render scene.obj -o missing/a.png", 6, "missing/a.png"},
        Case{"page_folder", "render scene.obj -o a.png --html missing/a.html", 6, "missing/a.html"},
        Case{"status_address", "render scene.obj -o a.png --status 8080", 2, "HOST:PORT"},
        Case{"status_for_all", "render scene.obj -o a.png --status 0.0.0.0:8080", 2,
             "--insecure-status"},
        Case{"viewer", "render scene.obj -o a.png --display 127.0.0.1:x", 2, "127.0.0.1:x"},
        Case{"report_folder", "render scene.obj -o a.png --report missing/a.json", 6,
             "missing/a.json"},
        Case{"endpoint_folder",
             "render scene.obj -o a.png --listen tcp://127.0.0.1:* --endpoint-file missing/e", 6,
             "missing/e"},
        Case{"missing_scene", "render missing.gltf -o a.png", 9, "missing.gltf"},
        Case{"missing_store", "render missing.store -o a.png", 5, "missing.store"},
        Case{"missing_image", "compare a.exr b.exr", 1, "a.exr"}),
    [](const auto& test) { return std::string(test.param.name); });

TEST_F(Program, ExplainsItself) {
  for (const char* command :
       {"", "compile", "inspect", "predict", "evaluate", "render", "compare", "keygen", "status"}) {
    const Outcome help = preheat(std::string(command) + " --help");
    EXPECT_EQ(help.exit_code, 0);
    EXPECT_THAT(help.standard_output, HasSubstr("Usage: preheat"));
    EXPECT_EQ(help.standard_error, "");
  }
  EXPECT_THAT(preheat("--version").standard_output, HasSubstr("preheat 0."));
}

// The words of a help text that are options, without what stands behind them.
std::set<std::string> options_in(const std::string& help) {
  static const std::regex option("(^|[^-a-z])(--[a-z][-a-z]*)");
  std::set<std::string> options;
  for (std::sregex_iterator it(help.begin(), help.end(), option), end; it != end; ++it) {
    options.insert((*it)[2].str());
  }
  return options;
}

TEST_F(Program, TheReadmeNamesEveryOption) {
  std::ifstream stream(PREHEAT_README);
  const std::string readme{std::istreambuf_iterator<char>(stream), {}};
  ASSERT_FALSE(readme.empty()) << PREHEAT_README;
  const std::set<std::string> named = options_in(readme);

  for (const char* program : {"preheat compile", "preheat inspect", "preheat predict",
                              "preheat evaluate", "preheat render", "preheat compare",
                              "preheat keygen", "preheat status", "preheat", "preheat-worker"}) {
    const std::string command =
        std::string(PREHEAT_PROGRAM_DIR "/") + program + " --help >" + path("help.txt");
    ASSERT_EQ(std::system(command.c_str()), 0) << command;
    const std::set<std::string> options = options_in(content("help.txt"));
    EXPECT_GE(options.size(), 2U) << program;
    for (const std::string& option : options) {
      EXPECT_TRUE(named.contains(option)) << program << " " << option;
    }
  }
}

}  // namespace
