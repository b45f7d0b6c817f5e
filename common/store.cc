#include "common/store.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "common/check.h"
#include "common/content_hash.h"
#include "common/store_format.h"

namespace preheat {
namespace {

// A file mapped for reading. The mapping outlives the descriptor.
class Mapping {
 public:
  Mapping(void* address, std::size_t bytes) : address_(address), bytes_(bytes) {}
  Mapping(const Mapping&) = delete;
  Mapping& operator=(const Mapping&) = delete;
  ~Mapping() {
    if (address_ != nullptr) { ::munmap(address_, bytes_); }
  }
  [[nodiscard]] std::span<const std::byte> bytes() const {
    return {static_cast<const std::byte*>(address_), bytes_};
  }

 private:
  void* address_;
  std::size_t bytes_;
};

[[nodiscard]] tl::unexpected<Error> damaged(const std::filesystem::path& file,
                                            const std::string& what) {
  return fail(ExitCode::kStoreDamaged, fmt::format("store {}: {}", file.string(), what));
}

[[nodiscard]] Result<std::unique_ptr<Mapping>> map_file(const std::filesystem::path& file) {
  // O_NONBLOCK: a pipe by that name must not make us wait for a writer.
  const int descriptor = ::open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  if (descriptor < 0) { return damaged(file, std::strerror(errno)); }
  struct stat status {};
  if (::fstat(descriptor, &status) != 0 || !S_ISREG(status.st_mode)) {
    ::close(descriptor);
    return damaged(file, "not a file");
  }
  const auto size = static_cast<std::size_t>(status.st_size);
  if (size < sizeof(StoreHeader)) {
    ::close(descriptor);
    return damaged(file, fmt::format("truncated: {} bytes, the header alone has {}", size,
                                     sizeof(StoreHeader)));
  }
  void* address = ::mmap(nullptr, size, PROT_READ, MAP_SHARED, descriptor, 0);
  const int error = errno;
  ::close(descriptor);
  if (address == MAP_FAILED) { return damaged(file, std::strerror(error)); }
  return std::make_unique<Mapping>(address, size);
}

// Magic and version come first, so that another version's header may differ in all the rest.
[[nodiscard]] Result<StoreHeader> check_header(const std::filesystem::path& file,
                                               std::span<const std::byte> bytes) {
  StoreHeader header;
  std::memcpy(&header, bytes.data(), sizeof(header));
  if (header.magic != kStoreMagic) { return damaged(file, "no preheat store: magic at offset 0"); }
  if (header.version != kStoreVersion) {
    return damaged(
        file, fmt::format("version {} at offset {}, this program reads version {}", header.version,
                          offsetof(StoreHeader, version), kStoreVersion));
  }
  if (header.hash != content_hash(bytes.first(offsetof(StoreHeader, hash)))) {
    return damaged(file, fmt::format("header damaged: hash at offset {} does not match",
                                     offsetof(StoreHeader, hash)));
  }
  if (header.file_bytes != bytes.size()) {
    return damaged(file, fmt::format("{}: {} bytes where the header says {}",
                                     bytes.size() < header.file_bytes ? "truncated" : "too long",
                                     bytes.size(), header.file_bytes));
  }
  std::uint64_t end = kStoreBlocksOffset;
  for (std::size_t i = 0; i < kStoreSectionCount; ++i) {
    const StorePlace& place = header.sections[i];
    if (place.offset != next_section_offset(end) || place.offset > header.file_bytes ||
        place.bytes > header.file_bytes - place.offset) {
      return damaged(file, fmt::format("section {} misplaced: {} bytes at offset {}",
                                       kStoreSectionNames[i], place.bytes, place.offset));
    }
    end = place.offset + place.bytes;
  }
  if (header.section_count != kStoreSectionCount || end != header.file_bytes) {
    return damaged(file, fmt::format("sections end at offset {} of {}", end, header.file_bytes));
  }
  return header;
}

}  // namespace

struct Store::Content {
  std::unique_ptr<Mapping> mapping{};
  StoreHeader header{};
  StoreInfo info{};
  SceneTables tables{};
  std::vector<Camera> cameras{};
  Proxy proxy{};
  OctreeSummary octree_summary{};

  [[nodiscard]] const StorePlace& place(StoreSection section) const {
    return header.sections[static_cast<std::size_t>(section)];
  }
  [[nodiscard]] std::span<const std::byte> section(StoreSection section) const {
    return mapping->bytes().subspan(place(section).offset, place(section).bytes);
  }

  // Checks a section's hash and takes what `decode` makes of it.
  template <class T, class Decode>
  [[nodiscard]] Result<void> read(const std::filesystem::path& file, StoreSection which, T& into,
                                  Decode&& decode) const {
    const std::string where =
        fmt::format("section {} at offset {}", kStoreSectionNames[static_cast<std::size_t>(which)],
                    place(which).offset);
    if (content_hash(section(which)) != place(which).hash) {
      return damaged(file, where + " damaged: its hash does not match");
    }
    Result<T> value = decode(section(which));
    if (!value) { return damaged(file, where + ": " + value.error().message); }
    into = *std::move(value);
    return {};
  }
};

Result<Store> Store::open(const std::filesystem::path& file) {
  Result<std::unique_ptr<Mapping>> mapping = map_file(file);
  if (!mapping) { return tl::unexpected(mapping.error()); }
  auto content = std::make_shared<Content>();
  content->mapping = *std::move(mapping);
  const Result<StoreHeader> header = check_header(file, content->mapping->bytes());
  if (!header) { return tl::unexpected(header.error()); }
  content->header = *header;

  Result<void> read = content->read(file, StoreSection::kInfo, content->info, [](auto bytes) {
    return decode<StoreInfo>(bytes, "facts", ExitCode::kStoreDamaged);
  });
  if (!read) { return tl::unexpected(read.error()); }
  read = content->read(file, StoreSection::kTables, content->tables, decode_scene_tables);
  if (!read) { return tl::unexpected(read.error()); }
  CameraSection cameras;
  read = content->read(file, StoreSection::kCameras, cameras, [](auto bytes) {
    return decode<CameraSection>(bytes, "cameras", ExitCode::kStoreDamaged);
  });
  if (!read) { return tl::unexpected(read.error()); }
  content->cameras = std::move(cameras.cameras);
  read = content->read(file, StoreSection::kProxy, content->proxy, [&](auto bytes) {
    return decode_proxy(bytes, content->tables.voxels.size());
  });
  if (!read) { return tl::unexpected(read.error()); }
  read = content->read(file, StoreSection::kOctree, content->octree_summary, decode_octree_summary);
  if (!read) { return tl::unexpected(read.error()); }

  const std::uint64_t blocks_bytes = content->place(StoreSection::kBlocks).bytes;
  if (!content->tables.voxels.empty()) {  // blocks do not overlap, so the last one ends last
    const VoxelEntry& last = content->tables.voxels.back();
    if (last.block_offset + last.block_bytes > blocks_bytes) {
      return damaged(file, fmt::format("voxel {} ends at {} of {} bytes of blocks",
                                       content->tables.voxels.size() - 1,
                                       last.block_offset + last.block_bytes, blocks_bytes));
    }
  }
  Store store;
  store.content_ = std::move(content);
  return store;
}

const SceneTables& Store::tables() const { return content_->tables; }
const std::vector<Camera>& Store::cameras() const { return content_->cameras; }
const Proxy& Store::proxy() const { return content_->proxy; }
const OctreeSummary& Store::octree_summary() const { return content_->octree_summary; }
const StoreInfo& Store::info() const { return content_->info; }

std::span<const std::byte> Store::tables_bytes() const {
  return content_->section(StoreSection::kTables);
}

std::span<const std::byte> Store::block(VoxelId voxel) const {
  CHECK(index_of(voxel) < content_->tables.voxels.size());
  const VoxelEntry& entry = content_->tables.voxels[index_of(voxel)];
  return content_->section(StoreSection::kBlocks).subspan(entry.block_offset, entry.block_bytes);
}

bool Store::block_is_intact(VoxelId voxel) const {
  return content_hash(block(voxel)) == content_->tables.voxels[index_of(voxel)].hash;
}

std::uint64_t Store::proxy_bytes() const { return content_->place(StoreSection::kProxy).bytes; }
std::uint64_t Store::file_bytes() const { return content_->header.file_bytes; }

std::vector<std::pair<std::string, std::uint64_t>> Store::section_bytes() const {
  std::vector<std::pair<std::string, std::uint64_t>> sections{{"header", sizeof(StoreHeader)}};
  for (std::size_t i = 0; i < kStoreSectionCount; ++i) {
    sections.emplace_back(kStoreSectionNames[i], content_->header.sections[i].bytes);
  }
  return sections;
}

Hash128 Store::scene_hash() const { return content_->place(StoreSection::kTables).hash; }

}  // namespace preheat
