// Writes a store: blocks as they are made, then the tables that name them.
//
// The file appears under its name only when finish() has succeeded: until then it has a temporary
// name in the same folder, which the destructor removes. Failures are kOutputUnwritable.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <vector>

#include "common/octree_summary.h"
#include "common/proxy.h"
#include "common/result.h"
#include "common/scene_tables.h"
#include "common/store.h"

namespace preheat {

class StoreWriter {
 public:
  [[nodiscard]] static Result<StoreWriter> create(const std::filesystem::path& file);
  StoreWriter(StoreWriter&& other) noexcept;
  StoreWriter& operator=(StoreWriter&&) = delete;
  ~StoreWriter();

  // Requires: a multiple of 16 bytes. The block's offset in the block section is what was appended
  // before it.
  [[nodiscard]] Result<void> append_block(std::span<const std::byte> block);

  [[nodiscard]] std::uint64_t blocks_bytes() const { return blocks_bytes_; }

  // Writes the rest, syncs file and folder, and gives the file its name. Call once, last.
  [[nodiscard]] Result<void> finish(const StoreInfo& info, const SceneTables& tables,
                                    const std::vector<Camera>& cameras, const Proxy& proxy,
                                    const OctreeSummary& octree_summary);

 private:
  StoreWriter(std::filesystem::path file, std::filesystem::path temporary, int descriptor);
  [[nodiscard]] Result<void> write_at(std::uint64_t offset, std::span<const std::byte> bytes);

  std::filesystem::path file_;
  std::filesystem::path temporary_;  // empty once renamed or moved from
  int descriptor_ = -1;
  std::uint64_t blocks_bytes_ = 0;
};

}  // namespace preheat
