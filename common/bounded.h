// cereal archives for bytes that nobody vouches for: files and frames.
//
// cereal's own containers allocate what a length field says before they read a byte of it. Here
// every container goes through at_most(), which states its limit, and a count is checked against
// that limit and against the bytes that are left before anything is allocated. Floats must be
// finite and bools 0 or 1. A violation is a cereal::Exception; decode() turns it into an Error.
//
//   struct Message {
//     std::vector<float> positions{};
//     std::string name{};
//   };
//   template <class Archive>
//   void serialize(Archive& archive, Message& message) {
//     archive(at_most(message.positions, kPositionsMax), at_most(message.name, kNameMax));
//   }
//
// Do not include cereal/types/*: the overloads here take their place. Little-endian, no padding.
#pragma once

#include <fmt/format.h>

#include <array>
#include <bit>
#include <cereal/cereal.hpp>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <new>
#include <span>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "common/aabb.h"
#include "common/check.h"
#include "common/result.h"
#include "common/scene_tables.h"
#include "common/vec3.h"

namespace preheat {

static_assert(std::endian::native == std::endian::little, "archives hold numbers as memory does");

class BoundedInput : public cereal::InputArchive<BoundedInput, cereal::AllowEmptyClassElision> {
 public:
  explicit BoundedInput(std::span<const std::byte> bytes) : InputArchive(this), bytes_(bytes) {}

  [[nodiscard]] std::size_t remaining() const { return bytes_.size(); }

  void read(void* to, std::size_t size) {
    if (size > bytes_.size()) {
      throw cereal::Exception(fmt::format("{} bytes wanted, {} left", size, bytes_.size()));
    }
    if (size > 0) { std::memcpy(to, bytes_.data(), size); }
    bytes_ = bytes_.subspan(size);
  }

 private:
  std::span<const std::byte> bytes_;
};

class BoundedOutput : public cereal::OutputArchive<BoundedOutput, cereal::AllowEmptyClassElision> {
 public:
  BoundedOutput() : OutputArchive(this) {}

  void write(const void* from, std::size_t size) {
    const std::size_t at = bytes_.size();
    bytes_.resize(at + size);
    if (size > 0) { std::memcpy(bytes_.data() + at, from, size); }
  }

  [[nodiscard]] std::vector<std::byte> take() { return std::exchange(bytes_, {}); }

 private:
  std::vector<std::byte> bytes_;
};

template <class T>
concept Number =
    std::is_arithmetic_v<T> && !std::is_same_v<T, bool> && !std::is_same_v<T, long double>;

template <Number T>
void CEREAL_SAVE_FUNCTION_NAME(BoundedOutput& output, const T& value) {
  output.write(&value, sizeof(value));
}
template <Number T>
void CEREAL_LOAD_FUNCTION_NAME(BoundedInput& input, T& value) {
  input.read(&value, sizeof(value));
  if constexpr (std::is_floating_point_v<T>) {
    if (!std::isfinite(value)) { throw cereal::Exception("a number is not finite"); }
  }
}

// Templates only so that no other type converts to bool on its way here.
template <std::same_as<bool> T>
void CEREAL_SAVE_FUNCTION_NAME(BoundedOutput& output, const T& value) {
  output(static_cast<std::uint8_t>(value));
}
template <std::same_as<bool> T>
void CEREAL_LOAD_FUNCTION_NAME(BoundedInput& input, T& value) {
  std::uint8_t byte = 0;
  input(byte);
  if (byte > 1) { throw cereal::Exception(fmt::format("a truth value is {}", byte)); }
  value = byte == 1;
}

// An enum whose values run from 0 to `last`: archive(enum_up_to(value, last)).
template <class E>
struct EnumUpTo {
  E& value;
  std::remove_const_t<E> last;
};
template <class E>
[[nodiscard]] EnumUpTo<E> enum_up_to(E& value, std::remove_const_t<E> last) {
  return {value, last};
}
template <class E>
void CEREAL_SAVE_FUNCTION_NAME(BoundedOutput& output, const EnumUpTo<E>& tagged) {
  output(static_cast<std::underlying_type_t<E>>(tagged.value));
}
template <class E>
void CEREAL_LOAD_FUNCTION_NAME(BoundedInput& input, EnumUpTo<E>& tagged) {
  std::underlying_type_t<E> number{};
  input(number);
  if (number > static_cast<std::underlying_type_t<E>>(tagged.last)) {
    throw cereal::Exception(fmt::format("an enum's value is {}", number));
  }
  tagged.value = static_cast<E>(number);
}

// A container with the most elements that it may have; for a list of strings also the most bytes of
// each. Writing more is a bug of ours.
template <class Container>
struct AtMost {
  Container& container;
  std::size_t count_max;
  std::size_t string_bytes_max = 0;
};
template <class Container>
[[nodiscard]] AtMost<Container> at_most(Container& container, std::size_t count_max,
                                        std::size_t string_bytes_max = 0) {
  return {container, count_max, string_bytes_max};
}

namespace bounded_detail {
template <class Container>
inline constexpr bool kIsFlat = Number<typename Container::value_type> ||
                                std::is_same_v<typename Container::value_type, std::byte>;
}  // namespace bounded_detail

template <class Container>
void CEREAL_SAVE_FUNCTION_NAME(BoundedOutput& output, const AtMost<Container>& tagged) {
  const auto& container = tagged.container;
  CHECK(container.size() <= tagged.count_max);
  output(static_cast<std::uint64_t>(container.size()));
  if constexpr (bounded_detail::kIsFlat<Container>) {
    output.write(container.data(), container.size() * sizeof(typename Container::value_type));
  } else {
    for (const auto& element : container) {
      if constexpr (std::is_same_v<typename Container::value_type, std::string>) {
        output(at_most(element, tagged.string_bytes_max));
      } else {
        output(element);
      }
    }
  }
}

template <class Container>
void CEREAL_LOAD_FUNCTION_NAME(BoundedInput& input, AtMost<Container>& tagged) {
  using Element = typename Container::value_type;
  Container& container = tagged.container;
  std::uint64_t count = 0;
  input(count);
  if (count > tagged.count_max || count > input.remaining()) {
    throw cereal::Exception(fmt::format("{} elements, at most {} allowed and {} bytes left", count,
                                        tagged.count_max, input.remaining()));
  }
  container.clear();
  if constexpr (bounded_detail::kIsFlat<Container>) {
    if (count > input.remaining() / sizeof(Element)) {
      throw cereal::Exception(fmt::format("{} elements of {} bytes, {} bytes left", count,
                                          sizeof(Element), input.remaining()));
    }
    container.resize(static_cast<std::size_t>(count));
    input.read(container.data(), container.size() * sizeof(Element));
    if constexpr (std::is_floating_point_v<Element>) {
      for (const Element value : container) {
        if (!std::isfinite(value)) { throw cereal::Exception("a number is not finite"); }
      }
    }
  } else {
    // Grows as elements arrive, so memory follows the bytes that were really there.
    for (std::uint64_t i = 0; i < count; ++i) {
      if constexpr (std::is_same_v<Element, std::string>) {
        input(at_most(container.emplace_back(), tagged.string_bytes_max));
      } else {
        input(container.emplace_back());
      }
    }
  }
}

template <class Archive, class T, std::size_t N>
void serialize(Archive& archive, std::array<T, N>& values) {
  for (T& value : values) { archive(value); }
}
template <class Archive>
void serialize(Archive& archive, Vec3& v) {
  archive(v.x, v.y, v.z);
}
template <class Archive>
void serialize(Archive& archive, Vec3d& v) {
  archive(v.x, v.y, v.z);
}
template <class Archive>
void serialize(Archive& archive, Hash128& hash) {
  archive(hash.low, hash.high);
}
template <class Archive>
void serialize(Archive& archive, Aabb& box) {
  archive(box.low, box.high);
}

template <class T>
[[nodiscard]] std::vector<std::byte> encode(const T& value) {
  BoundedOutput output;
  output(value);
  return output.take();
}

// The value that exactly these bytes encode. `what` names it in the error.
template <class T>
[[nodiscard]] Result<T> decode(std::span<const std::byte> bytes, const char* what, ExitCode code) {
  try {
    T value{};
    BoundedInput input(bytes);
    input(value);
    if (input.remaining() > 0) {
      return fail(code, fmt::format("{}: {} bytes too many", what, input.remaining()));
    }
    return value;
  } catch (const cereal::Exception& violation) {
    return fail(code, fmt::format("{}: {}", what, violation.what()));
  } catch (const std::bad_alloc&) {
    return fail(code, fmt::format("{}: {} bytes do not fit in memory", what, bytes.size()));
  }
}

}  // namespace preheat
