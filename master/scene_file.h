// Bytes of the files a scene consists of, and the rule which files those may be.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <utility>

#include "common/result.h"

namespace preheat {

// A regular file, mapped read-only. Pages are read as they are touched, so a large buffer costs no
// memory of ours; a file that another process shortens meanwhile ends the process with SIGBUS.
class MappedFile {
 public:
  // Missing, unreadable, a folder, a device, a pipe: kSceneRejected. An empty file maps to no
  // bytes.
  [[nodiscard]] static Result<MappedFile> open(const std::filesystem::path& file);

  MappedFile(MappedFile&& other) noexcept : bytes_(std::exchange(other.bytes_, {})) {}
  MappedFile& operator=(MappedFile&& other) noexcept {
    std::swap(bytes_, other.bytes_);
    return *this;
  }
  MappedFile(const MappedFile&) = delete;
  MappedFile& operator=(const MappedFile&) = delete;
  ~MappedFile();

  [[nodiscard]] std::span<const std::byte> bytes() const { return bytes_; }
  [[nodiscard]] std::string_view text() const {
    return {reinterpret_cast<const char*>(bytes_.data()), bytes_.size()};
  }

 private:
  explicit MappedFile(std::span<const std::byte> bytes) : bytes_(bytes) {}

  std::span<const std::byte> bytes_;
};

// %41 -> A. Malformed escapes are refused.
[[nodiscard]] Result<std::string> decode_percent(std::string_view uri);

// The path of a file that `scene_file` refers to by `reference`, a relative path with '/'. Refused:
// absolute paths, "..", backslashes, schemes and drive letters, NUL, and symbolic links that lead
// out of the scene's folder. The file need not exist.
[[nodiscard]] Result<std::filesystem::path> resolve_below(const std::filesystem::path& scene_file,
                                                          std::string_view reference);

}  // namespace preheat
