#include "master/status_server.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <stb/stb_image.h>

#include <map>
#include <regex>
#include <set>
#include <sstream>

#include "tests/master/raw_client.h"

namespace preheat {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::StartsWith;

const StatusFacts kFacts{"9.9", "room \"a\"\\b\n.glb", "avx2", 64, 32, 16, 4};

RenderSnapshot snapshot_of(std::size_t workers) {
  RenderSnapshot snapshot;
  snapshot.phase = JobPhase::kRendering;
  snapshot.tiles_done = 3;
  snapshot.tiles_total = 8;
  snapshot.workers_lost = 1;
  snapshot.leases = {11, 3, 2, 1, 0};
  snapshot.rendering_seconds = 2.5;
  for (std::size_t id = 0; id < workers; ++id) {
    WorkerSnapshot worker;
    worker.state = id == 0 ? WorkerState::kReady : WorkerState::kGone;
    worker.threads = 2;
    worker.stats.tiles = 5;
    worker.stats.rays = {100, 20, 3, 0};
    worker.stats.cache.accesses = 1000;
    worker.stats.cache.misses = 250;
    worker.stats.cache.remote_bytes = 4096;
    worker.stats.cache.stall_seconds = 0.25;
    snapshot.workers.push_back(worker);
  }
  return snapshot;
}

TEST(StatusJson, HasEveryDocumentedKey) {
  const nlohmann::json json = make_status_json(kFacts, snapshot_of(2), 7);

  for (const char* key : {"/version",
                          "/scene",
                          "/image/width",
                          "/image/height",
                          "/image/spp",
                          "/image/revision",
                          "/phase",
                          "/tiles/done",
                          "/tiles/total",
                          "/workers/ready",
                          "/workers/preparing",
                          "/workers/gone",
                          "/workers/lost",
                          "/leases/granted",
                          "/leases/expired",
                          "/rays",
                          "/cache/hit_rate",
                          "/cache/remote_bytes",
                          "/cache/stall_seconds",
                          "/time/rendering",
                          "/worker/1/id",
                          "/worker/1/state",
                          "/worker/1/tiles",
                          "/worker/1/cache/hit_rate",
                          "/workers_not_listed"}) {
    EXPECT_TRUE(json.contains(nlohmann::json::json_pointer(key))) << key;
  }
  EXPECT_EQ(json["phase"], "rendering");
  EXPECT_EQ(json["rays"], 246);
  EXPECT_DOUBLE_EQ(json["cache"]["hit_rate"], 0.75);
  EXPECT_EQ(json["cache"]["remote_bytes"], 8192);
  EXPECT_EQ(json["workers"]["ready"], 1);
  EXPECT_EQ(json["image"]["revision"], 7);
}

TEST(StatusJson, DoesNotGuessAHitRate) {
  EXPECT_TRUE(make_status_json(kFacts, {}, 0)["cache"]["hit_rate"].is_null());
}

TEST(StatusJson, AnyNumberOfWorkersGivesABoundedAnswer) {
  const RenderSnapshot many = snapshot_of(16'000);

  const nlohmann::json json = make_status_json(kFacts, many, 0);
  const std::string metrics = make_metrics(kFacts, many);

  EXPECT_EQ(json["worker"].size(), kStatusWorkersMax);
  EXPECT_EQ(json["workers_not_listed"], 16'000 - kStatusWorkersMax);
  EXPECT_LT(json.dump().size(), 1U << 20);
  EXPECT_LT(metrics.size(), 1U << 20);
  EXPECT_THAT(metrics, HasSubstr("preheat_worker_tiles_total{worker=\"rest\"} " +
                                 std::to_string(5 * (16'000 - kStatusWorkersMax))));
}

// Prometheus's text format: every sample is of a metric that was declared once before, all samples
// of a metric stand together, and no labels come twice.
TEST(Metrics, AreWhatPrometheusReads) {
  const std::string text = make_metrics(kFacts, snapshot_of(3));

  const std::regex help(R"(# HELP ([a-zA-Z_:][a-zA-Z0-9_:]*) [^\n]+)");
  const std::regex type(R"(# TYPE ([a-zA-Z_:][a-zA-Z0-9_:]*) (counter|gauge))");
  const std::regex sample(
      R"(([a-zA-Z_:][a-zA-Z0-9_:]*)(\{([a-z]+="([^"\\\n]|\\["\\n])*",?)+\})? [-+0-9.e]+)");
  std::map<std::string, std::string> types;
  std::set<std::string> seen;
  std::string current;
  std::istringstream lines(text);
  ASSERT_TRUE(text.ends_with('\n'));
  for (std::string line; std::getline(lines, line);) {
    std::smatch match;
    if (std::regex_match(line, match, help)) {
      current = match[1];
      EXPECT_FALSE(types.contains(current)) << line;
    } else if (std::regex_match(line, match, type)) {
      EXPECT_EQ(match[1], current);
      EXPECT_TRUE(types.emplace(match[1], match[2]).second) << line;
      EXPECT_EQ(match[2] == "counter", current.ends_with("_total")) << line;
    } else {
      ASSERT_TRUE(std::regex_match(line, match, sample)) << line;
      EXPECT_EQ(match[1], current) << line;
      EXPECT_TRUE(seen.insert(line.substr(0, line.rfind(' '))).second) << line;
    }
  }
  EXPECT_GT(types.size(), 15U);
  EXPECT_THAT(text, HasSubstr("preheat_rays_total{worker=\"0\",type=\"scatter\"} 20\n"));
  EXPECT_THAT(text, HasSubstr("preheat_stall_seconds_total{worker=\"2\"} 0.25\n"));
  EXPECT_THAT(text, HasSubstr("scene=\"room \\\"a\\\"\\\\b\\n.glb\""));
}

class Status : public ::testing::Test {
 protected:
  void SetUp() override {
    auto started = StatusServer::start({"127.0.0.1", 0}, kFacts, 0.0);
    ASSERT_TRUE(started.has_value()) << started.error().message;
    server_ = *std::move(started);
    const std::string url = server_->url();
    port_ = static_cast<unsigned>(std::stoul(url.substr(url.rfind(':') + 1)));
  }

  std::unique_ptr<StatusServer> server_{};
  unsigned port_ = 0;
};

TEST_F(Status, ServesWhatThePageAsksFor) {
  const std::string page = test::get(port_, "/");
  EXPECT_THAT(page, HasSubstr("Content-Type: text/html"));
  for (const std::string file : {"/status.css", "/status.js", "/icon.svg"}) {
    EXPECT_THAT(page, HasSubstr("\"" + file + "\""));
    EXPECT_THAT(test::get(port_, file), StartsWith("HTTP/1.1 200 "));
  }
  for (const char* outside : {"http:", "https:", "//"}) {
    EXPECT_THAT(test::body_of(page), Not(HasSubstr(outside)));
    EXPECT_THAT(test::body_of(test::get(port_, "/status.js")), Not(HasSubstr(outside)));
  }
  EXPECT_THAT(test::get(port_, "/etc/passwd"), StartsWith("HTTP/1.1 404 "));
  EXPECT_EQ(test::body_of(test::get(port_, "/healthz")), "ok\n");
}

TEST_F(Status, TellsTheNewestSnapshot) {
  server_->look(snapshot_of(1));
  server_->look(snapshot_of(2));

  const auto json = nlohmann::json::parse(test::body_of(test::get(port_, "/status.json")));

  EXPECT_EQ(json["worker"].size(), 2U);
  EXPECT_THAT(test::get(port_, "/metrics"), HasSubstr("text/plain; version=0.0.4"));
}

TEST_F(Status, ShowsTilesAsTheyArrive) {
  const TileRect rect{32, 16, 32, 16};
  TilePixels pixels;
  pixels.rgb.assign(std::size_t{3} * 32 * 16, 1.0F);
  server_->tile_done(rect, pixels);

  const std::string jpeg = test::body_of(test::get(port_, "/image.jpg"));

  int width = 0;
  int height = 0;
  int channels = 0;
  stbi_uc* const codes =
      stbi_load_from_memory(reinterpret_cast<const stbi_uc*>(jpeg.data()),
                            static_cast<int>(jpeg.size()), &width, &height, &channels, 3);
  ASSERT_NE(codes, nullptr);
  EXPECT_EQ(width, 64);
  EXPECT_EQ(height, 32);
  EXPECT_LT(codes[0], 20);
  EXPECT_GT(codes[(24 * 64 + 48) * 3], 235);
  stbi_image_free(codes);
}

// Whatever the tiles' and the preview's sizes, each pixel of the preview is one of the image.
TEST(Preview, TakesEveryPixelFromItsPlaceInTheImage) {
  constexpr std::uint32_t kWidth = 1601;
  constexpr std::uint32_t kHeight = 97;
  PreviewImage preview(kWidth, kHeight, 0.0);
  PreviewImage whole(kWidth, kHeight, 0.0);
  const auto value = [](std::uint32_t x, std::uint32_t y) {
    return static_cast<float>((x / 40 + y / 20) % 2) * 0.8F;
  };
  const auto assign = [&](PreviewImage& target, const TileRect& rect) {
    TilePixels pixels;
    for (std::uint32_t y = rect.y; y < rect.y + rect.height; ++y) {
      for (std::uint32_t x = rect.x; x < rect.x + rect.width; ++x) {
        pixels.rgb.insert(pixels.rgb.end(), 3, value(x, y));
      }
    }
    target.assign(rect, pixels);
  };
  const TileGrid grid{kWidth, kHeight, 33};
  for (std::uint32_t tile = 0; tile < grid.count(); ++tile) {
    assign(preview, grid.rect(TileId{tile}));
  }
  assign(whole, {0, 0, kWidth, kHeight});

  EXPECT_EQ(preview.width(), PreviewImage::kSideMax);
  EXPECT_EQ(preview.version(), grid.count());
  EXPECT_EQ(*preview.jpeg(), *whole.jpeg());
  EXPECT_EQ(preview.jpeg(), preview.jpeg()) << "encoded again though nothing has changed";
}

TEST(StatusAddress, IsLoopbackUnlessAnyoneMayLook) {
  EXPECT_TRUE(check_status_address("127.0.0.1:8080", false).has_value());
  EXPECT_TRUE(check_status_address("[::1]:0", false).has_value());
  EXPECT_TRUE(check_status_address("0.0.0.0:8080", true).has_value());

  const auto open = check_status_address("0.0.0.0:8080", false);
  ASSERT_FALSE(open.has_value());
  EXPECT_EQ(open.error().code, ExitCode::kUsage);
  EXPECT_THAT(open.error().message, HasSubstr("--insecure-status"));
  for (const char* bad : {"", "8080", "127.0.0.1", "127.0.0.1:99999", "http://127.0.0.1:80"}) {
    EXPECT_FALSE(check_status_address(bad, true).has_value()) << bad;
  }
}

}  // namespace
}  // namespace preheat
