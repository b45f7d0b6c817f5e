#include "common/secure_transport.h"

#include <spdlog/spdlog.h>
#include <sys/prctl.h>
#include <sys/resource.h>

#include <utility>

#include "common/zmq_transport.h"

namespace preheat {
namespace {

// A connection takes a descriptor, a stranger's until its handshake has timed out. A thousand
// workers come with two each, and the usual soft limit is 1024.
void raise_descriptor_limit() {
  rlimit limit{};
  if (::getrlimit(RLIMIT_NOFILE, &limit) != 0) { return; }
  limit.rlim_cur = limit.rlim_max;
  static_cast<void>(!::setrlimit(RLIMIT_NOFILE, &limit));  // always allowed
}

}  // namespace

Result<SecureTransport> open_transport(const std::string& address, const SecurityOptions& options,
                                       KeyRole role) {
  Result<Endpoint> endpoint = check_endpoint(address, options.reach_settled());
  if (!endpoint) { return tl::unexpected(endpoint.error()); }
  raise_descriptor_limit();
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
