#include "master/scene_file.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <system_error>

namespace preheat {

namespace {

tl::unexpected<Error> rejected(const std::filesystem::path& file, std::string_view why) {
  return fail(ExitCode::kSceneRejected, fmt::format("{}: {}", file.string(), why));
}

std::string system_message(int code) { return std::generic_category().message(code); }

// Closes the descriptor when the mapping is made: a mapping outlives it.
class Descriptor {
 public:
  explicit Descriptor(int value) : value_(value) {}
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  ~Descriptor() {
    if (value_ >= 0) { ::close(value_); }
  }
  [[nodiscard]] int value() const { return value_; }

 private:
  int value_;
};

}  // namespace

Result<MappedFile> MappedFile::open(const std::filesystem::path& file) {
  // O_NONBLOCK: opening a pipe without a writer would wait for one.
  const Descriptor descriptor(::open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
  if (descriptor.value() < 0) { return rejected(file, system_message(errno)); }
  struct stat status {};
  if (::fstat(descriptor.value(), &status) != 0) { return rejected(file, system_message(errno)); }
  if (S_ISDIR(status.st_mode)) { return rejected(file, "is a folder, not a file"); }
  if (!S_ISREG(status.st_mode)) { return rejected(file, "is not a regular file"); }
  const auto size = static_cast<std::size_t>(status.st_size);
  if (size == 0) { return MappedFile({}); }
  void* const address = ::mmap(nullptr, size, PROT_READ, MAP_PRIVATE, descriptor.value(), 0);
  if (address == MAP_FAILED) { return rejected(file, system_message(errno)); }
  return MappedFile({static_cast<const std::byte*>(address), size});
}

MappedFile::~MappedFile() {
  if (!bytes_.empty()) { ::munmap(const_cast<std::byte*>(bytes_.data()), bytes_.size()); }
}

Result<std::string> decode_percent(std::string_view uri) {
  std::string decoded;
  for (std::size_t i = 0; i < uri.size(); ++i) {
    if (uri[i] != '%') {
      decoded.push_back(uri[i]);
      continue;
    }
    unsigned value = 0;
    const std::string_view digits = uri.substr(i + 1, 2);
    const char* const end = digits.data() + digits.size();
    if (digits.size() != 2 || std::from_chars(digits.data(), end, value, 16).ptr != end) {
      return fail(ExitCode::kSceneRejected, fmt::format("'{}' has a malformed % escape", uri));
    }
    decoded.push_back(static_cast<char>(value));
    i += 2;
  }
  return decoded;
}

Result<std::filesystem::path> resolve_below(const std::filesystem::path& scene_file,
                                            std::string_view reference) {
  const auto refused = [&](std::string_view why) {
    return rejected(scene_file, fmt::format("refers to '{}', which {}", reference, why));
  };
  if (reference.empty()) { return rejected(scene_file, "refers to a file without a name"); }
  if (reference.find('\0') != std::string_view::npos) { return refused("holds a NUL character"); }
  if (reference.find('\\') != std::string_view::npos) { return refused("holds a backslash"); }
  if (reference.find(':') != std::string_view::npos) { return refused("is not a relative path"); }
  const std::filesystem::path relative(reference);
  if (relative.is_absolute()) { return refused("is not a relative path"); }
  if (std::find(relative.begin(), relative.end(), "..") != relative.end()) {
    return refused("leaves the scene's folder");
  }
  std::error_code code;
  const auto folder = std::filesystem::weakly_canonical(
      std::filesystem::absolute(scene_file, code).parent_path(), code);
  if (code) { return refused(code.message()); }
  const auto target = std::filesystem::weakly_canonical(folder / relative, code);
  if (code) { return refused(code.message()); }
  const auto [folder_end, ignored] =
      std::mismatch(folder.begin(), folder.end(), target.begin(), target.end());
  if (folder_end != folder.end()) { return refused("leads out of the scene's folder by a link"); }
  return target;
}

}  // namespace preheat
