// As much of HTTP/1.1 (RFC 9112) as a page that is only looked at needs: GET and HEAD, no bodies
// from the client, one request a connection. Pure.
#pragma once

#include <cstddef>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "common/transport.h"

namespace preheat {

inline constexpr std::size_t kHttpHeadBytesMax = 8 * 1024;

struct HttpRequest {
  bool head_only = false;  // HEAD
  std::string path{};      // without the query
  std::string host{};      // the Host field, empty if there was none (HTTP/1.0)
};

struct HttpResponse {
  int status = 200;
  std::string type = "text/plain; charset=utf-8";
  std::shared_ptr<const std::string> body{};  // nullptr = empty
};

[[nodiscard]] HttpResponse text_response(int status, std::string text);

struct ParsedRequest {
  // Neither: more bytes are needed. Both are never set.
  std::optional<HttpRequest> request{};
  std::optional<HttpResponse> refusal{};
};
// `bytes` are all that have come so far.
[[nodiscard]] ParsedRequest parse_request(std::string_view bytes);

// Head and body on the wire, without the body for HEAD. The page is not to be framed, cached or
// read by other origins, and loads nothing but its own.
[[nodiscard]] std::string response_bytes(const HttpResponse& response, bool head_only);

// A name that resolves to this machine can be anybody's (DNS rebinding), so that a page of theirs
// could read ours; an address cannot, nor can the names that this machine knows itself by.
// `own_name` is one more that is accepted.
[[nodiscard]] bool is_own_host(std::string_view host_field, std::string_view own_name);

}  // namespace preheat
