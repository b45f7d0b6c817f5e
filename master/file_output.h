// Files that appear whole or not at all: written to a temporary name in the same folder, synced and
// renamed, so that no failure and no signal leaves a torn file or destroys the one before.
#pragma once

#include <filesystem>
#include <string_view>

#include "common/result.h"

namespace preheat {

// Asks beforehand, so that an hour of rendering is not lost to a misspelt folder: an error if
// `file` names a folder or a file cannot be created beside it. Leaves nothing behind.
[[nodiscard]] Result<void> check_output(const std::filesystem::path& file);

[[nodiscard]] Result<void> write_output(const std::filesystem::path& file, std::string_view bytes);

}  // namespace preheat
