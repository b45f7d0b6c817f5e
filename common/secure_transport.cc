#include "common/secure_transport.h"

#include <spdlog/spdlog.h>
#include <sys/prctl.h>

#include <utility>

#include "common/zmq_transport.h"

namespace preheat {

Result<SecureTransport> open_transport(const std::string& address, const SecurityOptions& options,
                                       KeyRole role) {
  Result<Endpoint> endpoint = check_endpoint(address, options.reach_settled());
  if (!endpoint) { return tl::unexpected(endpoint.error()); }
  if (options.keys_folder.empty()) {
    if (!is_loopback(*endpoint)) {
      spdlog::warn(
          "event=insecure address={} consequence=\"who reaches it can read the scene and change "
          "the image\"",
          address);
    }
    return SecureTransport{make_zmq_transport(), *std::move(endpoint), nullptr};
  }
  ::prctl(PR_SET_DUMPABLE, 0);
  Result<Keys> keys = load_keys(options.keys_folder, role);
  if (!keys) { return tl::unexpected(keys.error()); }
  if (keys->workers.empty()) {
    spdlog::warn("event=no_worker_listed keys={} consequence=\"nobody can enter\"",
                 options.keys_folder);
  }
  auto allowed = std::make_shared<AllowList>(*keys);
  return SecureTransport{make_zmq_transport(secure_with(*std::move(keys), allowed)),
                         *std::move(endpoint), allowed};
}

std::string describe_security(const std::string& address, const SecurityOptions& options) {
  if (!options.keys_folder.empty()) { return "curve"; }
  const Result<Endpoint> endpoint = parse_endpoint(address);
  return endpoint && is_loopback(*endpoint) ? "none (loopback)" : "none (--insecure-no-auth)";
}

}  // namespace preheat
