#include "master/options.h"

#include <gtest/gtest.h>

#include <CLI/CLI.hpp>

namespace preheat {
namespace {

constexpr std::uint64_t kMiB = 1U << 20U;

TEST(ParseBytes, TakesPlainNumbersAndBinaryUnits) {
  EXPECT_EQ(parse_bytes("4096").value(), 4096U);
  EXPECT_EQ(parse_bytes("64KiB").value(), 65536U);
  EXPECT_EQ(parse_bytes("1.5MiB").value(), kMiB * 3 / 2);
  EXPECT_EQ(parse_bytes("2GiB").value(), 2048 * kMiB);
}

TEST(ParseBytes, RefusesWhatIsNoSizeAndNamesIt) {
  for (const char* text :
       {"", "x", "-1", "0", "12MB", "1e400", "nan", "inf", "5 KiB", "KiB", "0.5"}) {
    const auto bytes = parse_bytes(text);
    ASSERT_FALSE(bytes.has_value()) << text;
    EXPECT_EQ(bytes.error().code, ExitCode::kUsage);
    EXPECT_NE(bytes.error().message.find("'" + std::string(text) + "'"), std::string::npos);
  }
}

TEST(ParseCacheSize, TakesSharesAndBytes) {
  EXPECT_DOUBLE_EQ(parse_cache_size("25%").value().share, 0.25);
  EXPECT_EQ(parse_cache_size("25%").value().bytes, 0U);
  EXPECT_DOUBLE_EQ(parse_cache_size("100%").value().share, 1.0);
  EXPECT_EQ(parse_cache_size("3MiB").value().bytes, 3 * kMiB);
}

TEST(ParseCacheSize, RefusesSharesOutsideZeroToAHundred) {
  for (const char* text : {"0%", "-5%", "101%", "%", "x%"}) {
    EXPECT_FALSE(parse_cache_size(text).has_value()) << text;
  }
}

TEST(ParseImageSize, TakesWidthAndHeight) {
  const auto size = parse_image_size("640x480");
  ASSERT_TRUE(size.has_value());
  EXPECT_EQ(size->width, 640U);
  EXPECT_EQ(size->height, 480U);
  EXPECT_TRUE(parse_image_size("65536x32768").has_value());  // 2^31 pixels
}

TEST(ParseImageSize, RefusesOtherShapesAndSizesBeyondTheLimits) {
  for (const char* text : {"", "640", "x", "640x", "x480", "640x480x3", "0x5", "5x0", "-1x5",
                           "65537x1", "1x65537", "65536x32769", "640*480", "6.5x5"}) {
    EXPECT_FALSE(parse_image_size(text).has_value()) << text;
  }
}

TEST(ParseVector, TakesThreeFiniteNumbers) {
  EXPECT_EQ(parse_vector("1,-2.5,3e2").value(), Vec3d(1.0, -2.5, 300.0));
  for (const char* text : {"", "1,2", "1,2,3,4", "1,,3", "1,2,inf", "nan,0,0", "1;2;3", "1,2,3x"}) {
    EXPECT_FALSE(parse_vector(text).has_value()) << text;
  }
}

TEST(ParseRadiance, RefusesNegativeAndOverflowingValues) {
  EXPECT_EQ(parse_radiance("0,0.5,1").value(), Vec3(0.0F, 0.5F, 1.0F));
  EXPECT_FALSE(parse_radiance("0,-1,0").has_value());
  EXPECT_FALSE(parse_radiance("1e60,0,0").has_value());
}

TEST(ParsePreloadShare, TakesAutoAndSharesOfOne) {
  EXPECT_LT(parse_preload_share("auto").value(), 0.0);
  EXPECT_DOUBLE_EQ(parse_preload_share("0.75").value(), 0.75);
  EXPECT_FALSE(parse_preload_share("1.01").has_value());
  EXPECT_FALSE(parse_preload_share("-0.1").has_value());
}

TEST(ParseAddress, WantsTcpHostAndPort) {
  EXPECT_EQ(parse_address("tcp://127.0.0.1:5555").value(), "tcp://127.0.0.1:5555");
  EXPECT_TRUE(parse_address("tcp://[::1]:5555").has_value());
  EXPECT_TRUE(parse_address("tcp://127.0.0.1:*").has_value());
  for (const char* text : {"", "127.0.0.1:5555", "tcp://:5555", "tcp://host", "tcp://host:",
                           "tcp://host:65536", "tcp://host:x", "udp://host:1", "ipc:///tmp/x"}) {
    EXPECT_FALSE(parse_address(text).has_value()) << text;
  }
}

// The view options as a user's words.
ViewOptions parse_view(const std::vector<std::string>& words) {
  CLI::App app;
  ViewOptions view;
  add_view_options(app, view);
  app.parse(std::vector<std::string>(words.rbegin(), words.rend()));
  return view;
}

TEST(ViewOptions, DefaultsAreThoseOfTheManual) {
  const ViewOptions view = parse_view({});

  EXPECT_EQ(view.size.width, 512U);
  EXPECT_EQ(view.size.height, 512U);
  EXPECT_EQ(view.spp, 16U);
  EXPECT_EQ(view.bounces, 4U);
  EXPECT_EQ(view.seed, 0U);
  EXPECT_FALSE(view.camera || view.eye || view.look_at || view.up || view.fov_deg || view.sky);
}

TEST(ViewOptions, TakeVectorsThatBeginWithAMinusSign) {
  const ViewOptions view =
      parse_view({"--eye", "-1,2,3", "--look-at", "-.5,0,0", "--sky", "0,0,1"});

  EXPECT_EQ(view.eye.value(), Vec3d(-1.0, 2.0, 3.0));
  EXPECT_EQ(view.look_at.value(), Vec3d(-0.5, 0.0, 0.0));
  EXPECT_EQ(view.sky.value(), Vec3(0.0F, 0.0F, 1.0F));
}

TEST(ViewOptions, TheLastOfSeveralWins) {
  const ViewOptions view =
      parse_view({"--spp", "64", "--size", "8x8", "--spp", "4", "--size", "9x7"});

  EXPECT_EQ(view.spp, 4U);
  EXPECT_EQ(view.size.width, 9U);
}

TEST(ViewOptions, RefuseWhatIsOutOfRange) {
  for (const auto& words : std::vector<std::vector<std::string>>{{"--spp", "0"},
                                                                 {"--spp", "1048577"},
                                                                 {"--bounces", "65"},
                                                                 {"--bounces", "-1"},
                                                                 {"--size", "0x1"},
                                                                 {"--fov", "0"},
                                                                 {"--fov", "180"},
                                                                 {"--seed", "-1"},
                                                                 {"--eye", "1,2"}}) {
    EXPECT_THROW(parse_view(words), CLI::ParseError) << words[0] << ' ' << words[1];
  }
}

}  // namespace
}  // namespace preheat
