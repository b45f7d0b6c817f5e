#include "common/bounded.h"

#include <gtest/gtest.h>

#include <limits>

namespace preheat {

struct Inner {
  std::uint16_t number = 0;
  std::string name{};
};
template <class Archive>
void serialize(Archive& archive, Inner& inner) {
  archive(inner.number, at_most(inner.name, 16));
}

enum class Colour : std::uint8_t { kRed = 0, kGreen = 1 };

struct Outer {
  bool flag = false;
  Colour colour = Colour::kRed;
  std::vector<float> floats{};
  std::vector<Inner> inners{};
  Vec3 point{0.0F};
};
template <class Archive>
void serialize(Archive& archive, Outer& outer) {
  archive(outer.flag, enum_up_to(outer.colour, Colour::kGreen), at_most(outer.floats, 4),
          at_most(outer.inners, 4), outer.point);
}

namespace {

Outer example() {
  return {.flag = true,
          .colour = Colour::kGreen,
          .floats = {1.5F, -2.5F},
          .inners = {{7, "seven"}, {8, ""}},
          .point = Vec3(1, 2, 3)};
}

Result<Outer> decode_outer(std::span<const std::byte> bytes) {
  return decode<Outer>(bytes, "outer", ExitCode::kFailed);
}

// Offsets of the fields of the example.
constexpr std::size_t kFlagAt = 0;
constexpr std::size_t kColourAt = 1;
constexpr std::size_t kFloatsCountAt = 2;
constexpr std::size_t kFloatsAt = 10;
constexpr std::size_t kInnersCountAt = 18;

std::vector<std::byte> with_bytes(std::size_t offset, const auto& value) {
  std::vector<std::byte> bytes = encode(example());
  std::memcpy(bytes.data() + offset, &value, sizeof(value));
  return bytes;
}

TEST(Bounded, GivesBackWhatWasEncoded) {
  const Result<Outer> decoded = decode_outer(encode(example()));

  ASSERT_TRUE(decoded) << decoded.error().message;
  EXPECT_TRUE(decoded->flag);
  EXPECT_EQ(decoded->colour, Colour::kGreen);
  EXPECT_EQ(decoded->floats, example().floats);
  ASSERT_EQ(decoded->inners.size(), 2U);
  EXPECT_EQ(decoded->inners[0].number, 7);
  EXPECT_EQ(decoded->inners[0].name, "seven");
  EXPECT_EQ(decoded->point, Vec3(1, 2, 3));
}

TEST(Bounded, RefusesEveryTruncationAndEveryExtraByte) {
  std::vector<std::byte> bytes = encode(example());
  for (std::size_t length = 0; length < bytes.size(); ++length) {
    EXPECT_FALSE(decode_outer(std::span(bytes).first(length))) << length;
  }
  bytes.push_back(std::byte{0});
  EXPECT_FALSE(decode_outer(bytes));
}

TEST(Bounded, RefusesCountsThatTheBytesCannotHold) {
  for (const std::uint64_t count :
       {std::uint64_t{5}, std::uint64_t{1} << 32U, std::uint64_t{1} << 62U, ~std::uint64_t{0}}) {
    EXPECT_FALSE(decode_outer(with_bytes(kFloatsCountAt, count))) << count;
    EXPECT_FALSE(decode_outer(with_bytes(kInnersCountAt, count))) << count;
  }
}

// The limit is large, the bytes are few: nothing may be allocated for the count.
TEST(Bounded, AllocatesNothingForACountWithoutBytes) {
  std::vector<double> values;
  const std::vector<std::byte> bytes = encode(std::uint64_t{1} << 40U);
  BoundedInput input(bytes);

  EXPECT_THROW(input(at_most(values, ~std::size_t{0})), cereal::Exception);

  EXPECT_EQ(values.capacity(), 0U);
}

TEST(Bounded, RefusesNumbersThatAreNotFinite) {
  for (const float bad :
       {std::numeric_limits<float>::quiet_NaN(), -std::numeric_limits<float>::infinity()}) {
    EXPECT_FALSE(decode_outer(with_bytes(kFloatsAt + 4, bad)));
    EXPECT_FALSE(decode_outer(with_bytes(encode(example()).size() - 4, bad)));
  }
}

TEST(Bounded, RefusesTruthValuesAndEnumsOutOfRange) {
  EXPECT_TRUE(decode_outer(with_bytes(kFlagAt, std::uint8_t{0})));
  EXPECT_FALSE(decode_outer(with_bytes(kFlagAt, std::uint8_t{2})));
  EXPECT_TRUE(decode_outer(with_bytes(kColourAt, std::uint8_t{0})));
  EXPECT_FALSE(decode_outer(with_bytes(kColourAt, std::uint8_t{2})));
}

TEST(Bounded, LimitsEveryStringOfAList) {
  std::vector<std::string> names{"a", "bcd", ""};
  BoundedOutput output;
  output(at_most(names, 3, 3));
  const std::vector<std::byte> bytes = output.take();

  std::vector<std::string> decoded;
  BoundedInput input(bytes);
  input(at_most(decoded, 3, 3));
  EXPECT_EQ(decoded, names);

  BoundedInput again(bytes);
  EXPECT_THROW(again(at_most(decoded, 3, 2)), cereal::Exception);
}

TEST(BoundedDeathTest, WritingMoreThanTheLimitIsABug) {
  Outer outer = example();
  outer.floats.resize(5);
  EXPECT_DEATH(static_cast<void>(encode(outer)), "");
}

}  // namespace
}  // namespace preheat
