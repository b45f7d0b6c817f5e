#include "worker/fetcher.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <iostream>
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
    fetcher.on_reply(kOrigin, {range.object, range.voxel, range.offset},
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
  Fetcher fetcher{Timers{}};
  Origin origin;
  origin.add(voxel(7), some_bytes(3'000'001, 1));
  origin.want_all(fetcher);

  while (!fetcher.idle()) {
    for (const auto& [source, range] : fetcher.take_requests(kStart)) {
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
  Fetcher fetcher{Timers{}};
  fetcher.want(voxel(1), 10 * Fetcher::kWindowBytes, {});

  const std::vector<SourcedRequest> requests = fetcher.take_requests(kStart);

  EXPECT_EQ(requests.size(), Fetcher::kWindowBytes / kChunkBytesMax);
  EXPECT_EQ(fetcher.bytes_requested(), Fetcher::kWindowBytes);
  EXPECT_TRUE(fetcher.take_requests(kStart).empty());
}

TEST(Fetcher, FetchesOnceWhateverIsWantedTwice) {
  Fetcher fetcher{Timers{}};
  fetcher.want(voxel(1), 100, {});
  fetcher.want(voxel(1), 100, {});
  EXPECT_EQ(fetcher.take_requests(kStart).size(), 1U);
  fetcher.want(voxel(1), 100, {});
  EXPECT_TRUE(fetcher.take_requests(kStart).empty());
}

TEST(Fetcher, AsksAgainAfterSilenceWithLongerAndLongerPauses) {
  Fetcher fetcher{Timers{}};
  fetcher.want(voxel(1), 100, {});
  std::vector<int> asked_at;

  for (int second = 0; second <= 100; ++second) {
    if (!fetcher.take_requests(kStart + seconds(second)).empty()) { asked_at.push_back(second); }
  }

  EXPECT_EQ(asked_at, (std::vector<int>{0, 5, 15, 35, 65, 95}));
}

TEST(Fetcher, AsksAgainForWhatOthersHaveOvertaken) {
  Fetcher fetcher{Timers{}};
  Origin origin;
  for (std::uint32_t id = 0; id < 20; ++id) { origin.add(voxel(id), some_bytes(100, id)); }
  origin.want_all(fetcher);

  std::vector<SourcedRequest> requests = fetcher.take_requests(kStart);
  ASSERT_EQ(requests.size(), 20U);
  for (std::size_t i = 1; i < requests.size(); ++i) {
    origin.answer(fetcher, requests[i].range, kStart);
  }
  requests = fetcher.take_requests(kStart);

  ASSERT_EQ(requests.size(), 1U);
  EXPECT_EQ(requests[0].range.voxel, VoxelId{0});
}

TEST(Fetcher, RefetchesWhatCameDamagedAndReportsItTheSecondTime) {
  Fetcher fetcher{Timers{}};
  Origin origin;
  origin.add(voxel(1), some_bytes(1000, 1));
  origin.want_all(fetcher);
  origin.bytes(voxel(1))[17] ^= std::byte{1};

  origin.answer(fetcher, fetcher.take_requests(kStart).at(0).range, kStart);
  EXPECT_TRUE(fetcher.take_done().empty());
  EXPECT_TRUE(fetcher.take_damaged().empty());
  origin.answer(fetcher, fetcher.take_requests(kStart).at(0).range, kStart);

  EXPECT_TRUE(fetcher.take_done().empty());
  EXPECT_EQ(fetcher.take_damaged(), std::vector<ObjectKey>{voxel(1)});
  EXPECT_EQ(fetcher.hash_mismatches(), 2U);
  EXPECT_TRUE(fetcher.idle());
}

TEST(Fetcher, DropsWhatNobodyAskedFor) {
  Fetcher fetcher{Timers{}};
  fetcher.want(voxel(1), 100, {});
  static_cast<void>(fetcher.take_requests(kStart));
  const std::vector<std::byte> data(100);

  fetcher.on_reply(kOrigin, {BulkObject::kVoxel, VoxelId{2}, 0}, data, kStart);
  fetcher.on_reply(kOrigin, {BulkObject::kVoxel, VoxelId{1}, 1}, data, kStart);
  fetcher.on_reply(kOrigin, {BulkObject::kVoxel, VoxelId{1}, 0}, std::span(data).first(99), kStart);

  EXPECT_EQ(fetcher.replies_dropped(), 3U);
  EXPECT_FALSE(fetcher.idle());
}

// Replies that are lost, late, doubled, shuffled and damaged on their way.
TEST(Fetcher, BringsEverythingOverABadNetwork) {
  for (std::uint32_t seed = 1; seed <= 10; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    std::mt19937 random{seed};
    Fetcher fetcher{Timers{}};
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
      for (const auto& [source, range] : fetcher.take_requests(now)) {
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

// A random number less than `count`.
std::uint32_t below(std::mt19937& random, std::uint32_t count) {
  return static_cast<std::uint32_t>(random() % count);
}

constexpr WorkerId kHome{3};
constexpr WorkerId kHolder{4};

std::vector<WorkerId> sources_of(const std::vector<SourcedRequest>& requests) {
  std::vector<WorkerId> sources;
  for (const SourcedRequest& request : requests) { sources.push_back(request.source); }
  return sources;
}

// A fetcher that wants one voxel of its home.
struct OneVoxel {
  Timers timers{};
  Fetcher fetcher{timers};
  std::vector<std::byte> bytes = some_bytes(1000, 1);
  Time now = kStart + std::chrono::hours(1);

  OneVoxel() { want(); }
  void want() { fetcher.want(voxel(1), bytes.size(), content_hash(bytes), {kHome}); }
  void reply(WorkerId source, std::span<const std::byte> data) {
    fetcher.on_reply(source, {BulkObject::kVoxel, VoxelId{1}, 0}, data, now);
  }
  std::vector<WorkerId> ask() { return sources_of(fetcher.take_requests(now)); }
};

TEST(FetcherPeers, TheHomeIsAskedFirst) {
  OneVoxel test;
  EXPECT_EQ(test.ask(), std::vector<WorkerId>{kHome});
  test.reply(kHome, test.bytes);
  const auto done = test.fetcher.take_done();
  ASSERT_EQ(done.size(), 1U);
  EXPECT_EQ(done[0].source, kHome);
}

TEST(FetcherPeers, ThenWhomTheHomeNamesThenTheMaster) {
  OneVoxel test;
  static_cast<void>(test.ask());
  test.fetcher.on_absent(kHome, voxel(1), kHolder, test.now);
  EXPECT_EQ(test.ask(), std::vector<WorkerId>{kHolder});
  // A second hint is not followed.
  test.fetcher.on_absent(kHolder, voxel(1), kHome, test.now);
  EXPECT_EQ(test.ask(), std::vector<WorkerId>{kOrigin});
}

TEST(FetcherPeers, ASilentPeerIsLeftAloneForLongerAndLonger) {
  OneVoxel test;
  std::vector<Duration> asked_again;
  for (int i = 0; i < 4; ++i) {
    ASSERT_EQ(test.ask(), std::vector<WorkerId>{kHome});
    test.now += test.timers.fetch;
    ASSERT_EQ(test.ask(), std::vector<WorkerId>{kOrigin});
    const Time failed = test.now;
    test.reply(kOrigin, test.bytes);
    while (!test.fetcher.may_ask(kHome, test.now)) { test.now += std::chrono::milliseconds(100); }
    asked_again.push_back(test.now - failed);
    test.want();
  }
  EXPECT_EQ(asked_again, (std::vector<Duration>{seconds(1), seconds(2), seconds(4), seconds(8)}));
  EXPECT_EQ(test.fetcher.peer_timeouts(), 4U);
}

TEST(FetcherPeers, TheMasterIsAskedHalfASecondAfterAPeerFellSilent) {
  OneVoxel test;
  static_cast<void>(test.ask());
  test.now += test.timers.peer - std::chrono::milliseconds(1);
  EXPECT_TRUE(test.ask().empty());
  test.now += std::chrono::milliseconds(1);
  EXPECT_EQ(test.ask(), std::vector<WorkerId>{kOrigin});
}

TEST(FetcherPeers, WordsOfHopeAreBelievedForAsLongAsTheMasterWouldBe) {
  OneVoxel test;
  static_cast<void>(test.ask());
  const Time end = test.now + test.timers.fetch;
  for (; test.now + std::chrono::milliseconds(100) < end;) {
    test.now += std::chrono::milliseconds(100);
    test.fetcher.on_later(kHome, test.now);
    ASSERT_TRUE(test.ask().empty());
  }
  test.now = end;
  test.fetcher.on_later(kHome, test.now);
  EXPECT_EQ(test.ask(), std::vector<WorkerId>{kOrigin});
}

TEST(FetcherPeers, ALiarIsNeverAskedAgain) {
  OneVoxel test;
  static_cast<void>(test.ask());
  std::vector<std::byte> wrong = test.bytes;
  wrong[500] ^= std::byte{1};
  test.reply(kHome, wrong);
  EXPECT_TRUE(test.fetcher.take_done().empty());
  EXPECT_EQ(test.ask(), std::vector<WorkerId>{kOrigin});
  EXPECT_EQ(test.fetcher.peer_lies(), 1U);
  test.reply(kOrigin, test.bytes);
  EXPECT_EQ(test.fetcher.take_done().size(), 1U);

  test.now += std::chrono::hours(10);
  test.want();
  EXPECT_EQ(test.ask(), std::vector<WorkerId>{kOrigin});
  EXPECT_TRUE(test.fetcher.take_damaged().empty());
}

TEST(FetcherPeers, OneWhoSendsWhatNobodyAskedForIsALiarInTheEnd) {
  OneVoxel test;
  static_cast<void>(test.ask());
  for (std::uint32_t i = 0; i <= Fetcher::kUnaskedMax; ++i) {
    EXPECT_TRUE(test.fetcher.may_ask(kHome, test.now));
    test.fetcher.on_reply(kHome, {BulkObject::kVoxel, VoxelId{9}, 0}, test.bytes, test.now);
  }
  EXPECT_TRUE(test.fetcher.is_banned(kHome));
  EXPECT_EQ(test.ask(), std::vector<WorkerId>{kOrigin});
}

TEST(FetcherPeers, OneThatHoldsNothingLargeIsNoLiar) {
  Timers timers;
  Fetcher fetcher{timers};
  // Eight ranges each, and eight answers, of which only the first counts.
  for (std::uint32_t id = 0; id < Fetcher::kUnaskedMax; ++id) {
    fetcher.want(voxel(id), Fetcher::kWindowBytes, {}, {kHome});
    const auto requests = fetcher.take_requests(kStart);
    ASSERT_EQ(sources_of(requests), std::vector<WorkerId>(8, kHome));
    for (std::size_t i = 0; i < requests.size(); ++i) {
      fetcher.on_absent(kHome, voxel(id), kNoWorker, kStart);
    }
    fetcher.forget(voxel(id));
  }
  EXPECT_FALSE(fetcher.is_banned(kHome));
}

TEST(FetcherPeers, WhatAPeerThatIsGoneWasAskedForGoesElsewhere) {
  OneVoxel test;
  static_cast<void>(test.ask());
  test.fetcher.keep_peers({kHolder}, test.now);
  EXPECT_EQ(test.ask(), std::vector<WorkerId>{kOrigin});
  EXPECT_EQ(test.fetcher.peer_timeouts(), 0U);
}

TEST(FetcherPeers, WhatIsForgottenIsAskedForNoMore) {
  OneVoxel test;
  static_cast<void>(test.ask());
  test.fetcher.forget(voxel(1));
  EXPECT_TRUE(test.fetcher.idle());
  EXPECT_EQ(test.fetcher.bytes_requested(), 0U);
  test.reply(kHome, test.bytes);
  EXPECT_TRUE(test.fetcher.take_done().empty());
}

// Peers that serve, know nothing, know somebody, lie, promise, are silent, come and go: every
// object arrives whole, whoever sent it, no window is overdrawn, and no liar is asked twice.
TEST(FetcherPeers, BringEverythingWhateverTheyAreLike) {
  std::uint64_t steps = 0;
  std::uint64_t lies = 0;
  std::uint64_t timeouts = 0;
  std::map<bool, std::uint64_t> came_from;
  for (std::uint32_t seed = 1; seed <= 200; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    std::mt19937 random{seed};
    Fetcher fetcher{Timers{}};
    std::map<ObjectKey, std::vector<std::byte>> objects;
    for (std::uint32_t id = 0; id < 60; ++id) {
      const std::vector<std::byte>& bytes = objects[voxel(id)] =
          some_bytes(1 + random() % 2000 * (random() % 20 == 0 ? 300 : 1), id);
      fetcher.want(voxel(id), bytes.size(), content_hash(bytes),
                   {WorkerId{below(random, 6)}, WorkerId{below(random, 6)}});
    }
    std::set<WorkerId> liars_caught;
    std::size_t done = 0;
    Time now = kStart + std::chrono::hours(1);
    std::vector<SourcedRequest> on_the_way;
    for (int step = 0; !fetcher.idle() && step < 100'000; ++step, ++steps) {
      now += std::chrono::milliseconds(random() % 50);
      for (const SourcedRequest& request : fetcher.take_requests(now)) {
        EXPECT_FALSE(liars_caught.contains(request.source));
        on_the_way.push_back(request);
      }
      for (std::uint32_t id = 0; id < 6; ++id) {
        ASSERT_LE(fetcher.bytes_requested(WorkerId{id}), Fetcher::kWindowBytes);
      }
      ASSERT_LE(fetcher.bytes_requested(kOrigin), Fetcher::kWindowBytes);
      if (random() % 200 == 0) {
        fetcher.keep_peers({WorkerId{0}, WorkerId{below(random, 6)}}, now);
      }
      if (on_the_way.empty()) { continue; }
      const std::size_t which = random() % std::min<std::size_t>(on_the_way.size(), 8);
      const auto [source, range] = on_the_way[which];
      on_the_way.erase(on_the_way.begin() + static_cast<std::ptrdiff_t>(which));
      std::vector<std::byte> data(range.bytes);
      const auto& object = objects.at({range.object, range.voxel});
      std::copy_n(object.begin() + static_cast<std::ptrdiff_t>(range.offset), range.bytes,
                  data.begin());
      const RangeReply reply{range.object, range.voxel, range.offset};
      const ObjectKey key{range.object, range.voxel};
      if (source == kOrigin || index_of(source) < 2) {
        fetcher.on_reply(source, reply, data, now);
      } else if (source == WorkerId{2}) {
        fetcher.on_absent(source, key, WorkerId{below(random, 6)}, now);
      } else if (source == WorkerId{3}) {
        data[random() % data.size()] ^= std::byte{1};
        fetcher.on_reply(source, reply, data, now);
        if (fetcher.is_banned(source)) { liars_caught.insert(source); }
      } else if (source == WorkerId{4}) {
        fetcher.on_later(source, now);
      }  // the sixth is silent
      for (const FetchedObject& whole : fetcher.take_done()) {
        EXPECT_TRUE(std::equal(whole.bytes.begin(), whole.bytes.end(),
                               objects.at(whole.key).begin(), objects.at(whole.key).end()));
        ++came_from[whole.source == kOrigin];
        ++done;
      }
    }
    EXPECT_EQ(done, 60U);
    EXPECT_EQ(fetcher.bytes_requested(), 0U);
    EXPECT_TRUE(fetcher.take_damaged().empty());
    lies += fetcher.peer_lies();
    timeouts += fetcher.peer_timeouts();
  }
  EXPECT_GT(lies, 100U);
  EXPECT_GT(timeouts, 100U);
  EXPECT_GT(came_from[true], 100U);
  EXPECT_GT(came_from[false], 100U);
  std::cout << steps << " steps\n";
}

}  // namespace
}  // namespace preheat
