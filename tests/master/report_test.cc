#include "master/report.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>

#include "master/scene_source.h"

namespace preheat {
namespace {

namespace fs = std::filesystem;

// A finished render of one triangle by two workers, with numbers that tell fields apart.
class Report : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = (fs::temp_directory_path() / "preheat_report_XXXXXX").string();
    folder_ = ::mkdtemp(name.data());
    std::ofstream(folder_ / "t.obj") << "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    SceneOptions options;
    options.scene = (folder_ / "t.obj").string();
    options.store_cache = folder_.string();
    opened_ = open_scene(options);
    ASSERT_TRUE(opened_.has_value()) << opened_.error().message;
    view_ = resolve_view(opened_->store.tables(), {}, {}).value();
    prediction_.model = "transport";
    prediction_.camera_total = 100.0;
    result_.workers = {worker(1), worker(2)};
    result_.leases = {5, 1, 6, 7, 8};
    record_ = RenderRecord{&opened_->store, &view_, &prediction_, &result_};
    record_.seconds = {1.0, 2.0, 4.0, 8.0};
    record_.pixels_sha256 = "abc";
    record_.settings = {{"cache", "25%"}};
  }
  void TearDown() override { fs::remove_all(folder_); }

  static WorkerStats worker(std::uint64_t factor) {
    WorkerStats stats;
    stats.tiles = 3 * factor;
    stats.rays = {100 * factor, 10 * factor, factor, 0};
    stats.cache.limit_bytes = 1000 * factor;
    stats.cache.peak_bytes = 900 * factor;
    stats.cache.accesses = 400 * factor;
    stats.cache.misses = 4 * factor;
    stats.cache.remote_bytes = 50 * factor;
    return stats;
  }

  fs::path folder_{};
  Result<OpenedScene> opened_ = fail(ExitCode::kFailed, "");
  ResolvedView view_{};
  Prediction prediction_{};
  MasterResult result_{Film(2, 2)};
  RenderRecord record_{};
};

TEST_F(Report, HasEveryDocumentedKey) {
  const nlohmann::json report = make_report(record_);

  for (const char* pointer : {"/version",
                              "/scene/file",
                              "/scene/triangles",
                              "/scene/voxels",
                              "/scene/bytes",
                              "/scene/features_modelled",
                              "/scene/features_left_out",
                              "/settings",
                              "/image/width",
                              "/image/height",
                              "/image/spp",
                              "/image/pixels_sha256",
                              "/image/standard_error",
                              "/prediction/model",
                              "/prediction/seconds",
                              "/prediction/rays_expected",
                              "/preload/voxels",
                              "/preload/bytes",
                              "/preload/seconds",
                              "/leases/granted",
                              "/leases/expired",
                              "/leases/doubled",
                              "/leases/duplicates",
                              "/leases/mismatches",
                              "/rays/camera",
                              "/rays/scatter",
                              "/rays/shadow",
                              "/rays/total",
                              "/time/compile",
                              "/time/predict",
                              "/time/preload",
                              "/time/render",
                              "/time/total",
                              "/workers/1/id",
                              "/workers/1/tiles",
                              "/workers/1/rays"}) {
    EXPECT_TRUE(report.contains(nlohmann::json::json_pointer(pointer))) << pointer;
  }
  for (const std::string cache : {"/cache", "/workers/0/cache"}) {
    for (const char* key :
         {"limit_bytes", "peak_bytes", "build_peak_bytes", "accesses", "hits", "misses", "hit_rate",
          "remote_fetches", "remote_bytes", "rebuilds", "evictions", "stall_seconds"}) {
      EXPECT_TRUE(report.contains(nlohmann::json::json_pointer(cache + "/" + key))) << cache << key;
    }
  }
}

TEST_F(Report, SumsWorkersButTakesTheLargestOfLimitsAndPeaks) {
  const nlohmann::json report = make_report(record_);

  EXPECT_EQ(report["cache"]["limit_bytes"], 2000);
  EXPECT_EQ(report["cache"]["peak_bytes"], 1800);
  EXPECT_EQ(report["cache"]["accesses"], 1200);
  EXPECT_EQ(report["cache"]["remote_bytes"], 150);
  EXPECT_EQ(report["cache"]["hits"], 1188);
  EXPECT_DOUBLE_EQ(report["cache"]["hit_rate"], 0.99);
  EXPECT_EQ(report["rays"]["total"], 333);
  EXPECT_EQ(report["leases"]["mismatches"], 8);
  EXPECT_EQ(report["settings"]["cache"], "25%");
}

TEST_F(Report, TellsWhatWorkersHadCountedWhen) {
  EXPECT_EQ(make_report(record_)["history"].size(), 0U);
  result_.history.seconds = 4.0;
  WorkerHistory& first = result_.history.workers.emplace_back();
  first.points = {{.seconds = 1.0, .accesses = 10, .misses = 4},
                  {.seconds = 4.0, .accesses = 40, .misses = 7}};
  WorkerHistory& late = result_.history.workers.emplace_back();
  late.begin_seconds = 2.0;
  late.points = {{.seconds = 4.0, .accesses = 8, .remote_bytes = 100}};

  const nlohmann::json history = make_report(record_)["history"];

  // As many intervals as the first worker told of; between two points counts grow evenly.
  ASSERT_EQ(history.size(), 2U);
  EXPECT_EQ(history[0]["seconds"], 2.0);
  EXPECT_EQ(history[0]["accesses"], 20.0);
  EXPECT_EQ(history[0]["misses"], 5.0);
  EXPECT_EQ(history[1]["seconds"], 4.0);
  EXPECT_EQ(history[1]["accesses"], 48.0);
  EXPECT_EQ(history[1]["remote_bytes"], 100.0);
}

TEST_F(Report, TheTotalIsTheSumOfThePhases) {
  EXPECT_EQ(make_report(record_)["time"]["total"], 15.0);
}

TEST_F(Report, WithoutAccessesThereIsNoHitRate) {
  for (WorkerStats& stats : result_.workers) { stats.cache.accesses = 0; }

  EXPECT_TRUE(make_report(record_)["cache"]["hit_rate"].is_null());
  EXPECT_NE(make_summary(record_).find("not counted"), std::string::npos);
}

TEST_F(Report, ComparesThePredictionWithWhatWasCountedVoxelByVoxel) {
  ASSERT_EQ(opened_->store.tables().voxels.size(), 1U);
  prediction_.rays_camera = {30.0};
  prediction_.rays_scatter = {20.0};
  prediction_.rays_shadow = {10.0};
  result_.accesses_by_voxel = {40.0};

  const nlohmann::json error = make_report(record_)["prediction"]["error"];

  EXPECT_EQ(error["total_ratio"], 1.5);
  EXPECT_EQ(error["capture_at_0.25"], 0.25);
  EXPECT_EQ(error["capture_at_0.25_best"], 0.25);
  EXPECT_TRUE(error["r2"].is_null());  // one voxel
  EXPECT_TRUE(error["slope"].is_null());
}

TEST_F(Report, SaysWhyAPredictionCannotBeCompared) {
  nlohmann::json prediction = make_report(record_)["prediction"];
  EXPECT_TRUE(prediction["error"].is_null());
  EXPECT_EQ(prediction["error_unknown"],
            "accesses were not counted, or a worker that counted some was lost before the end");

  prediction_.model = "none";
  prediction = make_report(record_)["prediction"];
  EXPECT_TRUE(prediction["error"].is_null());
  EXPECT_EQ(prediction["error_unknown"], "nothing was predicted");
}

TEST_F(Report, TheSkyIsAFeatureOfTheRenderAndNotOfTheScene) {
  const nlohmann::json report = make_report(record_);

  const auto& modelled = report["scene"]["features_modelled"];
  EXPECT_NE(std::find(modelled.begin(), modelled.end(), "environment"), modelled.end());
  EXPECT_EQ(report["settings"]["sky_source"], "1,1,1: the scene has no light");
}

}  // namespace
}  // namespace preheat
