// From what the command line says about keys to a transport: the same for master, worker and
// status.
#pragma once

#include <memory>
#include <string>

#include "common/keys.h"
#include "common/result.h"
#include "common/transport.h"

namespace preheat {

struct SecurityOptions {
  std::string keys_folder{};      // of `preheat keygen`; empty = no keys
  bool insecure_no_auth = false;  // addresses other than loopback without keys

  // Addresses other than loopback may be used.
  [[nodiscard]] bool reach_settled() const { return !keys_folder.empty() || insecure_no_auth; }
};

struct SecureTransport {
  std::unique_ptr<Transport> transport{};
  Endpoint endpoint{};
  std::shared_ptr<AllowList> allowed{};  // nullptr without keys
};

// Checks address and keys, and warns of an open door. With keys this process leaves no core dump
// and lets no other process of its user read its memory.
[[nodiscard]] Result<SecureTransport> open_transport(const std::string& address,
                                                     const SecurityOptions& options, KeyRole role);

// For the record: "curve", "none (loopback)" or "none (--insecure-no-auth)".
[[nodiscard]] std::string describe_security(const std::string& address,
                                            const SecurityOptions& options);

}  // namespace preheat
