#include "common/keys.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <string.h>  // explicit_bzero
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <system_error>
#include <utility>

#include "common/check.h"
#include "common/zmq_transport.h"

namespace preheat {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kAuthorizedMax = 10000;

// What stands before the key, so that no file is taken for another.
constexpr std::string_view kMasterSecret = "preheat-master-secret-1 ";
constexpr std::string_view kMasterPublic = "preheat-master-public-1 ";
constexpr std::string_view kWorkerSecret = "preheat-worker-secret-1 ";
constexpr std::string_view kWorkerPublic = "preheat-worker-public-1 ";

// Printed in zmq_curve(7), from where they find their way into programs.
constexpr std::array<std::string_view, 4> kKeysOfTheManual = {
    "Yne@$w-vo<fVvi]a<NY6T1ed:M$fCG*[IaLV{hID", "D:)Q[IlAW!ahhC2ac:9*A}h:p?([4%wOTJ%JR%cs",
    "rq:rM>}U?@Lns47E1%kR.o@n%FcmmsL/@{H8]yf7", "JTKVSB%%)wK0E.X)V>+}o?pNmC{O&4W4b!Ni{Lh6"};

fs::path master_key(const fs::path& folder) { return folder / "master" / "master.key"; }
fs::path authorized(const fs::path& folder) { return folder / "master" / "authorized_workers"; }
fs::path worker_key(const fs::path& folder) { return folder / "worker" / "worker.key"; }
fs::path master_pub(const fs::path& folder) { return folder / "worker" / "master.pub"; }

std::array<fs::path, 4> files_of(const fs::path& folder) {
  return {master_key(folder), authorized(folder) / "worker.pub", worker_key(folder),
          master_pub(folder)};
}

std::string reason_of(int error_number) { return std::generic_category().message(error_number); }

tl::unexpected<Error> refuse(const fs::path& file, const std::string& why) {
  return fail(ExitCode::kUsage, fmt::format("key file {}: {}", file.string(), why));
}

// A descriptor that closes itself, and bytes that wipe themselves.
class File {
 public:
  explicit File(int descriptor) : descriptor_(descriptor) {}
  ~File() {
    if (descriptor_ >= 0) { ::close(descriptor_); }
  }
  File(const File&) = delete;
  File& operator=(const File&) = delete;
  [[nodiscard]] int get() const { return descriptor_; }

 private:
  int descriptor_;
};

struct WipedBytes {
  std::array<char, 256> bytes{};
  std::size_t count = 0;
  WipedBytes() = default;
  WipedBytes(const WipedBytes&) = delete;
  WipedBytes& operator=(const WipedBytes&) = delete;
  ~WipedBytes() { ::explicit_bzero(bytes.data(), bytes.size()); }
  [[nodiscard]] std::string_view text() const { return {bytes.data(), count}; }
};

// Others must not have read a secret nor written anything that we believe.
Result<void> check_owner(const fs::path& file, const struct stat& state, bool secret) {
  const auto mode = static_cast<unsigned>(state.st_mode & 07777U);
  if (state.st_uid != ::geteuid() && (secret || state.st_uid != 0)) {
    return refuse(file, fmt::format("it belongs to user {}, not to user {} who runs this program",
                                    state.st_uid, ::geteuid()));
  }
  if (secret && (mode & 077U) != 0) {
    return refuse(file,
                  fmt::format("mode {:04o} lets others use it; change it to 0600 (chmod 600), or "
                              "make new keys if others may have read it",
                              mode));
  }
  if ((mode & 022U) != 0) {
    return refuse(file, fmt::format("mode {:04o} lets others replace it; take that away (chmod "
                                    "go-w)",
                                    mode));
  }
  return {};
}

Result<void> check_folder(const fs::path& folder) {
  struct stat state {};
  if (::stat(folder.c_str(), &state) != 0) { return refuse(folder, reason_of(errno)); }
  return check_owner(folder, state, /*secret=*/false);
}

Result<void> read_all(const fs::path& file, bool secret, WipedBytes& into) {
  // Not blocking, or a FIFO would hold us up for ever.
  const File opened{::open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK)};
  if (opened.get() < 0) {
    return refuse(file, errno == ELOOP ? "it is a symbolic link" : reason_of(errno));
  }
  struct stat state {};
  if (::fstat(opened.get(), &state) != 0) { return refuse(file, reason_of(errno)); }
  if (!S_ISREG(state.st_mode)) { return refuse(file, "it is no regular file"); }
  if (auto fine = check_owner(file, state, secret); !fine) { return fine; }
  ssize_t got = 0;
  do {
    got = ::read(opened.get(), into.bytes.data(), into.bytes.size());
  } while (got < 0 && errno == EINTR);
  if (got < 0) { return refuse(file, reason_of(errno)); }
  into.count = static_cast<std::size_t>(got);
  return {};
}

// The key behind `prefix`, still within `bytes`.
Result<std::string_view> key_in(const fs::path& file, std::string_view prefix,
                                const WipedBytes& bytes) {
  std::string_view text = bytes.text();
  if (text.ends_with('\n')) { text.remove_suffix(1); }
  if (!text.starts_with(prefix) || text.size() != prefix.size() + kKeyChars) {
    return refuse(file, fmt::format("it is no \"{}\" followed by a key of {} characters",
                                    prefix.substr(0, prefix.size() - 1), kKeyChars));
  }
  text.remove_prefix(prefix.size());
  if (std::find(kKeysOfTheManual.begin(), kKeysOfTheManual.end(), text) != kKeysOfTheManual.end()) {
    return refuse(file, "it is the example key of ZeroMQ's manual, which everybody knows");
  }
  return text;
}

Result<KeyPair> load_secret(const fs::path& file, std::string_view prefix) {
  WipedBytes bytes;
  if (auto read = read_all(file, /*secret=*/true, bytes); !read) {
    return tl::unexpected(read.error());
  }
  const Result<std::string_view> key = key_in(file, prefix, bytes);
  if (!key) { return tl::unexpected(key.error()); }
  KeyPair pair{{}, SecretKey{*key}};
  const std::optional<PublicKey> public_key = public_key_of(pair.secret);
  if (!public_key) { return refuse(file, "its key is damaged"); }
  pair.public_key = *public_key;
  return pair;
}

Result<PublicKey> load_public(const fs::path& file, std::string_view prefix) {
  WipedBytes bytes;
  if (auto read = read_all(file, /*secret=*/false, bytes); !read) {
    return tl::unexpected(read.error());
  }
  const Result<std::string_view> key = key_in(file, prefix, bytes);
  if (!key) { return tl::unexpected(key.error()); }
  if (!is_key(*key)) { return refuse(file, "its key is damaged"); }
  return PublicKey(*key);
}

tl::unexpected<Error> unwritable(const fs::path& what, int error_number) {
  return fail(ExitCode::kOutputUnwritable,
              fmt::format("cannot write {}: {}", what.string(), reason_of(error_number)));
}

Result<void> make_folder(const fs::path& folder) {
  if (::mkdir(folder.c_str(), 0700) != 0 && errno != EEXIST) { return unwritable(folder, errno); }
  return check_folder(folder);
}

Result<void> write_new(const fs::path& file, std::string_view prefix, const char* key,
                       mode_t mode) {
  const File created{
      ::open(file.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, mode)};
  if (created.get() < 0) { return unwritable(file, errno); }
  WipedBytes bytes;
  bytes.count = static_cast<std::size_t>(
      fmt::format_to_n(bytes.bytes.data(), bytes.bytes.size(), "{}{}\n", prefix, key).size);
  const auto written = ::write(created.get(), bytes.bytes.data(), bytes.count);
  if (written != static_cast<ssize_t>(bytes.count) || ::fsync(created.get()) != 0) {
    const int error = written < 0 || errno != 0 ? errno : ENOSPC;
    ::unlink(file.c_str());
    return unwritable(file, error);
  }
  return {};
}

}  // namespace

SecretKey::SecretKey(std::string_view text) {
  CHECK(text.size() == kKeyChars);
  std::copy(text.begin(), text.end(), text_.begin());
}

SecretKey::SecretKey(SecretKey&& other) noexcept : text_(other.text_) {
  ::explicit_bzero(other.text_.data(), other.text_.size());
}

SecretKey& SecretKey::operator=(SecretKey&& other) noexcept {
  if (this != &other) {
    text_ = other.text_;
    ::explicit_bzero(other.text_.data(), other.text_.size());
  }
  return *this;
}

SecretKey::~SecretKey() { ::explicit_bzero(text_.data(), text_.size()); }

bool has_keys(const fs::path& folder) {
  const auto files = files_of(folder);
  std::error_code ignored;
  return std::all_of(files.begin(), files.end(),
                     [&](const fs::path& file) { return fs::exists(file, ignored); });
}

Result<void> make_keys(const fs::path& folder) {
  const auto files = files_of(folder);
  for (const fs::path& file : files) {
    std::error_code ignored;
    if (fs::symlink_status(file, ignored).type() != fs::file_type::not_found) {
      return fail(ExitCode::kOutputUnwritable,
                  fmt::format("{} is there already: keys are never overwritten", file.string()));
    }
  }
  for (const fs::path& part : {folder, folder / "master", authorized(folder), folder / "worker"}) {
    if (auto made = make_folder(part); !made) { return made; }
  }
  const KeyPair master = make_key_pair();
  const KeyPair worker = make_key_pair();
  struct Entry {
    std::string_view prefix;
    const char* key;
    mode_t mode;
  };
  const std::array<Entry, 4> entries = {Entry{kMasterSecret, master.secret.c_str(), 0600},
                                        Entry{kWorkerPublic, worker.public_key.c_str(), 0644},
                                        Entry{kWorkerSecret, worker.secret.c_str(), 0600},
                                        Entry{kMasterPublic, master.public_key.c_str(), 0644}};
  for (std::size_t i = 0; i < files.size(); ++i) {
    const auto written = write_new(files[i], entries[i].prefix, entries[i].key, entries[i].mode);
    if (written) { continue; }
    while (i-- > 0) { ::unlink(files[i].c_str()); }
    return written;
  }
  return {};
}

Result<std::vector<PublicKey>> load_authorized_workers(const fs::path& folder) {
  const fs::path listed = authorized(folder);
  if (auto fine = check_folder(listed); !fine) { return tl::unexpected(fine.error()); }
  std::error_code error;
  std::vector<fs::path> files;
  for (fs::directory_iterator at{listed, error}, end; !error && at != end; at.increment(error)) {
    if (at->path().extension() == ".pub") { files.push_back(at->path()); }
    if (files.size() > kAuthorizedMax) {
      return refuse(listed, fmt::format("more than {} keys", kAuthorizedMax));
    }
  }
  if (error) { return refuse(listed, error.message()); }
  std::sort(files.begin(), files.end());
  std::vector<PublicKey> keys;
  for (const fs::path& file : files) {
    Result<PublicKey> key = load_public(file, kWorkerPublic);
    if (!key) { return tl::unexpected(key.error()); }
    keys.push_back(*std::move(key));
  }
  return keys;
}

Result<Keys> load_keys(const fs::path& folder, KeyRole role) {
  const bool is_master = role == KeyRole::kMaster;
  const fs::path own = is_master ? master_key(folder) : worker_key(folder);
  Result<KeyPair> pair = load_secret(own, is_master ? kMasterSecret : kWorkerSecret);
  if (!pair) { return tl::unexpected(pair.error()); }
  if (auto fine = check_folder(own.parent_path()); !fine) { return tl::unexpected(fine.error()); }
  Keys keys{role, *std::move(pair), {}, {}};
  if (is_master) {
    keys.master = keys.own.public_key;
    auto workers = load_authorized_workers(folder);
    if (!workers) { return tl::unexpected(workers.error()); }
    keys.workers = *std::move(workers);
  } else {
    auto master = load_public(master_pub(folder), kMasterPublic);
    if (!master) { return tl::unexpected(master.error()); }
    keys.master = *std::move(master);
    keys.workers = {keys.own.public_key};
  }
  return keys;
}

AllowList::AllowList(const Keys& keys) {
  if (keys.role == KeyRole::kMaster) { master_ = keys.own.public_key; }
  set_workers(keys.workers);
}

std::optional<KeyRole> AllowList::role_of(std::string_view public_key) const {
  const std::lock_guard lock{mutex_};
  const auto entry = roles_.find(public_key);
  if (entry == roles_.end()) { return std::nullopt; }
  return entry->second;
}

void AllowList::set_workers(const std::vector<PublicKey>& workers) {
  const std::lock_guard lock{mutex_};
  roles_.clear();
  for (const PublicKey& worker : workers) { roles_[worker] = KeyRole::kWorker; }
  if (master_) { roles_[*master_] = KeyRole::kMaster; }
}

}  // namespace preheat
