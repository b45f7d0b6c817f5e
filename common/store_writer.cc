#include "common/store_writer.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <utility>

#include "common/check.h"
#include "common/content_hash.h"
#include "common/store_format.h"

namespace preheat {
namespace {

constexpr int kTemporaryNamesMax = 100;

[[nodiscard]] tl::unexpected<Error> unwritable(const std::filesystem::path& file, const char* what,
                                               int error) {
  return fail(ExitCode::kOutputUnwritable,
              fmt::format("store {}: cannot {}: {}", file.string(), what, std::strerror(error)));
}

}  // namespace

Result<StoreWriter> StoreWriter::create(const std::filesystem::path& file) {
  if (std::error_code ignored; std::filesystem::is_directory(file, ignored)) {
    return unwritable(file, "write", EISDIR);
  }
  int error = EEXIST;
  for (int attempt = 0; attempt < kTemporaryNamesMax && error == EEXIST; ++attempt) {
    std::filesystem::path temporary = file;
    temporary += fmt::format(".{}.{}.tmp", ::getpid(), attempt);
    const int descriptor = ::open(temporary.c_str(), O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    if (descriptor >= 0) { return StoreWriter(file, std::move(temporary), descriptor); }
    error = errno;
  }
  return unwritable(file, "create a file beside it", error);
}

StoreWriter::StoreWriter(std::filesystem::path file, std::filesystem::path temporary,
                         int descriptor)
    : file_(std::move(file)), temporary_(std::move(temporary)), descriptor_(descriptor) {}

StoreWriter::StoreWriter(StoreWriter&& other) noexcept
    : file_(std::move(other.file_)),
      temporary_(std::exchange(other.temporary_, {})),
      descriptor_(std::exchange(other.descriptor_, -1)),
      blocks_bytes_(other.blocks_bytes_) {}

StoreWriter::~StoreWriter() {
  if (descriptor_ >= 0) { ::close(descriptor_); }
  if (!temporary_.empty()) { ::unlink(temporary_.c_str()); }
}

Result<void> StoreWriter::write_at(std::uint64_t offset, std::span<const std::byte> bytes) {
  while (!bytes.empty()) {
    const ssize_t written =
        ::pwrite(descriptor_, bytes.data(), bytes.size(), static_cast<off_t>(offset));
    if (written < 0 && errno == EINTR) { continue; }
    if (written <= 0) { return unwritable(file_, "write", written == 0 ? ENOSPC : errno); }
    bytes = bytes.subspan(static_cast<std::size_t>(written));
    offset += static_cast<std::uint64_t>(written);
  }
  return {};
}

Result<void> StoreWriter::append_block(std::span<const std::byte> block) {
  CHECK(block.size() % kStoreSectionAlignment == 0);
  Result<void> written = write_at(kStoreBlocksOffset + blocks_bytes_, block);
  blocks_bytes_ += block.size();
  return written;
}

Result<void> StoreWriter::finish(const StoreInfo& info, const SceneTables& tables,
                                 const std::vector<Camera>& cameras, const Proxy& proxy,
                                 const OctreeSummary& octree_summary) {
  StoreHeader header;
  header.sections[0] = {.offset = kStoreBlocksOffset, .bytes = blocks_bytes_};
  std::uint64_t end = kStoreBlocksOffset + blocks_bytes_;
  const std::array<std::vector<std::byte>, kStoreSectionCount> contents{
      {{},
       encode(info),
       encode_scene_tables(tables),
       encode(CameraSection{cameras}),
       encode_proxy(proxy),
       encode_octree_summary(octree_summary)}};
  for (std::size_t section = 1; section < kStoreSectionCount; ++section) {
    const std::vector<std::byte>& content = contents[section];
    const std::uint64_t offset = next_section_offset(end);
    header.sections[section] = {offset, content.size(), content_hash(content)};
    if (Result<void> written = write_at(offset, content); !written) { return written; }
    end = offset + content.size();
  }
  header.file_bytes = end;
  if (::ftruncate(descriptor_, static_cast<off_t>(end)) != 0) {  // an empty last section
    return unwritable(file_, "write", errno);
  }
  const std::span<const std::byte> bytes = std::as_bytes(std::span(&header, 1));
  header.hash = content_hash(bytes.first(offsetof(StoreHeader, hash)));
  if (Result<void> written = write_at(0, bytes); !written) { return written; }

  if (::fsync(descriptor_) != 0) { return unwritable(file_, "sync", errno); }
  if (::rename(temporary_.c_str(), file_.c_str()) != 0) {
    return unwritable(file_, "rename", errno);
  }
  temporary_.clear();
  const std::filesystem::path folder = file_.has_parent_path() ? file_.parent_path() : ".";
  const int folder_descriptor = ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (folder_descriptor < 0) { return unwritable(file_, "open its folder", errno); }
  const int synced = ::fsync(folder_descriptor);
  const int error = errno;
  ::close(folder_descriptor);
  // Some file systems cannot sync a folder; the store itself is on the disk.
  if (synced != 0 && error != EINVAL) { return unwritable(file_, "sync its folder", error); }
  return {};
}

}  // namespace preheat
