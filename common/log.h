// Logging for both programs: one event a line on stderr, key=value; stdout stays for results.
#pragma once

#include <string>

namespace preheat {

// Call once in main. PREHEAT_LOG=debug|info|warn|error sets the level; info without it.
void set_up_logging(const std::string& program);

}  // namespace preheat
