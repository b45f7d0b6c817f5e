// Which of this machine's addresses the way to another machine begins at.
#pragma once

#include <string>

#include "common/result.h"
#include "common/transport.h"

namespace preheat {

// The host part of an endpoint, an IPv6 address in brackets. Nothing is sent: the system is only
// asked for its route.
[[nodiscard]] Result<std::string> local_address_towards(const Endpoint& remote);

}  // namespace preheat
