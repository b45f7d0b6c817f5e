#include "common/keys.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstdlib>
#include <fstream>
#include <functional>
#include <iterator>

namespace preheat {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class KeyFiles : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = (fs::temp_directory_path() / "preheat_keys_XXXXXX").string();
    ASSERT_NE(::mkdtemp(name.data()), nullptr);
    scratch_ = name;
    ASSERT_TRUE(make_keys(folder()).has_value());
  }
  void TearDown() override { fs::remove_all(scratch_); }

  [[nodiscard]] fs::path folder() const { return scratch_ / "keys"; }
  [[nodiscard]] fs::path secret() const { return folder() / "master" / "master.key"; }
  [[nodiscard]] fs::path listed() const {
    return folder() / "master" / "authorized_workers" / "worker.pub";
  }
  static std::string content(const fs::path& file) {
    std::ifstream stream(file);
    return {std::istreambuf_iterator<char>(stream), {}};
  }
  static void write(const fs::path& file, const std::string& text) {
    std::ofstream(file, std::ios::trunc) << text;
  }
  static unsigned mode_of(const fs::path& file) {
    struct stat state {};
    EXPECT_EQ(::stat(file.c_str(), &state), 0) << file;
    return state.st_mode & 0777U;
  }

  fs::path scratch_{};
};

TEST_F(KeyFiles, FitTogether) {
  const auto master = load_keys(folder(), KeyRole::kMaster);
  const auto worker = load_keys(folder(), KeyRole::kWorker);

  ASSERT_TRUE(master.has_value()) << master.error().message;
  ASSERT_TRUE(worker.has_value()) << worker.error().message;
  EXPECT_EQ(worker->master, master->own.public_key);
  EXPECT_EQ(master->workers, std::vector{worker->own.public_key});
  EXPECT_NE(master->own.public_key, worker->own.public_key);
}

TEST_F(KeyFiles, AreForTheirOwnerOnly) {
  EXPECT_EQ(mode_of(folder()), 0700U);
  EXPECT_EQ(mode_of(folder() / "master"), 0700U);
  EXPECT_EQ(mode_of(folder() / "worker"), 0700U);
  EXPECT_EQ(mode_of(secret()), 0600U);
  EXPECT_EQ(mode_of(folder() / "worker" / "worker.key"), 0600U);
}

TEST_F(KeyFiles, AreNeverOverwritten) {
  const std::string before = content(secret());

  const auto again = make_keys(folder());

  ASSERT_FALSE(again.has_value());
  EXPECT_EQ(again.error().code, ExitCode::kOutputUnwritable);
  EXPECT_THAT(again.error().message, HasSubstr(secret().string()));
  EXPECT_EQ(content(secret()), before);
}

TEST_F(KeyFiles, AnyOneOfThemIsEnoughToRefuse) {
  const fs::path other = scratch_ / "other";
  fs::create_directories(other / "worker");
  fs::permissions(other, fs::perms::owner_all);
  write(other / "worker" / "master.pub", "mine\n");

  const auto made = make_keys(other);

  ASSERT_FALSE(made.has_value());
  EXPECT_THAT(made.error().message, HasSubstr("master.pub"));
  EXPECT_FALSE(fs::exists(other / "master"));
  EXPECT_FALSE(has_keys(other));
}

TEST_F(KeyFiles, TheListMayNameMoreWorkersOrNone) {
  const fs::path other = scratch_ / "other";
  ASSERT_TRUE(make_keys(other).has_value());
  fs::copy_file(other / "master" / "authorized_workers" / "worker.pub",
                listed().parent_path() / "attic.pub");

  EXPECT_EQ(load_authorized_workers(folder())->size(), 2U);
  fs::remove(listed());
  fs::remove(listed().parent_path() / "attic.pub");
  EXPECT_EQ(load_authorized_workers(folder())->size(), 0U);
}

// What is done to a file, and what the error must name beside the file.
struct Harm {
  const char* name;
  std::function<void(const fs::path&)> act;
  const char* named;
};

class HarmedSecret : public KeyFiles, public ::testing::WithParamInterface<Harm> {};

TEST_P(HarmedSecret, IsRefusedByName) {
  GetParam().act(secret());

  const auto keys = load_keys(folder(), KeyRole::kMaster);

  ASSERT_FALSE(keys.has_value());
  EXPECT_EQ(keys.error().code, ExitCode::kUsage);
  EXPECT_THAT(keys.error().message, HasSubstr(secret().string()));
  EXPECT_THAT(keys.error().message, HasSubstr(GetParam().named));
}

void rewrite(const fs::path& file, const std::string& text) {
  std::ofstream(file, std::ios::trunc) << text;
}

INSTANTIATE_TEST_SUITE_P(
    Harms, HarmedSecret,
    ::testing::Values(
        Harm{"ReadableByOthers",
             [](const fs::path& file) { ASSERT_EQ(::chmod(file.c_str(), 0644), 0); }, "mode 0644"},
        Harm{"ReadableByTheGroup",
             [](const fs::path& file) { ASSERT_EQ(::chmod(file.c_str(), 0640), 0); }, "mode 0640"},
        Harm{"Missing", [](const fs::path& file) { fs::remove(file); }, "No such file"},
        Harm{"SymbolicLink",
             [](const fs::path& file) {
               fs::rename(file, file.string() + ".real");
               fs::create_symlink(file.string() + ".real", file);
             },
             "symbolic link"},
        Harm{"Fifo",
             [](const fs::path& file) {
               fs::remove(file);
               ASSERT_EQ(::mkfifo(file.c_str(), 0600), 0);
             },
             "no regular file"},
        Harm{"Empty", [](const fs::path& file) { rewrite(file, ""); }, "40 characters"},
        Harm{"Truncated",
             [](const fs::path& file) { fs::resize_file(file, fs::file_size(file) - 5); },
             "40 characters"},
        Harm{"TooLong", [](const fs::path& file) { rewrite(file, std::string(100000, 'x')); },
             "40 characters"},
        Harm{"OfAWorker",
             [](const fs::path& file) {
               fs::copy_file(file.parent_path().parent_path() / "worker" / "worker.key", file,
                             fs::copy_options::overwrite_existing);
             },
             "preheat-master-secret-1"},
        Harm{"NotZ85",
             [](const fs::path& file) {
               rewrite(file, "preheat-master-secret-1 " + std::string(40, '"') + "\n");
             },
             "damaged"},
        Harm{"OfTheManual",
             [](const fs::path& file) {
               rewrite(file, "preheat-master-secret-1 JTKVSB%%)wK0E.X)V>+}o?pNmC{O&4W4b!Ni{Lh6\n");
             },
             "everybody knows"}),
    [](const auto& harm) { return harm.param.name; });

TEST_F(KeyFiles, ASecretOfAnotherUserIsRefused) {
  if (::geteuid() != 0) { GTEST_SKIP() << "only root can give a file away"; }
  ASSERT_EQ(::chown(secret().c_str(), 10001, 10001), 0);

  const auto keys = load_keys(folder(), KeyRole::kMaster);

  ASSERT_FALSE(keys.has_value());
  EXPECT_EQ(keys.error().code, ExitCode::kUsage);
  EXPECT_THAT(keys.error().message, HasSubstr(secret().string()));
  EXPECT_THAT(keys.error().message, HasSubstr("user 10001"));
}

TEST_F(KeyFiles, WhatOthersMayReplaceIsNotBelieved) {
  const fs::path master_pub = folder() / "worker" / "master.pub";
  ASSERT_EQ(::chmod(master_pub.c_str(), 0666), 0);
  ASSERT_EQ(::chmod(listed().parent_path().c_str(), 0777), 0);

  const auto worker = load_keys(folder(), KeyRole::kWorker);
  const auto master = load_keys(folder(), KeyRole::kMaster);

  ASSERT_FALSE(worker.has_value());
  EXPECT_THAT(worker.error().message, HasSubstr(master_pub.string()));
  EXPECT_THAT(worker.error().message, HasSubstr("mode 0666"));
  ASSERT_FALSE(master.has_value());
  EXPECT_THAT(master.error().message, HasSubstr("authorized_workers"));
}

TEST_F(KeyFiles, AnAllowListTellsMasterFromWorkerAndForgetsWhoIsStruckOff) {
  const Keys keys = *load_keys(folder(), KeyRole::kMaster);
  AllowList list{keys};

  EXPECT_EQ(list.role_of(keys.own.public_key), KeyRole::kMaster);
  EXPECT_EQ(list.role_of(keys.workers.front()), KeyRole::kWorker);
  EXPECT_EQ(list.role_of(std::string(40, '0')), std::nullopt);
  EXPECT_EQ(list.role_of(""), std::nullopt);

  list.set_workers({});

  EXPECT_EQ(list.role_of(keys.workers.front()), std::nullopt);
  EXPECT_EQ(list.role_of(keys.own.public_key), KeyRole::kMaster);
}

}  // namespace
}  // namespace preheat
