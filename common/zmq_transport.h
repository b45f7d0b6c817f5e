// The transport over ZeroMQ: ROUTER where we listen, DEALER where we connect. The only place that
// knows the library, and where its errors become values.
#pragma once

#include <memory>

#include "common/transport.h"

namespace preheat {

[[nodiscard]] std::unique_ptr<Transport> make_zmq_transport();

// Eight random bytes from the system.
[[nodiscard]] std::uint64_t random_bits();
[[nodiscard]] SessionId random_session();

}  // namespace preheat
