// Numbers keys in the order in which they first appear: a hash table with open addressing.
#pragma once

#include <bit>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace preheat {

class FlatIndex {
 public:
  // Room for that many keys before it has to grow.
  explicit FlatIndex(std::size_t keys_expected = 32) { reset(keys_expected); }

  // The key's number: size() before the call if the key is new.
  std::uint32_t number_of(std::uint32_t key) {
    if (2 * (size_ + 1) > slots_.size()) { grow(); }
    Slot& slot = slots_[place_of(key)];
    if (slot.number_plus_one == 0) { slot = {key, static_cast<std::uint32_t>(++size_)}; }
    return slot.number_plus_one - 1;
  }

  [[nodiscard]] std::size_t size() const { return size_; }

  void reset(std::size_t keys_expected) {
    slots_.assign(std::bit_ceil(2 * keys_expected + 2), Slot{});
    size_ = 0;
  }

 private:
  struct Slot {
    std::uint32_t key = 0;
    std::uint32_t number_plus_one = 0;  // 0 = free
  };

  // Where the key is, or the free slot where it goes. Multiplying by 2^32 / golden ratio spreads
  // runs of neighbouring keys, which is what vertex numbers are.
  [[nodiscard]] std::size_t place_of(std::uint32_t key) const {
    const std::size_t mask = slots_.size() - 1;
    std::size_t place = (key * std::uint64_t{0x9E3779B97F4A7C15} >> 32) & mask;
    while (slots_[place].number_plus_one != 0 && slots_[place].key != key) {
      place = (place + 1) & mask;
    }
    return place;
  }

  void grow() {
    std::vector<Slot> old(2 * slots_.size());
    old.swap(slots_);
    for (const Slot& slot : old) {
      if (slot.number_plus_one != 0) { slots_[place_of(slot.key)] = slot; }
    }
  }

  std::vector<Slot> slots_{};
  std::size_t size_ = 0;
};

}  // namespace preheat
