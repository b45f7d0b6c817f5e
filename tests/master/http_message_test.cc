#include "master/http_message.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <random>

namespace preheat {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

TEST(HttpRequest, IsAPathAndAHost) {
  const ParsedRequest parsed =
      parse_request("GET /image.jpg?7 HTTP/1.1\r\nUser-Agent: x\r\nhOsT:  localhost:8080 \r\n\r\n");

  ASSERT_TRUE(parsed.request.has_value());
  EXPECT_EQ(parsed.request->path, "/image.jpg");
  EXPECT_EQ(parsed.request->host, "localhost:8080");
  EXPECT_FALSE(parsed.request->head_only);
}

TEST(HttpRequest, WaitsForTheWholeHead) {
  const std::string head = "HEAD / HTTP/1.1\r\nHost: a\r\n\r\n";
  for (std::size_t length = 0; length < head.size(); ++length) {
    const ParsedRequest parsed = parse_request(head.substr(0, length));
    EXPECT_FALSE(parsed.request || parsed.refusal) << length;
  }
  EXPECT_TRUE(parse_request(head).request->head_only);
}

struct Refused {
  const char* name;
  std::string bytes;
  int status;
};

class HttpRefusal : public ::testing::TestWithParam<Refused> {};

TEST_P(HttpRefusal, HasItsStatus) {
  const ParsedRequest parsed = parse_request(GetParam().bytes);

  EXPECT_FALSE(parsed.request);
  ASSERT_TRUE(parsed.refusal);
  EXPECT_EQ(parsed.refusal->status, GetParam().status);
}

INSTANTIATE_TEST_SUITE_P(
    All, HttpRefusal,
    ::testing::Values(
        Refused{"post", "POST / HTTP/1.1\r\nHost: a\r\n\r\n", 405},
        Refused{"two_words", "GET /\r\n\r\n", 400}, Refused{"empty", "\r\n\r\n", 400},
        Refused{"version", "GET / HTTP/2.0\r\nHost: a\r\n\r\n", 505},
        Refused{"absolute", "GET http://a/ HTTP/1.1\r\nHost: a\r\n\r\n", 400},
        Refused{"space", "GET /a b HTTP/1.1\r\nHost: a\r\n\r\n", 400},
        Refused{"no_host", "GET / HTTP/1.1\r\n\r\n", 400},
        Refused{"two_hosts", "GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n", 400},
        Refused{"folded", "GET / HTTP/1.1\r\nHost: a\r\n b: c\r\n\r\n", 400},
        Refused{"no_colon", "GET / HTTP/1.1\r\nHost a\r\n\r\n", 400},
        Refused{"body", "GET / HTTP/1.1\r\nHost: a\r\nContent-Length: 5\r\n\r\n", 400},
        Refused{"chunks", "GET / HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: chunked\r\n\r\n", 400},
        Refused{"endless", std::string(kHttpHeadBytesMax + 1, 'a'), 431},
        Refused{"many_fields",
                "GET / HTTP/1.1\r\n" + std::string(kHttpHeadBytesMax, 'a') + "\r\n\r\n", 431}),
    [](const auto& test) { return test.param.name; });

TEST(HttpRequest, AnyBytesAreARequestOrARefusalOrTooFew) {
  constexpr std::uint32_t kSeed = 5;
  SCOPED_TRACE(testing::Message() << "seed " << kSeed);
  std::mt19937 random(kSeed);
  const std::string sound = "GET /status.json HTTP/1.1\r\nHost: localhost\r\nAccept: */*\r\n\r\n";
  int accepted = 0;
  int refused = 0;
  for (int i = 0; i < 20'000; ++i) {
    std::string bytes = sound;
    for (auto change = random() % 3; change-- > 0;) {
      bytes[random() % bytes.size()] = static_cast<char>(random());
    }
    const ParsedRequest parsed = parse_request(bytes);
    EXPECT_FALSE(parsed.request && parsed.refusal);
    accepted += parsed.request ? 1 : 0;
    refused += parsed.refusal ? 1 : 0;
    if (parsed.request) { EXPECT_TRUE(parsed.request->path.starts_with('/')); }
  }
  EXPECT_GT(accepted, 1000);
  EXPECT_GT(refused, 1000);
}

TEST(HttpResponse, SaysItsLengthAndAllowsNothingElse) {
  const std::string bytes = response_bytes(text_response(200, "hello"), false);

  EXPECT_THAT(bytes, HasSubstr("HTTP/1.1 200 OK\r\n"));
  EXPECT_THAT(bytes, HasSubstr("Content-Length: 5\r\n"));
  EXPECT_THAT(bytes, HasSubstr("Connection: close\r\n"));
  EXPECT_THAT(bytes, HasSubstr("Content-Security-Policy: default-src 'none';"));
  EXPECT_THAT(bytes, HasSubstr("X-Content-Type-Options: nosniff\r\n"));
  EXPECT_THAT(bytes, Not(HasSubstr("Access-Control")));
  EXPECT_TRUE(bytes.ends_with("\r\n\r\nhello"));
  EXPECT_TRUE(response_bytes(text_response(200, "hello"), true).ends_with("\r\n\r\n"));
  EXPECT_THAT(response_bytes(text_response(405, ""), false), HasSubstr("Allow: GET, HEAD\r\n"));
}

TEST(HttpHost, IsAnAddressOrAnOwnName) {
  for (const char* own : {"127.0.0.1", "127.0.0.1:8080", "10.1.2.3:80", "[::1]:8080", "localhost",
                          "LOCALHOST:1", "render-master:8080"}) {
    EXPECT_TRUE(is_own_host(own, "render-master")) << own;
  }
  for (const char* other : {"", ":80", "evil.example", "localhost.evil.example:8080",
                            "127.0.0.1.evil.example", "[evil]", "[::1"}) {
    EXPECT_FALSE(is_own_host(other, "render-master")) << other;
  }
}

}  // namespace
}  // namespace preheat
