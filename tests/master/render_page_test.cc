#include "master/render_page.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <regex>

#include "cache/prediction.h"
#include "master/view.h"
#include "tests/master/lit_scene.h"

namespace preheat {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

WorkerHistory history_of(double factor) {
  WorkerHistory worker;
  worker.threads = 2;
  worker.end_seconds = 4.0;
  for (int i = 1; i <= 4; ++i) {
    const auto grown = static_cast<std::uint64_t>(factor * 1000.0 * i);
    worker.points.push_back({1.0 * i, grown, grown, grown / 10, 3, 100 * grown, 0.5 * i});
  }
  worker.runs = {{0.0, 1.0, 0, 1}, {1.0, 4.0, 1, 3}};
  return worker;
}

// A finished render of two workers, with numbers that tell things apart.
class RenderPage : public ::testing::Test {
 protected:
  void SetUp() override {
    settings_.width = 40;
    settings_.height = 30;
    view_.settings = settings_;
    view_.camera_source = "camera 0 '<front> & \"centre\"'";
    prediction_ =
        predict("transport", {store_.tables(), store_.proxy(), settings_, 1, &store_, {}}).value();
    result_.workers.resize(2);
    result_.workers[0].cache.accesses = 1000;
    result_.workers[0].cache.misses = 250;
    result_.workers[1].tiles = 17;
    for (std::size_t voxel = 0; voxel < store_.tables().voxels.size(); ++voxel) {
      result_.accesses_by_voxel.push_back(1000.0 + static_cast<double>(voxel));
    }
    result_.history.seconds = 4.0;
    result_.history.workers = {history_of(1.0), history_of(2.0)};
    result_.history.workers[1].lost = true;
    record_ = {&store_, &view_, &prediction_, &result_, {}, {}, {}};
    record_.settings = {{"cache", "25%"}, {"note", "<script>alert(1)</script>"}};
    record_.pixels_sha256 = "0123abcd";
  }
  [[nodiscard]] std::string page() const {
    return make_render_page(record_, make_report(record_), 0.0);
  }

  test::LitScene scene_{};
  Store store_ = scene_.open();
  RenderSettings settings_ = test::LitScene::settings(40, 2);
  ResolvedView view_{};
  Prediction prediction_{};
  MasterResult result_{Film(40, 30)};
  RenderRecord record_{};
};

std::size_t count_of(const std::string& text, const std::string& part) {
  std::size_t count = 0;
  for (std::size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + 1)) {
    ++count;
  }
  return count;
}

TEST_F(RenderPage, ShowsTheImageThreePicturesOfHeatAndEveryWorker) {
  const std::string html = page();

  EXPECT_EQ(count_of(html, "src=\"data:image/png;base64,"), 4U);
  EXPECT_EQ(count_of(html, "<img alt=\""), 4U);
  for (const char* part :
       {"<!DOCTYPE html>", "lang=\"en\"", "prefers-color-scheme: dark", "Predicted by transport",
        "Counted while rendering", "Predicted over counted", "Hit rate over time",
        "Bytes fetched over time", "Tiles of each worker over time",
        "Seconds that each worker's threads", "Hottest voxels", "0123abcd", "settings.cache", "25%",
        "75.000 %", ", lost", "3 tiles, the first is 1: 1.00 to 4.00 s"}) {
    EXPECT_THAT(html, HasSubstr(part));
  }
  // The hottest is the last voxel, of all that were counted.
  EXPECT_THAT(html, HasSubstr("<th scope=\"row\">voxel " +
                              std::to_string(store_.tables().voxels.size() - 1) + "</th>"));
}

TEST_F(RenderPage, LoadsNothingAndRunsNothing) {
  const std::string html = page();

  for (const char* outside :
       {"http:", "https:", "<script", "<link", "@import", "url(", "onload="}) {
    EXPECT_THAT(html, Not(HasSubstr(outside))) << outside;
  }
  EXPECT_EQ(count_of(html, "src="), count_of(html, "src=\"data:image/png;base64,"));
}

TEST_F(RenderPage, EscapesWhatFilesAndUsersCallThings) {
  const std::string html = page();

  EXPECT_THAT(html, HasSubstr("camera 0 '&lt;front&gt; &amp; &quot;centre&quot;'"));
  EXPECT_THAT(html, HasSubstr("&lt;script&gt;alert(1)&lt;/script&gt;"));
}

TEST_F(RenderPage, ClosesEveryElementItOpens) {
  const std::string html = page();

  for (const char* element : {"figure", "table", "tbody", "tr", "svg", "details", "div", "main",
                              "dl", "text", "rect", "p", "h2"}) {
    const std::regex opened("<" + std::string(element) + "[ >][^>]*[^/]?>|<" + element + ">");
    const std::regex closed_itself("<" + std::string(element) + " [^>]*/>");
    const auto matches = [&html](const std::regex& pattern) {
      return std::distance(std::sregex_iterator(html.begin(), html.end(), pattern),
                           std::sregex_iterator());
    };
    const auto closed =
        static_cast<std::ptrdiff_t>(count_of(html, "</" + std::string(element) + ">"));
    EXPECT_EQ(matches(opened) - matches(closed_itself), closed) << element;
  }
}

TEST_F(RenderPage, SaysWhatIsNotKnown) {
  result_.accesses_by_voxel.clear();
  prediction_ = {};
  prediction_.model = "none";
  result_.history = {};

  const std::string html = page();

  EXPECT_THAT(html, HasSubstr("Nothing was predicted"));
  EXPECT_THAT(html, HasSubstr("Counts are not known"));
  EXPECT_EQ(count_of(html, "<img alt=\""), 1U);
  EXPECT_THAT(html, Not(HasSubstr("nan")));
  EXPECT_THAT(html, HasSubstr("</html>"));
}

TEST_F(RenderPage, OfManyWorkersDrawsTheSumAndTheFirstRows) {
  result_.history.workers.assign(300, history_of(1.0));
  result_.workers.resize(300);

  const std::string html = page();

  EXPECT_THAT(html, HasSubstr("all workers: hit rate"));
  EXPECT_THAT(html, Not(HasSubstr("worker 7: hit rate")));
  EXPECT_THAT(html, HasSubstr("The charts show the first 64 workers"));
  EXPECT_THAT(html, HasSubstr("<th scope=\"row\">worker 299</th>"));
}

}  // namespace
}  // namespace preheat
