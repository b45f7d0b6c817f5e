#include "common/transport.h"

#include <fmt/format.h>

#include <charconv>
#include <string_view>

namespace preheat {

std::string Endpoint::text() const {
  return port == 0 ? fmt::format("tcp://{}:*", host) : fmt::format("tcp://{}:{}", host, port);
}

Result<Endpoint> parse_endpoint(const std::string& text) {
  const auto bad = [&text](const char* why) {
    return fail(ExitCode::kUsage,
                fmt::format("bad address \"{}\": {}; expected tcp://HOST:PORT", text, why));
  };
  constexpr std::string_view kScheme = "tcp://";
  std::string_view rest = text;
  if (!rest.starts_with(kScheme)) { return bad("it does not begin with tcp://"); }
  rest.remove_prefix(kScheme.size());
  const std::size_t colon = rest.rfind(':');
  if (colon == std::string_view::npos) { return bad("no port"); }
  const std::string_view host = rest.substr(0, colon);
  const std::string_view port = rest.substr(colon + 1);
  if (host.empty()) { return bad("no host"); }
  const bool bracketed = host.front() == '[' && host.back() == ']' && host.size() > 2;
  if (!bracketed && host.find(':') != std::string_view::npos) {
    return bad("an IPv6 address needs brackets");
  }
  Endpoint endpoint{std::string(host), 0};
  if (port == "*") { return endpoint; }
  const auto [end, error] = std::from_chars(port.data(), port.data() + port.size(), endpoint.port);
  if (error != std::errc{} || end != port.data() + port.size()) {
    return bad("the port is no number up to 65535");
  }
  return endpoint;
}

bool is_loopback(const Endpoint& endpoint) {
  std::string_view host = endpoint.host;
  if (host == "localhost" || host == "[::1]") { return true; }
  // How an IPv6 socket names an IPv4 address that it is bound to.
  constexpr std::string_view kMapped = "[::ffff:";
  if (host.starts_with(kMapped)) {
    host.remove_prefix(kMapped.size());
    host.remove_suffix(1);
  }
  // 127.0.0.0/8, as digits and dots only: "127.example.org" is a name.
  return host.starts_with("127.") &&
         host.find_first_not_of("0123456789.") == std::string_view::npos;
}

Result<Endpoint> check_endpoint(const std::string& text, bool reach_settled) {
  Result<Endpoint> endpoint = parse_endpoint(text);
  if (endpoint && !reach_settled && !is_loopback(*endpoint)) {
    return fail(ExitCode::kUsage,
                fmt::format("{} is not a loopback address, and without keys connections are "
                            "neither encrypted nor authenticated: give --keys DIR with keys from "
                            "`preheat keygen DIR`, or --insecure-no-auth to do without",
                            text));
  }
  return endpoint;
}

}  // namespace preheat
