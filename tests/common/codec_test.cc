#include "common/codec.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <random>

#include "common/home_plan.h"

namespace preheat {
namespace {

constexpr JobKey kJob{/*job=*/0x1122334455667788, /*epoch=*/42};

WorkerStats some_stats() {
  WorkerStats stats;
  stats.tiles = 7;
  stats.rays = {1, 2, 3, 4};
  stats.cache.misses = 99;
  stats.cache.stall_seconds = 0.25;
  stats.preload = {5, 6, 0.5};
  return stats;
}

Welcome some_welcome() {
  Welcome welcome;
  welcome.worker = WorkerId{3};
  welcome.bulk_port = 40001;
  welcome.settings.view.origin = Vec3(1.0F, 2.0F, -3.0F);
  welcome.settings.width = 640;
  welcome.settings.height = 480;
  welcome.settings.seed = 11;
  welcome.tile_size = 32;
  welcome.count_accesses = AccessCounting::kExact;
  welcome.paths_per_thread = 4096;
  welcome.tables_bytes = 12345;
  welcome.tables_hash = {1, 2};
  welcome.plan_bytes = 400;
  return welcome;
}

Status some_status() {
  Status status;
  status.build.text = "0.1.0";
  status.phase = JobPhase::kRendering;
  status.tiles_done = 3;
  status.tiles_total = 9;
  status.rendering_seconds = 1.5;
  return status;
}

// One of each, with something in every container.
std::vector<Message> one_of_each() {
  Hello hello;
  hello.session = {3, 4};
  hello.build.text = "0.1.0";
  hello.isa.text = "avx2";
  hello.threads = 8;
  hello.cache_kind = CacheRequestKind::kShare;
  hello.cache_share = 0.25;
  const Lease lease{LeaseId{0xABCDEF}, TileId{17}};
  return {hello,
          some_welcome(),
          Refuse{7, {"no"}},
          Unknown{},
          Ready{{1, 2, 3.0}},
          Grant{{{lease, lease}}},
          Cancel{{{lease}}},
          ResultAck{LeaseId{5}},
          WorkerHeartbeat{9, some_stats(), {{lease, lease}}},
          MasterHeartbeat{1, 2},
          Fault{FaultKind::kVoxelDamaged, VoxelId{8}, {"bad"}},
          Goodbye{some_stats()},
          JobDone{},
          RangeRequest{BulkObject::kVoxel, VoxelId{3}, 262144, 1000},
          RangeReply{BulkObject::kPlan, VoxelId{0}, 0},
          TileChunk{LeaseId{1}, TileId{2}, 0, 16384, {5, 6}},
          TileChunkAck{LeaseId{1}, 0},
          StatusRequest{},
          some_status(),
          VoxelAccesses{4096, {{1, 0, 3}}},
          PeersChanged{3, 1000, {4, 5}},
          VoxelAbsent{VoxelId{7}, WorkerId{2}},
          VoxelLater{}};
}

TEST(Codec, EveryMessageComesBackAsItWentOut) {
  const std::vector<Message> messages = one_of_each();
  ASSERT_EQ(messages.size(), std::variant_size_v<Message>);

  for (std::size_t type = 0; type < messages.size(); ++type) {
    const std::vector<std::byte> bytes = encode_frame(kJob, messages[type]);
    const auto frame = decode_frame(bytes);

    ASSERT_EQ(messages[type].index(), type);
    ASSERT_TRUE(frame.has_value()) << "type " << type;
    EXPECT_EQ(frame->job, kJob);
    EXPECT_EQ(frame->message.index(), type);
    EXPECT_EQ(encode_frame(kJob, frame->message), bytes) << "type " << type;
  }
}

TEST(Codec, ValuesArriveInTheirOwnFields) {
  const auto frame = decode_frame(encode_frame(kJob, some_welcome()));

  ASSERT_TRUE(frame.has_value());
  const auto& welcome = std::get<Welcome>(frame->message);
  EXPECT_EQ(welcome.settings.view.origin, Vec3(1.0F, 2.0F, -3.0F));
  EXPECT_EQ(welcome.settings.width, 640U);
  EXPECT_EQ(welcome.settings.height, 480U);
  EXPECT_EQ(welcome.tables_hash, (Hash128{1, 2}));
  EXPECT_EQ(welcome.count_accesses, AccessCounting::kExact);
  EXPECT_EQ(welcome.paths_per_thread, 4096U);
}

TEST(Codec, RefusesEveryTruncationAndEveryChangedByte) {
  for (const Message& message : one_of_each()) {
    const std::vector<std::byte> good = encode_frame(kJob, message);
    for (std::size_t length = 0; length < good.size(); ++length) {
      EXPECT_FALSE(decode_frame(std::span(good).first(length)).has_value());
    }
    std::vector<std::byte> longer(good.size() + 1);
    std::copy(good.begin(), good.end(), longer.begin());
    EXPECT_FALSE(decode_frame(longer).has_value());
    for (std::size_t at = 0; at < good.size(); ++at) {
      std::vector<std::byte> changed = good;
      changed[at] ^= std::byte{0x40};
      EXPECT_FALSE(decode_frame(changed).has_value()) << "type " << message.index() << " at " << at;
    }
  }
}

TEST(Codec, TellsAnotherVersionFromGarbage) {
  std::vector<std::byte> frame = encode_frame(kJob, Unknown{});
  frame[4] = std::byte{kProtocolVersion + 1};
  const auto other_version = decode_frame(frame);
  frame[0] = std::byte{'X'};
  const auto garbage = decode_frame(frame);

  ASSERT_FALSE(other_version.has_value());
  EXPECT_EQ(other_version.error().fault, FrameFault::kVersion);
  EXPECT_EQ(other_version.error().version, kProtocolVersion + 1);
  ASSERT_FALSE(garbage.has_value());
  EXPECT_EQ(garbage.error().fault, FrameFault::kNotOurs);
}

// Sound frames around values that break a rule: the encoder checks nothing but container bounds.
TEST(Codec, RefusesValuesOutOfRange) {
  std::vector<Message> bad;
  Welcome welcome = some_welcome();
  welcome.settings.width = 0;
  bad.emplace_back(welcome);
  welcome = some_welcome();
  welcome.settings.view.forward.y = std::numeric_limits<float>::quiet_NaN();
  bad.emplace_back(welcome);
  welcome = some_welcome();
  welcome.home_bytes = welcome.cache_limit_bytes + 1;
  bad.emplace_back(welcome);
  bad.emplace_back(PeersChanged{0, 1000, {}});
  bad.emplace_back(PeersChanged{1, kHomePlanBytesMax + 1, {}});
  welcome = some_welcome();
  welcome.settings.width = welcome.settings.height = 65536;  // 2^32 pixels
  bad.emplace_back(welcome);
  welcome = some_welcome();
  welcome.settings.width = welcome.settings.height = 40000;
  welcome.tile_size = 1;  // 1.6e9 tiles
  bad.emplace_back(welcome);
  welcome = some_welcome();
  welcome.bulk_port = 65536;
  bad.emplace_back(welcome);
  welcome = some_welcome();
  welcome.count_accesses = static_cast<AccessCounting>(3);
  bad.emplace_back(welcome);
  for (const std::uint32_t paths : {0U, kPathsPerThreadMin - 1, kPathsPerThreadMax + 1}) {
    welcome = some_welcome();
    welcome.paths_per_thread = paths;
    bad.emplace_back(welcome);
  }
  Hello hello;
  hello.threads = 0;
  bad.emplace_back(hello);
  hello = {};
  hello.cache_kind = CacheRequestKind::kShare;
  hello.cache_share = -0.1;
  bad.emplace_back(hello);
  hello = {};
  hello.isa.text = "avx2\n2026 info forged line";
  bad.emplace_back(hello);
  WorkerHeartbeat heartbeat;
  heartbeat.stats.cache.stall_seconds = std::numeric_limits<double>::infinity();
  bad.emplace_back(heartbeat);
  bad.emplace_back(RangeRequest{BulkObject::kVoxel, VoxelId{0}, 0, kChunkBytesMax + 1});
  bad.emplace_back(RangeRequest{static_cast<BulkObject>(4), VoxelId{0}, 0, 1});
  bad.emplace_back(TileChunk{LeaseId{1}, TileId{1}, 0, std::uint64_t{1} << 40, {}});
  Status status = some_status();
  status.phase = static_cast<JobPhase>(4);
  bad.emplace_back(status);
  status = some_status();
  status.tiles_done = 10;
  bad.emplace_back(status);
  status = some_status();
  status.build.text = "0.1.0\x1b[2J";
  bad.emplace_back(status);

  for (std::size_t i = 0; i < bad.size(); ++i) {
    const auto frame = decode_frame(encode_frame(kJob, bad[i]));
    ASSERT_FALSE(frame.has_value()) << "case " << i;
    EXPECT_EQ(frame.error().fault, FrameFault::kMalformed) << "case " << i;
  }
}

TEST(Codec, TheLargestMessagesFitAControlFrame) {
  WorkerHeartbeat heartbeat;
  heartbeat.held.items.resize(kLeasesPerWorkerMax);
  Grant grant;
  grant.leases.items.resize(kLeasesPerWorkerMax);

  EXPECT_LE(encode_frame(kJob, heartbeat).size(), kControlFrameBytesMax);
  EXPECT_LE(encode_frame(kJob, grant).size(), kControlFrameBytesMax);
}

// Random bodies behind a sound header: most are refused, none does harm.
TEST(Codec, SurvivesRandomBodies) {
  const std::uint32_t seed = 20260721;
  SCOPED_TRACE("seed " + std::to_string(seed));
  std::mt19937 random{seed};
  const std::vector<Message> messages = one_of_each();
  std::size_t accepted = 0;
  constexpr int kRounds = 20000;

  for (int round = 0; round < kRounds; ++round) {
    std::vector<std::byte> frame =
        encode_frame(kJob, messages[random() % std::variant_size_v<Message>]);
    if (frame.size() > kFrameHeaderBytes) {
      const std::size_t at = kFrameHeaderBytes + random() % (frame.size() - kFrameHeaderBytes);
      frame[at] = static_cast<std::byte>(random());
    }
    accepted += decode_frame(frame).has_value() ? 1U : 0U;
  }

  EXPECT_LT(accepted,
            static_cast<std::size_t>(kRounds));  // the checksum lets equal bytes pass only
}

}  // namespace
}  // namespace preheat
