#include "master/file_output.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <string>
#include <system_error>

namespace preheat {
namespace {

tl::unexpected<Error> unwritable(const std::filesystem::path& file, int error_number) {
  return fail(ExitCode::kOutputUnwritable,
              fmt::format("cannot write {}: {}", file.string(),
                          std::generic_category().message(error_number)));
}

// A file of our own beside the target. Unlinked when it goes out of scope, unless renamed before.
class TemporaryFile {
 public:
  explicit TemporaryFile(const std::filesystem::path& target)
      : name_(target.string() + ".XXXXXX"), descriptor_(::mkostemp(name_.data(), O_CLOEXEC)) {}
  ~TemporaryFile() {
    if (descriptor_ < 0) { return; }
    ::close(descriptor_);
    if (!renamed_) { ::unlink(name_.c_str()); }
  }
  TemporaryFile(const TemporaryFile&) = delete;
  TemporaryFile& operator=(const TemporaryFile&) = delete;

  [[nodiscard]] bool is_open() const { return descriptor_ >= 0; }

  // 0 or errno.
  [[nodiscard]] int write(std::string_view bytes) const {
    while (!bytes.empty()) {
      const ssize_t written = ::write(descriptor_, bytes.data(), bytes.size());
      if (written < 0) {
        if (errno == EINTR) { continue; }
        return errno;
      }
      bytes.remove_prefix(static_cast<std::size_t>(written));
    }
    return ::fsync(descriptor_) == 0 || errno == EINVAL ? 0 : errno;
  }

  [[nodiscard]] int rename_to(const std::filesystem::path& target) {
    // mkstemp's 0600 is for secrets; an image is like any other file of this user.
    const mode_t mask = ::umask(0);
    ::umask(mask);
    if (::fchmod(descriptor_, 0666 & ~mask) != 0) { return errno; }
    if (::rename(name_.c_str(), target.c_str()) != 0) { return errno; }
    renamed_ = true;
    return 0;
  }

 private:
  std::string name_;
  int descriptor_;
  bool renamed_ = false;
};

}  // namespace

Result<void> check_output(const std::filesystem::path& file) {
  std::error_code ignored;
  if (file.empty() || std::filesystem::is_directory(file, ignored)) {
    return unwritable(file, EISDIR);
  }
  const TemporaryFile probe(file);
  if (!probe.is_open()) { return unwritable(file, errno); }
  return {};
}

Result<void> write_output(const std::filesystem::path& file, std::string_view bytes) {
  TemporaryFile temporary(file);
  if (!temporary.is_open()) { return unwritable(file, errno); }
  if (const int error = temporary.write(bytes); error != 0) { return unwritable(file, error); }
  if (const int error = temporary.rename_to(file); error != 0) { return unwritable(file, error); }
  return {};
}

}  // namespace preheat
