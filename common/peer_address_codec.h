// How a PeerAddress travels, in messages and in the plan of homes.
#pragma once

#include "common/bounded.h"
#include "common/messages.h"

namespace preheat {

template <class Archive>
void serialize(Archive& archive, PeerAddress& peer) {
  archive(enum_up_to(peer.worker, kNoWorker), peer.session,
          at_most(peer.endpoint.text, kEndpointBytesMax));
}

}  // namespace preheat
