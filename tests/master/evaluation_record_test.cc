#include "master/evaluation_record.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "master/evaluate_page.h"

namespace preheat {
namespace {

using testing::HasSubstr;
using testing::Not;

ModelResult model_of(const EvaluationRecord& record, const char* name,
                     const std::vector<double>& all, double seconds) {
  ModelResult model;
  model.name = name;
  model.unit = "voxel";
  model.estimated = {all, all};
  model.judgement = judge(record, model.estimated);
  model.judgement.seconds = seconds;
  return model;
}

// Three voxels of ten bytes; `good` is twice the truth, `bad` the reverse order.
EvaluationRecord small_record() {
  EvaluationRecord record;
  record.scene = "<room> & garden";
  record.camera = "camera 0";
  record.width = 8;
  record.height = 4;
  record.spp = 2;
  record.rays = {64, 100, 36, 0};
  record.truth_seconds = 3.0;
  record.one_spp_seconds = 0.5;
  record.counted = {{10.0, 20.0, 30.0}, {100.0, 200.0, 700.0}};
  record.bytes = {10.0, 10.0, 10.0};
  record.oracle = judge(record, record.counted).captured;
  record.models.push_back(model_of(record, "good", {200.0, 400.0, 1400.0}, 0.25));
  record.models.push_back(model_of(record, "profile", {3.0, 2.0, 1.0}, 0.5));
  return record;
}

TEST(EvaluationRecord, JudgesByTheCounts) {
  const EvaluationRecord record = small_record();

  const Judgement& good = record.models[0].judgement;
  EXPECT_DOUBLE_EQ(*good.all.beta, 2.0);
  EXPECT_DOUBLE_EQ(*good.all.total_ratio, 2.0);
  EXPECT_DOUBLE_EQ(good.captured->shares[kQuarter], 0.75 * 0.7);
  EXPECT_DOUBLE_EQ(record.models[1].judgement.captured->shares[kQuarter], 0.75 * 0.1);
  EXPECT_DOUBLE_EQ(unexplained(good.all), 0.0);
  EXPECT_DOUBLE_EQ(unexplained({}), 1.0);
}

TEST(EvaluationRecord, LeavesHaveNoBytesToCapture) {
  EvaluationRecord record = small_record();
  record.bytes.clear();

  EXPECT_FALSE(judge(record, record.counted).captured.has_value());
}

TEST(EvaluationJson, HasEveryDocumentedKey) {
  const auto json = make_evaluation_json(small_record());

  EXPECT_EQ(json["voxels"], 3);
  EXPECT_EQ(json["rays_counted"], 200);
  EXPECT_EQ(json["one_spp_seconds"], 0.5);
  ASSERT_EQ(json["models"].size(), 2U);
  for (const char* key : {"name", "knobs", "unit", "seconds", "alpha", "beta", "sigma",
                          "sigma_over_mean", "r2", "pearson", "spearman", "total_ratio"}) {
    EXPECT_TRUE(json["models"][0].contains(key)) << key;
  }
  for (const char* share : {"0.01", "0.1", "0.25", "0.5"}) {
    EXPECT_TRUE(json["models"][0]["capture"].contains(share)) << share;
    EXPECT_TRUE(json["oracle"]["capture"].contains(share)) << share;
  }
  EXPECT_TRUE(json["models"][0]["r2"].is_null());  // three voxels
  EXPECT_EQ(json["oracle"]["seconds"], 3.0);
  EXPECT_EQ(json["profile"]["name"], "profile");
  EXPECT_FALSE(json.contains("sweep"));
  EXPECT_FALSE(json.contains("ablation"));
}

TEST(EvaluationCsv, HasTheColumnsOfThePapersTable4) {
  const std::string csv = make_evaluation_csv(small_record());

  EXPECT_TRUE(
      csv.starts_with("model,voxel,primary_estimated,primary_rendered,all_estimated,all_rendered\n"
                      "good,0,200,10,200,100\n"
                      "good,1,400,20,400,200\n"))
      << csv;
  EXPECT_THAT(csv, HasSubstr("\nprofile,2,1,30,1,700\n"));
}

TEST(EvaluationTable, SaysWhatIsNotKnownWithADash) {
  const std::string table = make_evaluation_table(small_record());

  EXPECT_THAT(table, HasSubstr("best possible"));
  EXPECT_THAT(table, HasSubstr("52.50"));  // 75 % of a voxel with 70 % of the accesses
  EXPECT_THAT(table, HasSubstr(" - "));
}

TEST(EvaluationSweep, MarksFrontsOfAllAndOfEachModelAndItsKnee) {
  const auto setting = [](const char* model, double seconds, double pearson) {
    SweepResult result;
    result.model = model;
    result.judgement.seconds = seconds;
    result.judgement.all.pearson = pearson;
    return result;
  };
  std::vector<SweepResult> sweep{setting("a", 0.1, 0.5), setting("a", 1.0, 0.99),
                                 setting("a", 10.0, 0.991), setting("b", 2.0, 0.4),
                                 setting("b", 4.0, 0.9)};

  mark_fronts(sweep);

  const auto marks = [&](bool SweepResult::*mark) {
    std::vector<bool> marked;
    for (const SweepResult& result : sweep) { marked.push_back(result.*mark); }
    return marked;
  };
  EXPECT_EQ(marks(&SweepResult::is_on_front), (std::vector<bool>{true, true, true, false, false}));
  EXPECT_EQ(marks(&SweepResult::is_on_front_of_own),
            (std::vector<bool>{true, true, true, true, true}));
  EXPECT_EQ(marks(&SweepResult::is_knee), (std::vector<bool>{false, true, false, false, true}));
}

TEST(EvaluationPage, ContainsEverythingAndAsksForNothing) {
  EvaluationRecord record = small_record();
  record.ablation.push_back({"good", "shadow_rays", record.models[0].judgement});
  record.sweep.push_back({"good", "paths=1", true, record.models[0].judgement});
  record.sweep.push_back({"profile", "", true, record.models[1].judgement});
  mark_fronts(record.sweep);

  const std::string page = make_evaluation_page(record);

  for (const char* part :
       {"<!DOCTYPE html>", "All models", "Capture", "Speed against error", "Fits", "figure 6",
        "What each term is worth", "good without shadow_rays", "&lt;room&gt; &amp; garden",
        "prefers-color-scheme: dark", "scope=\"row\"", "Knee of good: paths=1"}) {
    EXPECT_THAT(page, HasSubstr(part));
  }
  for (const char* outside : {"http:", "https:", "<script", "src=", "@import", "url("}) {
    EXPECT_THAT(page, Not(HasSubstr(outside)));
  }
}

TEST(EvaluationPage, ASceneWithoutVoxelsHasOne) {
  EvaluationRecord record;
  record.models.push_back(model_of(record, "good", {}, 0.1));

  const std::string page = make_evaluation_page(record);

  EXPECT_THAT(page, HasSubstr("</html>"));
  EXPECT_THAT(page, Not(HasSubstr("nan")));
}

}  // namespace
}  // namespace preheat
