// Numbers of 16 or of 32 bits that lie somewhere in memory, read without a branch on which.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>
#include <vector>

namespace preheat {

class PackedIndices {
 public:
  PackedIndices() = default;
  // 2 more bytes can be read behind the numbers.
  explicit PackedIndices(std::span<const std::uint16_t> narrow)
      : data_(std::as_bytes(narrow).data()), size_(narrow.size()), shift_(1), mask_(0xFFFFU) {}
  explicit PackedIndices(std::span<const std::uint32_t> wide)
      : data_(std::as_bytes(wide).data()), size_(wide.size()) {}

  [[nodiscard]] std::uint32_t operator[](std::size_t at) const {
    std::uint32_t word = 0;
    std::memcpy(&word, data_ + (at << shift_), sizeof word);
    return word & mask_;
  }
  [[nodiscard]] std::size_t size() const { return size_; }

  [[nodiscard]] const std::byte* data() const { return data_; }
  [[nodiscard]] bool is_narrow() const { return shift_ == 1; }

  [[nodiscard]] std::vector<std::uint32_t> unpacked() const {
    std::vector<std::uint32_t> numbers(size_);
    for (std::size_t at = 0; at < size_; ++at) { numbers[at] = (*this)[at]; }
    return numbers;
  }

 private:
  const std::byte* data_ = nullptr;
  std::size_t size_ = 0;
  std::uint32_t shift_ = 2;           // log2 of a number's bytes
  std::uint32_t mask_ = 0xFFFFFFFFU;  // of a word's bits that count
};

}  // namespace preheat
