// What tests of whole clusters share: a folder with a compiled scene, ports, and the programs.
#pragma once

#include <gtest/gtest.h>

#include <cstdlib>
#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "tests/system/process.h"

namespace preheat {

class RenderFixture : public ::testing::Test {
 protected:
  // For SetUpTestSuite: path("demo.store") in a new folder.
  static void make_store(const std::string& name) {
    std::string pattern = (fs::temp_directory_path() / (name + "_XXXXXX")).string();
    ASSERT_NE(::mkdtemp(pattern.data()), nullptr);
    folder = pattern;
    run_well("compile", {"compile", "demo:50000", "-o", path("demo.store")});
  }
  static void TearDownTestSuite() { fs::remove_all(folder); }

  void SetUp() override {
    port_ = free_port_pair();
    address_ = "tcp://127.0.0.1:" + std::to_string(port_);
  }

  static std::string path(const std::string& name) { return (folder / name).string(); }

  static void run_well(const std::string& name, const std::vector<std::string>& arguments) {
    Process process{kPreheat, arguments, path(name + ".log")};
    ASSERT_EQ(process.wait(), 0) << process.log();
  }

  static std::vector<std::string> render_arguments(const std::string& name, const char* size,
                                                   const char* samples,
                                                   const std::vector<std::string>& more) {
    std::vector<std::string> arguments{"render",   path("demo.store"),
                                       "-o",       path(name + ".exr"),
                                       "--report", path(name + ".json"),
                                       "--size",   size,
                                       "--spp",    samples};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return arguments;
  }
  static nlohmann::json report_of(const std::string& name) {
    return nlohmann::json::parse(std::ifstream(path(name + ".json")));
  }

  static inline const std::string kPreheat = PREHEAT_PROGRAM_DIR "/preheat";
  static inline const std::string kWorker = PREHEAT_PROGRAM_DIR "/preheat-worker";
  static inline fs::path folder{};
  static inline std::string expected{};  // the image's hash, as --local renders it

  unsigned port_ = 0;
  std::string address_{};
};

}  // namespace preheat
