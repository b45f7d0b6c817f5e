#include "master/file_output.h"

#include <gtest/gtest.h>
#include <sys/stat.h>

#include <cstdlib>
#include <fstream>
#include <iterator>
#include <string>

namespace preheat {
namespace {

namespace fs = std::filesystem;

class FileOutput : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = (fs::temp_directory_path() / "preheat_output_XXXXXX").string();
    folder_ = ::mkdtemp(name.data());
  }
  void TearDown() override { fs::remove_all(folder_); }

  [[nodiscard]] std::size_t files_in_folder() const {
    return static_cast<std::size_t>(
        std::distance(fs::directory_iterator(folder_), fs::directory_iterator()));
  }
  static std::string content_of(const fs::path& file) {
    std::ifstream stream(file, std::ios::binary);
    return {std::istreambuf_iterator<char>(stream), {}};
  }

  fs::path folder_{};
};

TEST_F(FileOutput, ReplacesTheFileWhole) {
  const fs::path file = folder_ / "image.png";

  ASSERT_TRUE(write_output(file, "a longer first content").has_value());
  ASSERT_TRUE(write_output(file, "second").has_value());

  EXPECT_EQ(content_of(file), "second");
  EXPECT_EQ(files_in_folder(), 1U);
}

TEST_F(FileOutput, TheCheckLeavesNothingBehindAndTouchesNothing) {
  const fs::path file = folder_ / "image.png";
  ASSERT_TRUE(write_output(file, "old").has_value());

  ASSERT_TRUE(check_output(file).has_value());

  EXPECT_EQ(content_of(file), "old");
  EXPECT_EQ(files_in_folder(), 1U);
}

TEST_F(FileOutput, AMissingFolderAndAFolderOfThatNameAreUnwritable) {
  for (const fs::path& file : {folder_ / "missing" / "image.png", folder_, fs::path()}) {
    const auto checked = check_output(file);
    ASSERT_FALSE(checked.has_value()) << file;
    EXPECT_EQ(checked.error().code, ExitCode::kOutputUnwritable);
    EXPECT_NE(checked.error().message.find(file.string()), std::string::npos);
    EXPECT_FALSE(write_output(file, "content").has_value());
  }
}

TEST_F(FileOutput, OthersMayReadTheFileAsTheUmaskAllows) {
  const fs::path file = folder_ / "image.png";
  const mode_t mask = ::umask(0022);
  ASSERT_TRUE(write_output(file, "content").has_value());
  ::umask(mask);

  struct stat status {};
  ASSERT_EQ(::stat(file.c_str(), &status), 0);

  EXPECT_EQ(status.st_mode & 0777U, 0644U);
}

}  // namespace
}  // namespace preheat
