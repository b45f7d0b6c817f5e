#include "worker/fetcher.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <random>
#include <string>

#include "common/content_hash.h"

namespace preheat {
namespace {

using std::chrono::seconds;

constexpr Time kStart{};

ObjectKey voxel(std::uint32_t id) { return {BulkObject::kVoxel, VoxelId{id}}; }

std::vector<std::byte> some_bytes(std::size_t count, std::uint32_t seed) {
  std::mt19937 random{seed};
  std::vector<std::byte> bytes(count);
  for (std::byte& byte : bytes) { byte = static_cast<std::byte>(random()); }
  return bytes;
}

// A master with these objects.
class Origin {
 public:
  void add(ObjectKey key, std::vector<std::byte> bytes) { objects_[key] = std::move(bytes); }
  void want_all(Fetcher& fetcher) const {
    for (const auto& [key, bytes] : objects_) {
      fetcher.want(key, bytes.size(), content_hash(bytes));
    }
  }
  void answer(Fetcher& fetcher, const RangeRequest& range, Time now) const {
    const std::span<const std::byte> bytes = objects_.at({range.object, range.voxel});
    fetcher.on_reply({range.object, range.voxel, range.offset},
                     bytes.subspan(range.offset, range.bytes), now);
  }
  [[nodiscard]] const std::vector<std::byte>& bytes(ObjectKey key) const {
    return objects_.at(key);
  }
  std::vector<std::byte>& bytes(ObjectKey key) { return objects_.at(key); }

 private:
  std::map<ObjectKey, std::vector<std::byte>> objects_;
};

TEST(Fetcher, BringsAnObjectOfManyChunks) {
  Fetcher fetcher{seconds(5), seconds(30)};
  Origin origin;
  origin.add(voxel(7), some_bytes(3'000'001, 1));
  origin.want_all(fetcher);

  while (!fetcher.idle()) {
    for (const RangeRequest& range : fetcher.take_requests(kStart)) {
      origin.answer(fetcher, range, kStart);
    }
  }
  const std::vector<FetchedObject> done = fetcher.take_done();

  ASSERT_EQ(done.size(), 1U);
  EXPECT_EQ(done[0].key, voxel(7));
  EXPECT_TRUE(std::equal(done[0].bytes.begin(), done[0].bytes.end(), origin.bytes(voxel(7)).begin(),
                         origin.bytes(voxel(7)).end()));
  EXPECT_EQ(reinterpret_cast<std::uintptr_t>(done[0].bytes.data()) % 16, 0U);
}

TEST(Fetcher, NeverAsksForMoreThanItsWindow) {
  Fetcher fetcher{seconds(5), seconds(30)};
  fetcher.want(voxel(1), 10 * Fetcher::kWindowBytes, {});

  const std::vector<RangeRequest> requests = fetcher.take_requests(kStart);

  EXPECT_EQ(requests.size(), Fetcher::kWindowBytes / kChunkBytesMax);
  EXPECT_EQ(fetcher.bytes_requested(), Fetcher::kWindowBytes);
  EXPECT_TRUE(fetcher.take_requests(kStart).empty());
}

TEST(Fetcher, FetchesOnceWhateverIsWantedTwice) {
  Fetcher fetcher{seconds(5), seconds(30)};
  fetcher.want(voxel(1), 100, {});
  fetcher.want(voxel(1), 100, {});
  EXPECT_EQ(fetcher.take_requests(kStart).size(), 1U);
  fetcher.want(voxel(1), 100, {});
  EXPECT_TRUE(fetcher.take_requests(kStart).empty());
}

TEST(Fetcher, AsksAgainAfterSilenceWithLongerAndLongerPauses) {
  Fetcher fetcher{seconds(5), seconds(30)};
  fetcher.want(voxel(1), 100, {});
  std::vector<int> asked_at;

  for (int second = 0; second <= 100; ++second) {
    if (!fetcher.take_requests(kStart + seconds(second)).empty()) { asked_at.push_back(second); }
  }

  EXPECT_EQ(asked_at, (std::vector<int>{0, 5, 15, 35, 65, 95}));
}

TEST(Fetcher, AsksAgainForWhatOthersHaveOvertaken) {
  Fetcher fetcher{seconds(5), seconds(30)};
  Origin origin;
  for (std::uint32_t id = 0; id < 20; ++id) { origin.add(voxel(id), some_bytes(100, id)); }
  origin.want_all(fetcher);

  std::vector<RangeRequest> requests = fetcher.take_requests(kStart);
  ASSERT_EQ(requests.size(), 20U);
  for (std::size_t i = 1; i < requests.size(); ++i) { origin.answer(fetcher, requests[i], kStart); }
  requests = fetcher.take_requests(kStart);

  ASSERT_EQ(requests.size(), 1U);
  EXPECT_EQ(requests[0].voxel, VoxelId{0});
}

TEST(Fetcher, RefetchesWhatCameDamagedAndReportsItTheSecondTime) {
  Fetcher fetcher{seconds(5), seconds(30)};
  Origin origin;
  origin.add(voxel(1), some_bytes(1000, 1));
  origin.want_all(fetcher);
  origin.bytes(voxel(1))[17] ^= std::byte{1};

  origin.answer(fetcher, fetcher.take_requests(kStart).at(0), kStart);
  EXPECT_TRUE(fetcher.take_done().empty());
  EXPECT_TRUE(fetcher.take_damaged().empty());
  origin.answer(fetcher, fetcher.take_requests(kStart).at(0), kStart);

  EXPECT_TRUE(fetcher.take_done().empty());
  EXPECT_EQ(fetcher.take_damaged(), std::vector<ObjectKey>{voxel(1)});
  EXPECT_EQ(fetcher.hash_mismatches(), 2U);
  EXPECT_TRUE(fetcher.idle());
}

TEST(Fetcher, DropsWhatNobodyAskedFor) {
  Fetcher fetcher{seconds(5), seconds(30)};
  fetcher.want(voxel(1), 100, {});
  static_cast<void>(fetcher.take_requests(kStart));
  const std::vector<std::byte> data(100);

  fetcher.on_reply({BulkObject::kVoxel, VoxelId{2}, 0}, data, kStart);
  fetcher.on_reply({BulkObject::kVoxel, VoxelId{1}, 1}, data, kStart);
  fetcher.on_reply({BulkObject::kVoxel, VoxelId{1}, 0}, std::span(data).first(99), kStart);

  EXPECT_EQ(fetcher.replies_dropped(), 3U);
  EXPECT_FALSE(fetcher.idle());
}

// Replies that are lost, late, doubled, shuffled and damaged on their way.
TEST(Fetcher, BringsEverythingOverABadNetwork) {
  for (std::uint32_t seed = 1; seed <= 10; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    std::mt19937 random{seed};
    Fetcher fetcher{seconds(5), seconds(30)};
    Origin origin;
    for (std::uint32_t id = 0; id < 60; ++id) {
      origin.add(voxel(id), some_bytes(1 + random() % 300'000, id));
    }
    origin.want_all(fetcher);
    std::size_t done = 0;
    std::vector<RangeRequest> on_the_way;
    int steps = 0;
    for (Time now = kStart; !fetcher.idle() && steps < 100'000; ++steps) {
      now += std::chrono::milliseconds(random() % 100);
      for (const RangeRequest& range : fetcher.take_requests(now)) {
        for (auto copies = random() % 10 == 0 ? random() % 3 : 1; copies > 0; --copies) {
          on_the_way.push_back(range);
        }
      }
      EXPECT_LE(fetcher.bytes_requested(), Fetcher::kWindowBytes);
      if (!on_the_way.empty()) {
        const auto which =
            on_the_way.begin() +
            static_cast<std::ptrdiff_t>(random() % std::min<std::size_t>(on_the_way.size(), 4));
        origin.answer(fetcher, *which, now);
        on_the_way.erase(which);
      }
      for (const FetchedObject& object : fetcher.take_done()) {
        EXPECT_TRUE(std::equal(object.bytes.begin(), object.bytes.end(),
                               origin.bytes(object.key).begin(), origin.bytes(object.key).end()));
        ++done;
      }
    }
    EXPECT_EQ(done, 60U);
    EXPECT_TRUE(fetcher.take_damaged().empty());
  }
}

}  // namespace
}  // namespace preheat
