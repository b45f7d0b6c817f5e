// CURVE key pairs in files, and who may connect with which.
//
// `preheat keygen DIR` makes two folders, of which each side gets only its own:
//   DIR/master/master.key                      secret, 0600
//   DIR/master/authorized_workers/worker.pub   whom the master lets in; any number of *.pub
//   DIR/worker/worker.key                      secret, 0600
//   DIR/worker/master.pub                      whom the worker believes
// A secret that others could have read, and a public file that others could have replaced, is
// refused: it proves nothing.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "common/result.h"

namespace preheat {

inline constexpr std::size_t kKeyChars = 40;  // 32 bytes in Z85

// Public: 40 characters of Z85.
using PublicKey = std::string;

// The same, but wiped from memory when it goes.
class SecretKey {
 public:
  SecretKey() = default;
  explicit SecretKey(std::string_view text);  // Requires: kKeyChars characters.
  SecretKey(SecretKey&& other) noexcept;
  SecretKey& operator=(SecretKey&& other) noexcept;
  ~SecretKey();
  [[nodiscard]] const char* c_str() const { return text_.data(); }

 private:
  std::array<char, kKeyChars + 1> text_{};
};

struct KeyPair {
  PublicKey public_key{};
  SecretKey secret{};
};

enum class KeyRole : std::uint8_t { kMaster = 0, kWorker = 1 };

struct Keys {
  KeyRole role = KeyRole::kWorker;
  KeyPair own{};
  PublicKey master{};                // the master's; at the master its own
  std::vector<PublicKey> workers{};  // whom a listening socket lets in; at a worker its own key
};

// Makes DIR and the four files above. kOutputUnwritable, and nothing is changed, if one of them
// is there already.
[[nodiscard]] Result<void> make_keys(const std::filesystem::path& folder);

// True if all four files are there.
[[nodiscard]] bool has_keys(const std::filesystem::path& folder);

// kUsage, naming the file and what is wrong with it, if a file is missing, no regular file, of
// another user, open to others, damaged, or a key that the whole world knows.
[[nodiscard]] Result<Keys> load_keys(const std::filesystem::path& folder, KeyRole role);

// Only the public keys in DIR/master/authorized_workers, to be read again while running.
[[nodiscard]] Result<std::vector<PublicKey>> load_authorized_workers(
    const std::filesystem::path& folder);

// Who may enter, as whom. Workers enter to work and know only of work; the master's own key asks
// for the status and does nothing else.
// Threads: any member from any thread.
class AllowList {
 public:
  explicit AllowList(const Keys& keys);
  [[nodiscard]] std::optional<KeyRole> role_of(std::string_view public_key) const;
  // From now on these workers and no others.
  void set_workers(const std::vector<PublicKey>& workers);

 private:
  std::optional<PublicKey> master_{};
  mutable std::mutex mutex_;
  std::map<PublicKey, KeyRole, std::less<>> roles_{};
};

}  // namespace preheat
