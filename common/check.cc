#include "common/check.h"

#include <spdlog/spdlog.h>

#include <cstdlib>

namespace preheat {

void check_failed(const char* condition, const char* file, int line) {
  spdlog::critical("event=check_failed condition=\"{}\" at={}:{}", condition, file, line);
  spdlog::shutdown();
  std::abort();
}

}  // namespace preheat
