// The transport over ZeroMQ: ROUTER where we listen, DEALER where we connect. The only place that
// knows the library, and where its errors become values.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string_view>

#include "common/keys.h"
#include "common/transport.h"

namespace preheat {

// Keys for every socket of a transport.
struct TransportSecurity {
  Keys keys{};
  // Nothing for a key that may not enter. Asked at each handshake, from a thread of the
  // transport's own, and for each message that arrives: a key that is struck off the list is not
  // heard any more. If it throws or hangs, nobody enters.
  std::function<std::optional<KeyRole>(std::string_view public_key)> admit{};
};

// All that these keys list. The list lives as long as the transport, and may change.
[[nodiscard]] TransportSecurity secure_with(Keys keys, std::shared_ptr<AllowList> allowed);

// Without security every connection is taken as it comes: for loopback, and for those who said so.
[[nodiscard]] std::unique_ptr<Transport> make_zmq_transport(
    std::optional<TransportSecurity> security = std::nullopt);

[[nodiscard]] KeyPair make_key_pair();
// Nothing if the secret is not well formed.
[[nodiscard]] std::optional<PublicKey> public_key_of(const SecretKey& secret);
[[nodiscard]] bool is_key(std::string_view text);

// Eight random bytes from the system.
[[nodiscard]] std::uint64_t random_bits();
[[nodiscard]] SessionId random_session();

}  // namespace preheat
