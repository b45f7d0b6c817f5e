#include "master/endpoint_file.h"

#include <unistd.h>

#include <array>
#include <climits>

#include "common/check.h"
#include "master/file_output.h"

namespace preheat {

Endpoint reachable(Endpoint bound, const std::string& machine) {
  if (bound.host == "0.0.0.0" || bound.host == "[::]" || bound.host == "*") {
    bound.host = machine;
  }
  return bound;
}

Result<void> write_endpoint(const std::string& file, const std::string& bound) {
  if (file.empty()) { return {}; }
  std::array<char, HOST_NAME_MAX + 1> machine{};
  CHECK(::gethostname(machine.data(), machine.size()) == 0);
  const Result<Endpoint> endpoint = parse_endpoint(bound);
  if (!endpoint) { return tl::unexpected(endpoint.error()); }
  return write_output(file, reachable(*endpoint, machine.data()).text() + "\n");
}

}  // namespace preheat
