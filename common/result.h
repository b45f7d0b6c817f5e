// What went wrong outside this process, as a value: a frame, a file, a scene, the network.
//
// The code becomes the process's exit code where the error ends the program.
#pragma once

#include <string>
#include <tl/expected.hpp>
#include <utility>

namespace preheat {

enum class ExitCode : int {
  kDone = 0,
  kFailed = 1,
  kUsage = 2,       // bad usage, address or size
  kNoWorkers = 3,   // no workers in time
  kMasterGone = 4,  // master gone or refused
  kStoreDamaged = 5,
  kOutputUnwritable = 6,
  kMismatch = 7,      // version, ISA or scene
  kPoisonedTile = 8,  // finished without a poisoned tile
  kSceneRejected = 9,
  kInterrupted = 130,
  kTerminated = 143,
};

// `message` names the thing, the limit and the value, and stands alone on a line.
struct Error {
  ExitCode code = ExitCode::kFailed;
  std::string message{};
};

template <class T>
using Result = tl::expected<T, Error>;

[[nodiscard]] inline tl::unexpected<Error> fail(ExitCode code, std::string message) {
  return tl::unexpected<Error>(Error{code, std::move(message)});
}

}  // namespace preheat
