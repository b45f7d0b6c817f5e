#include "worker/block_shelf.h"

#include <gtest/gtest.h>

#include <random>
#include <vector>

namespace preheat {
namespace {

// A random number less than `count`.
std::uint32_t below(std::mt19937& random, std::uint32_t count) {
  return static_cast<std::uint32_t>(random() % count);
}

Payload block(std::size_t bytes) {
  auto owner = std::make_shared<std::vector<std::byte>>(bytes);
  return {*owner, owner};
}

TEST(BlockShelf, LetsGoOfWhatWasAskedForLongestAgo) {
  BlockShelf shelf;
  shelf.set_budget(100);
  shelf.put(VoxelId{0}, block(40));
  shelf.put(VoxelId{1}, block(40));
  ASSERT_TRUE(shelf.find(VoxelId{0}).has_value());

  shelf.put(VoxelId{2}, block(40));

  EXPECT_TRUE(shelf.find(VoxelId{0}).has_value());
  EXPECT_FALSE(shelf.find(VoxelId{1}).has_value());
  EXPECT_TRUE(shelf.find(VoxelId{2}).has_value());
}

TEST(BlockShelf, FindsWhatWasLentWhileSomebodyHasIt) {
  BlockShelf shelf;
  Payload lent = block(1000);
  shelf.lend(VoxelId{3}, lent);
  ASSERT_TRUE(shelf.find(VoxelId{3}).has_value());
  EXPECT_EQ(shelf.find(VoxelId{3})->bytes.data(), lent.bytes.data());

  lent = {};

  EXPECT_FALSE(shelf.find(VoxelId{3}).has_value());
}

TEST(BlockShelf, KeepsNothingLargerThanItsBudget) {
  BlockShelf shelf;
  shelf.set_budget(100);
  shelf.put(VoxelId{0}, block(60));
  shelf.put(VoxelId{1}, block(101));

  EXPECT_TRUE(shelf.keeps(VoxelId{0}));
  EXPECT_FALSE(shelf.keeps(VoxelId{1}));
}

TEST(BlockShelf, NeverHoldsMoreThanItsBudget) {
  constexpr std::uint32_t kSeed = 5;
  SCOPED_TRACE(kSeed);
  std::mt19937 random{kSeed};
  BlockShelf shelf;
  std::vector<Payload> elsewhere(50);
  for (int step = 0; step < 100'000; ++step) {
    const std::uint32_t voxel = below(random, 50);
    switch (below(random, 4)) {
      case 0:
        if (below(random, 100) == 0) { shelf.set_budget(below(random, 2000)); }
        break;
      case 1:
        shelf.put(VoxelId{voxel}, block(1 + below(random, 300)));
        break;
      case 2:
        elsewhere[voxel] = block(1 + below(random, 300));
        shelf.lend(VoxelId{voxel}, elsewhere[voxel]);
        break;
      default:
        static_cast<void>(shelf.find(VoxelId{voxel}));
    }
    ASSERT_LE(shelf.bytes(), shelf.budget());
  }
}

}  // namespace
}  // namespace preheat
