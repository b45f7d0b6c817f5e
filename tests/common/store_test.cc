#include "common/store.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <cstring>
#include <random>

#include "common/content_hash.h"
#include "common/scene_tables_codec.h"
#include "common/store_format.h"
#include "common/store_writer.h"
#include "common/voxel_block.h"
#include "tests/scenes/scratch_folder.h"
#include "tests/scenes/soups.h"

namespace preheat {
namespace {

using test::ScratchFolder;
using testing::HasSubstr;

// Two voxels of a few triangles; written without the compiler.
struct Parts {
  Scene scene = test::sheet(4);
  StoreInfo info{.source_file = "sheet.gltf",
                 .source_hash = {.low = 1, .high = 2},
                 .import = {.triangles_declared = 40, .notes = {"textures were left out", ""}},
                 .voxel_size_bytes = 1234,
                 .voxels_internal = 3,
                 .depth_mean = 1.5};
  std::vector<Camera> cameras{{.name = "front", .vertical_fov_rad = 0.5}, {.name = "side"}};
  std::vector<std::vector<std::byte>> blocks{};
  SceneTables tables{};
  Proxy proxy{};
  OctreeSummary summary{};

  Parts() {
    blocks = {encode_voxel_block(scene, std::vector<std::uint32_t>{0, 1, 2, 3, 4}),
              encode_voxel_block(scene, std::vector<std::uint32_t>{5, 6, 30, 31})};
    tables.triangle_count = scene.triangles.size();
    tables.materials = scene.materials;
    const Aabb all{Vec3(-1.0F), Vec3(1.0F)};
    std::uint64_t offset = 0;
    for (const std::vector<std::byte>& block : blocks) {
      tables.voxels.push_back({.bounds = all,
                               .block_offset = offset,
                               .block_bytes = static_cast<std::uint32_t>(block.size()),
                               .triangle_count = 5,
                               .resident_bytes = 2 * block.size(),
                               .hash = content_hash(block)});
      offset += block.size();
    }
    tables.voxel_nodes = {{all, 1, 2}, {all, 0, 0}, {all, 1, 0}};

    const Octree octree = build_octree(scene, {.leaf_references_max = 8});
    std::vector<std::uint32_t> roots;  // any two nodes with triangles
    for (std::uint32_t node = octree.nodes[0].first_child; roots.size() < 2; ++node) {
      if (octree.nodes[node].references_count > 0) { roots.push_back(node); }
    }
    proxy = build_proxy(scene, octree, roots);
    summary = build_octree_summary(scene, octree);
  }
};

Result<void> write(const Parts& parts, const std::filesystem::path& file) {
  Result<StoreWriter> writer = StoreWriter::create(file);
  if (!writer) { return tl::unexpected(writer.error()); }
  for (const std::vector<std::byte>& block : parts.blocks) {
    if (Result<void> written = writer->append_block(block); !written) { return written; }
  }
  return writer->finish(parts.info, parts.tables, parts.cameras, parts.proxy, parts.summary);
}

std::string written_store(const ScratchFolder& folder) {
  CHECK(write(Parts{}, folder / "good.store").has_value());
  return test::read_file(folder / "good.store");
}

StoreHeader header_of(const std::string& content) {
  StoreHeader header;
  std::memcpy(&header, content.data(), sizeof(header));
  return header;
}

// The content under a header that has been changed and signed again.
template <class Change>
std::string with_header(std::string content, Change&& change) {
  StoreHeader header = header_of(content);
  change(header);
  header.hash =
      content_hash(std::as_bytes(std::span(&header, 1)).first(offsetof(StoreHeader, hash)));
  std::memcpy(content.data(), &header, sizeof(header));
  return content;
}

Error error_of(const ScratchFolder& folder, const std::string& content) {
  const std::filesystem::path file = folder / "bad.store";
  test::write_file(file, content);
  const Result<Store> store = Store::open(file);
  if (store) { return {ExitCode::kDone, "it opened"}; }
  EXPECT_THAT(store.error().message, HasSubstr(file.string()));
  return store.error();
}

TEST(Store, GivesBackWhatWasWritten) {
  const ScratchFolder folder;
  const Parts parts;
  ASSERT_TRUE(write(parts, folder / "a.store"));

  const Result<Store> store = Store::open(folder / "a.store");

  ASSERT_TRUE(store) << store.error().message;
  EXPECT_EQ(encode(store->info()), encode(parts.info));
  EXPECT_EQ(encode_scene_tables(store->tables()), encode_scene_tables(parts.tables));
  EXPECT_EQ(encode_proxy(store->proxy()), encode_proxy(parts.proxy));
  EXPECT_EQ(encode_octree_summary(store->octree_summary()), encode_octree_summary(parts.summary));
  ASSERT_EQ(store->cameras().size(), 2U);
  EXPECT_EQ(store->cameras()[0].name, "front");
  EXPECT_EQ(store->cameras()[0].vertical_fov_rad, 0.5);
  EXPECT_EQ(store->info().import.notes, parts.info.import.notes);
  for (const unsigned voxel : {0U, 1U}) {
    const std::span<const std::byte> block = store->block(VoxelId{voxel});
    EXPECT_TRUE(std::equal(block.begin(), block.end(), parts.blocks[voxel].begin(),
                           parts.blocks[voxel].end()));
    EXPECT_TRUE(store->block_is_intact(VoxelId{voxel}));
    EXPECT_TRUE(view_voxel_block(block, 1)) << "also checks the alignment";
  }
  const std::span<const std::byte> sent = store->tables_bytes();
  EXPECT_EQ(store->scene_hash(), content_hash(sent));
  EXPECT_TRUE(decode_scene_tables(sent));
  EXPECT_EQ(store->file_bytes(), std::filesystem::file_size(folder / "a.store"));
}

TEST(Store, OutlivesTheNameOfItsFile) {
  const ScratchFolder folder;
  ASSERT_TRUE(write(Parts{}, folder / "a.store"));
  const Result<Store> store = Store::open(folder / "a.store");
  ASSERT_TRUE(store);
  const Store copy = *store;
  std::filesystem::remove(folder / "a.store");

  EXPECT_TRUE(copy.block_is_intact(VoxelId{1}));
}

TEST(Store, TruncatedAnywhereIsRefused) {
  const ScratchFolder folder;
  const std::string content = written_store(folder);
  for (std::size_t length = 0; length < content.size(); length += length < 300 ? 1 : 97) {
    const Error error = error_of(folder, content.substr(0, length));
    EXPECT_EQ(error.code, ExitCode::kStoreDamaged) << length;
    EXPECT_THAT(error.message, HasSubstr("truncated")) << length;
  }
  EXPECT_EQ(error_of(folder, content.substr(0, content.size() - 1)).code, ExitCode::kStoreDamaged);
}

TEST(Store, TooLongIsRefused) {
  const ScratchFolder folder;
  const std::string content = written_store(folder);
  EXPECT_THAT(error_of(folder, content + '\0').message, HasSubstr("too long"));
  EXPECT_THAT(error_of(folder, content + content).message, HasSubstr("too long"));
}

// Every bit of the header and of every section but the blocks.
TEST(Store, ABitFlippedInTheTablesIsFound) {
  const ScratchFolder folder;
  const std::string content = written_store(folder);
  const StoreHeader header = header_of(content);
  const auto covered = [&](std::size_t at) {
    if (at < sizeof(StoreHeader)) { return true; }
    for (std::size_t i = 1; i < kStoreSectionCount; ++i) {
      const StorePlace& place = header.sections[i];
      if (at >= place.offset && at < place.offset + place.bytes) { return true; }
    }
    return false;
  };
  std::size_t flips = 0;
  for (std::size_t at = 0; at < content.size(); ++at) {
    if (!covered(at)) { continue; }
    std::string flipped = content;
    flipped[at] = static_cast<char>(flipped[at] ^ (1 << at % 8));
    EXPECT_EQ(error_of(folder, flipped).code, ExitCode::kStoreDamaged) << "byte " << at;
    ++flips;
  }
  EXPECT_GT(flips, 700U);
}

// Opening reads no block; its hash finds the flip.
TEST(Store, ABitFlippedInABlockIsFoundByTheBlocksHash) {
  constexpr unsigned kSeed = 17;
  SCOPED_TRACE(kSeed);
  const ScratchFolder folder;
  const std::string content = written_store(folder);
  std::mt19937 random(kSeed);
  for (int repeat = 0; repeat < 200; ++repeat) {
    const std::size_t at = kStoreBlocksOffset + random() % header_of(content).sections[0].bytes;
    std::string flipped = content;
    flipped[at] = static_cast<char>(flipped[at] ^ (1 << random() % 8));
    test::write_file(folder / "flipped.store", flipped);

    const Result<Store> store = Store::open(folder / "flipped.store");

    ASSERT_TRUE(store) << store.error().message;
    const unsigned hit = at - kStoreBlocksOffset < store->tables().voxels[1].block_offset ? 0 : 1;
    EXPECT_FALSE(store->block_is_intact(VoxelId{hit}));
    EXPECT_TRUE(store->block_is_intact(VoxelId{1 - hit}));
  }
}

TEST(Store, MissingOrNoFileIsRefused) {
  const ScratchFolder folder;
  ASSERT_EQ(::mkfifo((folder / "pipe.store").c_str(), 0600), 0);
  for (const char* name : {"missing.store", "pipe.store", "."}) {
    const Result<Store> store = Store::open(folder / name);
    ASSERT_FALSE(store) << name;
    EXPECT_EQ(store.error().code, ExitCode::kStoreDamaged);
    EXPECT_THAT(store.error().message, HasSubstr(name));
  }
}

TEST(Store, OfAnotherKindOrVersionIsRefusedByName) {
  const ScratchFolder folder;
  const std::string content = written_store(folder);
  EXPECT_THAT(error_of(folder, std::string(5000, 'x')).message, HasSubstr("magic at offset 0"));
  const std::string newer =
      with_header(content, [](StoreHeader& header) { header.version = kStoreVersion + 1; });
  EXPECT_THAT(error_of(folder, newer).message,
              HasSubstr("version " + std::to_string(kStoreVersion + 1) + " at offset 8"));
}

// A header that is whole in itself but lies about its sections.
TEST(Store, SectionsOutOfPlaceAreRefused) {
  const ScratchFolder folder;
  const std::string content = written_store(folder);
  ASSERT_EQ(with_header(content, [](StoreHeader&) {}), content);
  for (std::size_t section = 0; section < kStoreSectionCount; ++section) {
    for (const std::uint64_t change :
         {std::uint64_t{1}, std::uint64_t{16}, ~std::uint64_t{15}, std::uint64_t{1} << 63U}) {
      EXPECT_EQ(error_of(folder, with_header(content,
                                             [&](StoreHeader& header) {
                                               header.sections[section].offset += change;
                                             }))
                    .code,
                ExitCode::kStoreDamaged);
      EXPECT_EQ(error_of(folder, with_header(content,
                                             [&](StoreHeader& header) {
                                               header.sections[section].bytes += change;
                                             }))
                    .code,
                ExitCode::kStoreDamaged);
    }
  }
}

TEST(Store, VoxelsBehindTheBlocksAreRefused) {
  const ScratchFolder folder;
  Parts parts;
  parts.tables.voxels[1].block_bytes += 16;
  parts.tables.voxels[1].resident_bytes += 16;
  ASSERT_TRUE(write(parts, folder / "a.store"));
  const Result<Store> store = Store::open(folder / "a.store");
  ASSERT_FALSE(store);
  EXPECT_THAT(store.error().message, HasSubstr("voxel 1 ends at"));
}

TEST(StoreWriter, LeavesNothingBehindUnlessItFinishes) {
  const ScratchFolder folder;
  test::write_file(folder / "a.store", "what was there before");
  {
    Result<StoreWriter> writer = StoreWriter::create(folder / "a.store");
    ASSERT_TRUE(writer);
    ASSERT_TRUE(writer->append_block(Parts{}.blocks[0]));
    EXPECT_EQ(folder.file_count(), 2U);
  }
  EXPECT_EQ(folder.file_count(), 1U);
  EXPECT_EQ(test::read_file(folder / "a.store"), "what was there before");

  ASSERT_TRUE(write(Parts{}, folder / "a.store"));
  EXPECT_EQ(folder.file_count(), 1U);
  EXPECT_TRUE(Store::open(folder / "a.store"));
}

TEST(StoreWriter, SaysWhyItCannotWrite) {
  const ScratchFolder folder;
  for (const char* name : {"no/such/folder/a.store", "."}) {
    const Result<StoreWriter> writer = StoreWriter::create(folder / name);
    ASSERT_FALSE(writer) << name;
    EXPECT_EQ(writer.error().code, ExitCode::kOutputUnwritable);
    EXPECT_THAT(writer.error().message, HasSubstr(name));
  }
}

TEST(StoreWriter, SaysThatTheDeviceIsFull) {
  Result<StoreWriter> writer = StoreWriter::create("/dev/full/a.store");
  ASSERT_FALSE(writer);
  EXPECT_EQ(writer.error().code, ExitCode::kOutputUnwritable);
}

}  // namespace
}  // namespace preheat
