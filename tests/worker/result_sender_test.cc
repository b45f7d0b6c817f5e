#include "worker/result_sender.h"

#include <gtest/gtest.h>

#include "common/content_hash.h"
#include "common/tile_codec.h"

namespace preheat {
namespace {

using std::chrono::seconds;

constexpr Time kStart{};

TilePixels pixels_of(std::uint32_t side, float value) {
  TilePixels pixels;
  pixels.rgb.assign(std::size_t{side} * side * 3, value);
  pixels.variance.assign(std::size_t{side} * side, 2.0F * value);
  return pixels;
}

Lease lease_of(std::uint64_t id) { return {LeaseId{id}, TileId{static_cast<std::uint32_t>(id)}}; }

TEST(ResultSender, ChunksMakeUpTheTile) {
  ResultSender sender{seconds(5), seconds(30)};
  const TilePixels pixels = pixels_of(300, 0.5F);  // 1.44 MB, six chunks
  sender.add(lease_of(1), pixels);

  const auto chunks = sender.take_chunks(kStart);
  std::vector<std::byte> bytes(chunks.at(0).first.total_bytes);
  for (const auto& [chunk, data] : chunks) {
    std::copy(data.bytes.begin(), data.bytes.end(),
              bytes.begin() + static_cast<std::ptrdiff_t>(chunk.offset));
  }
  const auto decoded = decode_tile(bytes, TileRect{0, 0, 300, 300});

  EXPECT_EQ(chunks.size(), 6U);
  EXPECT_EQ(content_hash(bytes), chunks[0].first.hash);
  ASSERT_TRUE(decoded.has_value());
  EXPECT_EQ(decoded->rgb, pixels.rgb);
  EXPECT_EQ(decoded->variance, pixels.variance);
}

TEST(ResultSender, HoldsToItsWindowUntilChunksArrive) {
  ResultSender sender{seconds(5), seconds(30)};
  for (std::uint64_t id = 1; id <= 12; ++id) { sender.add(lease_of(id), pixels_of(8, 1.0F)); }

  EXPECT_EQ(sender.take_chunks(kStart).size(), ResultSender::kChunksInFlightMax);
  EXPECT_TRUE(sender.take_chunks(kStart).empty());
  sender.on_chunk_ack({LeaseId{1}, 0}, kStart);
  sender.on_result_ack(LeaseId{2}, kStart);
  EXPECT_EQ(sender.take_chunks(kStart).size(), 2U);
}

TEST(ResultSender, KeepsAResultUntilTheMasterHasIt) {
  ResultSender sender{seconds(5), seconds(30)};
  sender.add(lease_of(1), pixels_of(8, 1.0F));
  EXPECT_EQ(sender.take_chunks(kStart).size(), 1U);
  EXPECT_TRUE(sender.take_chunks(kStart + seconds(4)).empty());
  EXPECT_EQ(sender.take_chunks(kStart + seconds(5)).size(), 1U);  // not even the chunk arrived
  sender.on_chunk_ack({LeaseId{1}, 0}, kStart + seconds(6));
  EXPECT_EQ(sender.take_chunks(kStart + seconds(11)).size(), 1U);  // arrived, but no verdict came

  sender.on_result_ack(LeaseId{1}, kStart + seconds(12));

  EXPECT_TRUE(sender.idle());
  EXPECT_TRUE(sender.take_chunks(kStart + seconds(100)).empty());
}

TEST(ResultSender, RefusesTilesOfAnotherShapeOrWithBadValues) {
  std::vector<std::byte> bytes = encode_tile(pixels_of(8, 1.0F));
  EXPECT_TRUE(decode_tile(bytes, TileRect{0, 0, 8, 8}).has_value());
  EXPECT_FALSE(decode_tile(bytes, TileRect{0, 0, 8, 7}).has_value());
  bytes[3] = std::byte{0x7F};
  bytes[2] = std::byte{0xC0};  // NaN
  EXPECT_FALSE(decode_tile(bytes, TileRect{0, 0, 8, 8}).has_value());
  EXPECT_FALSE(decode_tile(encode_tile(pixels_of(8, -1.0F)), TileRect{0, 0, 8, 8}).has_value());
}

}  // namespace
}  // namespace preheat
