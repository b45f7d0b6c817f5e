#include "worker/peer_server.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <vector>

namespace preheat {
namespace {

using Standing = PeerServer::Standing;
using std::chrono::milliseconds;

constexpr Time kStart = Time{} + std::chrono::hours(1);
constexpr SessionId kAnna{1, 1};
constexpr SessionId kBert{2, 2};
constexpr WorkerId kAnnasId{11};
constexpr WorkerId kBertsId{12};
constexpr std::uint64_t kBytes = 100;

// A random number less than `count`.
std::uint32_t below(std::mt19937& random, std::uint32_t count) {
  return static_cast<std::uint32_t>(random() % count);
}

RangeRequest all_of(std::uint32_t voxel) { return {BulkObject::kVoxel, VoxelId{voxel}, 0, kBytes}; }

Payload block() {
  auto owner = std::make_shared<std::vector<std::byte>>(kBytes);
  return {*owner, owner};
}

// The one answer that there is now.
template <class M>
M only(PeerServer& server) {
  const std::vector<PeerAnswer> answers = server.take_answers();
  EXPECT_EQ(answers.size(), 1U);
  const M* const message = answers.empty() ? nullptr : std::get_if<M>(&answers[0].message);
  EXPECT_NE(message, nullptr);
  return message == nullptr ? M{} : *message;
}

TEST(PeerServer, SendsWhatItHolds) {
  PeerServer server{Timers{}};
  server.shelf().set_budget(1000);
  server.shelf().put(VoxelId{7}, block());

  EXPECT_FALSE(server.on_request(kAnna, kAnnasId, {BulkObject::kVoxel, VoxelId{7}, 30, 50}, kBytes,
                                 Standing::kNone, kStart));

  const std::vector<PeerAnswer> answers = server.take_answers();
  ASSERT_EQ(answers.size(), 1U);
  EXPECT_EQ(answers[0].to, kAnna);
  EXPECT_EQ(std::get<RangeReply>(answers[0].message).offset, 30U);
  EXPECT_EQ(answers[0].data.bytes.size(), 50U);
  EXPECT_EQ(server.bytes_sent(), 50U);
}

TEST(PeerServer, SaysThatItDoesNotHoldWhatIsNotItsBusiness) {
  PeerServer server{Timers{}};
  EXPECT_FALSE(server.on_request(kAnna, kAnnasId, all_of(7), kBytes, Standing::kNone, kStart));
  EXPECT_EQ(only<VoxelAbsent>(server).holder, kNoWorker);
}

TEST(PeerServer, AsHomeFetchesOnceForAllWhoAsk) {
  PeerServer server{Timers{}};
  EXPECT_TRUE(server.on_request(kAnna, kNoWorker, all_of(7), kBytes, Standing::kHome, kStart));
  only<VoxelLater>(server);
  EXPECT_FALSE(server.on_request(kBert, kNoWorker, all_of(7), kBytes, Standing::kComing, kStart));
  only<VoxelLater>(server);

  server.on_block(VoxelId{7}, block());

  const std::vector<PeerAnswer> answers = server.take_answers();
  ASSERT_EQ(answers.size(), 2U);
  EXPECT_EQ(answers[0].to, kAnna);
  EXPECT_EQ(answers[1].to, kBert);
  EXPECT_EQ(server.waiting(), 0U);
}

TEST(PeerServer, AsHomeWithoutTheVoxelNamesWhoWasSentForItLast) {
  PeerServer server{Timers{}};
  EXPECT_FALSE(
      server.on_request(kAnna, kAnnasId, all_of(7), kBytes, Standing::kHomeNoRoom, kStart));
  EXPECT_EQ(only<VoxelAbsent>(server).holder, kNoWorker);
  EXPECT_FALSE(
      server.on_request(kBert, kBertsId, all_of(7), kBytes, Standing::kHomeNoRoom, kStart));
  EXPECT_EQ(only<VoxelAbsent>(server).holder, kAnnasId);
  // Nobody is sent to himself.
  EXPECT_FALSE(
      server.on_request(kBert, kBertsId, all_of(7), kBytes, Standing::kHomeNoRoom, kStart));
  EXPECT_EQ(only<VoxelAbsent>(server).holder, kNoWorker);
}

TEST(PeerServer, AsHomeSendsAllRangesOfAVoxelTheSameWay) {
  constexpr RangeRequest kFirst{BulkObject::kVoxel, VoxelId{7}, 0, 60};
  constexpr RangeRequest kSecond{BulkObject::kVoxel, VoxelId{7}, 60, 40};
  PeerServer server{Timers{}};
  EXPECT_TRUE(server.on_request(kAnna, kAnnasId, kFirst, kBytes, Standing::kHome, kStart));
  EXPECT_FALSE(server.on_request(kAnna, kAnnasId, kSecond, kBytes, Standing::kHome, kStart));
  EXPECT_EQ(server.waiting(), 2U);
  server.on_block(VoxelId{7}, block());
  static_cast<void>(server.take_answers());

  // It has not kept the voxel, but Anna may have: Bert's second range is no reason to fetch it.
  EXPECT_FALSE(server.on_request(kBert, kBertsId, kFirst, kBytes, Standing::kHome, kStart));
  EXPECT_EQ(only<VoxelAbsent>(server).holder, kAnnasId);
  EXPECT_FALSE(server.on_request(kBert, kBertsId, kSecond, kBytes, Standing::kHome, kStart));
  only<VoxelAbsent>(server);
  EXPECT_EQ(server.waiting(), 0U);
}

TEST(PeerServer, RemembersTheHoldersOfWhatItStaysTheHomeOf) {
  PeerServer server{Timers{}};
  for (const std::uint32_t voxel : {7U, 8U}) {
    static_cast<void>(
        server.on_request(kAnna, kAnnasId, all_of(voxel), kBytes, Standing::kHomeNoRoom, kStart));
  }

  server.keep_holders([](VoxelId voxel) { return voxel == VoxelId{8}; });

  EXPECT_EQ(server.holder(VoxelId{7}), kNoWorker);
  EXPECT_EQ(server.holder(VoxelId{8}), kAnnasId);
}

TEST(PeerServer, TellsWhoWaitsThatItIsAlive) {
  PeerServer server{Timers{}};
  static_cast<void>(
      server.on_request(kAnna, kAnnasId, all_of(7), kBytes, Standing::kComing, kStart));
  static_cast<void>(server.take_answers());

  int told = 0;
  for (Time now = kStart; now < kStart + Timers{}.fetch; now += milliseconds(10)) {
    server.tick(now);
    told += static_cast<int>(server.take_answers().size());
  }

  EXPECT_GE(told, 20);  // five seconds, in each of which twice at least
  server.tick(kStart + Timers{}.fetch);
  EXPECT_EQ(server.waiting(), 0U);
}

TEST(PeerServer, SaysWhatWillNotCome) {
  PeerServer server{Timers{}};
  static_cast<void>(
      server.on_request(kAnna, kAnnasId, all_of(7), kBytes, Standing::kComing, kStart));
  static_cast<void>(server.take_answers());
  server.on_not_coming(VoxelId{7});
  EXPECT_EQ(only<VoxelAbsent>(server).voxel, VoxelId{7});
}

TEST(PeerServer, DropsWhatNoSoundWorkerAsks) {
  PeerServer server{Timers{}};
  for (const RangeRequest& bad : {RangeRequest{BulkObject::kTables, VoxelId{0}, 0, 10},
                                  RangeRequest{BulkObject::kVoxel, VoxelId{0}, kBytes, 1},
                                  RangeRequest{BulkObject::kVoxel, VoxelId{0}, 1, kBytes},
                                  RangeRequest{BulkObject::kVoxel, VoxelId{0}, UINT64_MAX, 10}}) {
    EXPECT_FALSE(server.on_request(kAnna, kAnnasId, bad, kBytes, Standing::kHome, kStart));
  }
  EXPECT_EQ(server.refused(), 4U);
  EXPECT_TRUE(server.take_answers().empty());
}

// Whatever is asked, in whatever order: its lists stay within their bounds, and whoever may wait
// gets an answer in the end.
TEST(PeerServer, StaysWithinItsBounds) {
  constexpr std::uint32_t kSeed = 11;
  SCOPED_TRACE(kSeed);
  std::mt19937 random{kSeed};
  PeerServer server{Timers{}};
  server.shelf().set_budget(10 * kBytes);
  Time now = kStart;
  std::size_t waiting_most = 0;
  std::size_t refused = 0;
  for (int step = 0; step < 200'000; ++step) {
    now += milliseconds(below(random, 3));
    const std::uint32_t asker = below(random, 200) < 100 ? 0 : below(random, 200);
    static_cast<void>(server.on_request({asker, asker}, WorkerId{asker}, all_of(below(random, 500)),
                                        kBytes, static_cast<Standing>(below(random, 4)), now));
    if (below(random, 20) == 0) { server.on_block(VoxelId{below(random, 500)}, block()); }
    if (below(random, 20) == 0) { server.on_not_coming(VoxelId{below(random, 500)}); }
    server.tick(now);
    for (const PeerAnswer& answer : server.take_answers()) {
      refused += std::holds_alternative<VoxelAbsent>(answer.message) ? 1U : 0U;
    }
    waiting_most = std::max(waiting_most, server.waiting());
    ASSERT_LE(server.waiting(), PeerServer::kWaitingMax);
  }
  EXPECT_GT(waiting_most, 100U);
  EXPECT_GT(refused, 0U);
  server.tick(now + Timers{}.fetch);
  EXPECT_EQ(server.waiting(), 0U);
}

}  // namespace
}  // namespace preheat
