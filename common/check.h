// CHECK(condition): a bug of ours ends the process with a message, in release builds too.
#pragma once

namespace preheat {

[[noreturn]] void check_failed(const char* condition, const char* file, int line);

}  // namespace preheat

#define CHECK(condition) \
  ((condition) ? static_cast<void>(0) : ::preheat::check_failed(#condition, __FILE__, __LINE__))
