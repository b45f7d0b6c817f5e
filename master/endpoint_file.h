// Tells workers that are started elsewhere where their master is, through a file that both can
// read: nobody can know beforehand which port the system chooses.
#pragma once

#include <string>

#include "common/result.h"
#include "common/transport.h"

namespace preheat {

// Where others find what listens on `bound`: of an address of all interfaces the host becomes
// `machine`, every other one is as it is.
[[nodiscard]] Endpoint reachable(Endpoint bound, const std::string& machine);

// One line with the address, this machine's name in place of all interfaces. Without a file:
// nothing.
[[nodiscard]] Result<void> write_endpoint(const std::string& file, const std::string& bound);

}  // namespace preheat
