// What a protocol state machine wants sent.
#pragma once

#include "common/messages.h"
#include "common/transport.h"

namespace preheat {

struct Outgoing {
  ChannelKind channel = ChannelKind::kControl;
  SessionId to{};  // at a worker: without meaning
  Message message{};
  Payload data{};
};

}  // namespace preheat
