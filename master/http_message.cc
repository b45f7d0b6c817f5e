#include "master/http_message.h"

#include <arpa/inet.h>
#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <utility>

namespace preheat {
namespace {

const char* reason_of(int status) {
  switch (status) {
    case 200:
      return "OK";
    case 400:
      return "Bad Request";
    case 403:
      return "Forbidden";
    case 404:
      return "Not Found";
    case 405:
      return "Method Not Allowed";
    case 413:
      return "Content Too Large";
    case 431:
      return "Request Header Fields Too Large";
    case 503:
      return "Service Unavailable";
    case 505:
      return "HTTP Version Not Supported";
    default:
      return "Error";
  }
}

std::string lower(std::string_view text) {
  std::string result(text);
  std::transform(result.begin(), result.end(), result.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return result;
}

std::string_view trimmed(std::string_view text) {
  const std::size_t first = text.find_first_not_of(" \t");
  if (first == std::string_view::npos) { return {}; }
  return text.substr(first, text.find_last_not_of(" \t") - first + 1);
}

ParsedRequest refuse(int status, std::string text) {
  return {std::nullopt, text_response(status, std::move(text))};
}

// "GET /path?query HTTP/1.1". True if it was HTTP/1.1.
ParsedRequest parse_request_line(std::string_view line, bool& needs_host) {
  const std::size_t first = line.find(' ');
  const std::size_t second = line.rfind(' ');
  if (first == std::string_view::npos || first == second) {
    return refuse(400, "not an HTTP request\n");
  }
  const std::string_view method = line.substr(0, first);
  const std::string_view target = line.substr(first + 1, second - first - 1);
  const std::string_view version = line.substr(second + 1);
  needs_host = version == "HTTP/1.1";
  if (!needs_host && version != "HTTP/1.0") { return refuse(505, "HTTP/1.1 only\n"); }
  if (method != "GET" && method != "HEAD") {
    return refuse(405, "this page is only looked at: GET and HEAD\n");
  }
  const bool is_path =
      target.starts_with('/') &&
      std::all_of(target.begin(), target.end(), [](char c) { return c > ' ' && c < '\x7f'; });
  if (!is_path) { return refuse(400, "the target must be a path\n"); }
  HttpRequest request;
  request.head_only = method == "HEAD";
  request.path = std::string(target.substr(0, target.find('?')));
  return {std::move(request), std::nullopt};
}

// Empty where there is none; an error text otherwise.
std::string take_field(std::string_view line, HttpRequest& request, std::size_t& hosts) {
  const std::size_t colon = line.find(':');
  if (colon == std::string_view::npos || colon == 0 || line.starts_with(' ') ||
      line.starts_with('\t') || line[colon - 1] == ' ' || line[colon - 1] == '\t') {
    return "a malformed header field\n";
  }
  const std::string name = lower(line.substr(0, colon));
  const std::string_view value = trimmed(line.substr(colon + 1));
  if (name == "host") {
    ++hosts;
    request.host = std::string(value);
  }
  const bool has_body = name == "transfer-encoding" || (name == "content-length" && value != "0");
  return has_body ? "requests have no body here\n" : "";
}

}  // namespace

HttpResponse text_response(int status, std::string text) {
  return {status, "text/plain; charset=utf-8",
          std::make_shared<const std::string>(std::move(text))};
}

ParsedRequest parse_request(std::string_view bytes) {
  const std::size_t end = bytes.find("\r\n\r\n");
  if (std::min(end, bytes.size()) > kHttpHeadBytesMax) {
    return refuse(431, fmt::format("a head has at most {} bytes\n", kHttpHeadBytesMax));
  }
  if (end == std::string_view::npos) { return {}; }
  std::string_view head = bytes.substr(0, end);
  const auto take_line = [&head] {
    const std::size_t length = head.find("\r\n");
    const std::string_view line = head.substr(0, length);
    head.remove_prefix(length == std::string_view::npos ? head.size() : length + 2);
    return line;
  };
  bool needs_host = false;
  ParsedRequest parsed = parse_request_line(take_line(), needs_host);
  if (!parsed.request) { return parsed; }
  std::size_t hosts = 0;
  while (!head.empty()) {
    std::string wrong = take_field(take_line(), *parsed.request, hosts);
    if (!wrong.empty()) { return refuse(400, std::move(wrong)); }
  }
  if (hosts > 1 || (needs_host && hosts == 0)) {
    return refuse(400, "a request has one Host field\n");
  }
  return parsed;
}

std::string response_bytes(const HttpResponse& response, bool head_only) {
  const std::size_t length = response.body ? response.body->size() : 0;
  std::string bytes = fmt::format(
      "HTTP/1.1 {} {}\r\nContent-Type: {}\r\nContent-Length: {}\r\nConnection: close\r\n"
      "Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\n"
      "Cross-Origin-Resource-Policy: same-origin\r\nReferrer-Policy: no-referrer\r\n"
      "Content-Security-Policy: default-src 'none'; img-src 'self'; style-src 'self'; "
      "script-src 'self'; connect-src 'self'; base-uri 'none'; form-action 'none'; "
      "frame-ancestors 'none'\r\n",
      response.status, reason_of(response.status), response.type, length);
  if (response.status == 405) { bytes += "Allow: GET, HEAD\r\n"; }
  bytes += "\r\n";
  if (response.body && !head_only) { bytes += *response.body; }
  return bytes;
}

bool is_own_host(std::string_view host_field, std::string_view own_name) {
  std::string host = lower(host_field);
  if (host.starts_with('[')) {
    const std::size_t end = host.find(']');
    if (end == std::string::npos) { return false; }
    in6_addr address{};
    return ::inet_pton(AF_INET6, host.substr(1, end - 1).c_str(), &address) == 1;
  }
  host = host.substr(0, host.find(':'));
  in_addr address{};
  if (::inet_pton(AF_INET, host.c_str(), &address) == 1) { return true; }
  std::array<char, 256> machine{};
  if (::gethostname(machine.data(), machine.size() - 1) != 0) { machine.front() = '\0'; }
  return !host.empty() &&
         (host == "localhost" || host == lower(own_name) || host == lower(machine.data()));
}

}  // namespace preheat
