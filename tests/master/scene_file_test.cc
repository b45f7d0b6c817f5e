#include "master/scene_file.h"

#include <gtest/gtest.h>
#include <sys/stat.h>

#include <string>

#include "tests/master/scene_files.h"

namespace preheat {
namespace {

TEST(MappedFile, ReadsAFile) {
  const TemporaryFolder folder;

  const auto file = MappedFile::open(folder.write("a.txt", "hello"));

  ASSERT_TRUE(file);
  EXPECT_EQ(file->text(), "hello");
}

TEST(MappedFile, MapsAnEmptyFileToNoBytes) {
  const TemporaryFolder folder;

  const auto file = MappedFile::open(folder.write("a.txt", ""));

  ASSERT_TRUE(file);
  EXPECT_TRUE(file->bytes().empty());
}

TEST(MappedFile, RefusesWhatIsNoRegularFile) {
  const TemporaryFolder folder;
  const auto pipe = folder.path() / "pipe";
  ASSERT_EQ(::mkfifo(pipe.c_str(), 0600), 0);

  EXPECT_EQ(MappedFile::open(folder.path() / "missing").error().code, ExitCode::kSceneRejected);
  EXPECT_NE(MappedFile::open(folder.path()).error().message.find("is a folder"), std::string::npos);
  EXPECT_NE(MappedFile::open(pipe).error().message.find("not a regular file"), std::string::npos);
  EXPECT_NE(MappedFile::open("/dev/zero").error().message.find("not a regular file"),
            std::string::npos);
}

TEST(DecodePercent, DecodesEscapesOnceAndRefusesBrokenOnes) {
  EXPECT_EQ(decode_percent("a%20b%2Ebin").value(), "a b.bin");
  EXPECT_EQ(decode_percent("%252e").value(), "%2e");
  EXPECT_FALSE(decode_percent("a%2"));
  EXPECT_FALSE(decode_percent("a%"));
  EXPECT_FALSE(decode_percent("%zz"));
  EXPECT_FALSE(decode_percent("%+1"));
}

TEST(ResolveBelow, AcceptsPathsInsideTheFolder) {
  const TemporaryFolder folder;
  const auto scene = folder.write("scene.gltf", "{}");
  const auto inside = folder.write("parts/a b.bin", "x");

  EXPECT_EQ(resolve_below(scene, "parts/a b.bin").value(), std::filesystem::canonical(inside));
  EXPECT_TRUE(resolve_below(scene, "./parts/./a b.bin"));
  EXPECT_TRUE(resolve_below(scene, "missing/b.bin"));
}

struct EscapeCase {
  const char* name;
  std::string reference;
};

class ResolveBelowRefuses : public ::testing::TestWithParam<EscapeCase> {};

TEST_P(ResolveBelowRefuses, PathsOutOfTheFolder) {
  const TemporaryFolder folder;
  const auto scene = folder.write("inner/scene.gltf", "{}");
  folder.write("outside.bin", "x");
  folder.write("inner2/outside.bin", "x");
  std::filesystem::create_symlink("../outside.bin", folder.path() / "inner/link.bin");
  std::filesystem::create_directory_symlink("../inner2", folder.path() / "inner/folder");

  const auto path = resolve_below(scene, GetParam().reference);

  ASSERT_FALSE(path) << path->string();
  EXPECT_EQ(path.error().code, ExitCode::kSceneRejected);
}

INSTANTIATE_TEST_SUITE_P(, ResolveBelowRefuses,
                         ::testing::Values(EscapeCase{"Parent", "../outside.bin"},
                                           EscapeCase{"ParentInTheMiddle", "a/../../outside.bin"},
                                           EscapeCase{"ParentThatStaysInside", "a/../b.bin"},
                                           EscapeCase{"ParentAlone", ".."},
                                           EscapeCase{"Absolute", "/etc/passwd"},
                                           EscapeCase{"Backslash", "..\\outside.bin"},
                                           EscapeCase{"Drive", "C:/outside.bin"},
                                           EscapeCase{"FileScheme", "file:///etc/passwd"},
                                           EscapeCase{"WebScheme", "https://example.org/a.bin"},
                                           EscapeCase{"Nul", std::string("a\0b", 3)},
                                           EscapeCase{"Empty", ""},
                                           EscapeCase{"LinkOut", "link.bin"},
                                           EscapeCase{"FolderLinkOut", "folder/outside.bin"}),
                         [](const auto& parameter) { return std::string(parameter.param.name); });

TEST(ResolveBelow, FollowsALinkThatStaysInside) {
  const TemporaryFolder folder;
  const auto scene = folder.write("scene.gltf", "{}");
  const auto inside = folder.write("data/a.bin", "x");
  std::filesystem::create_symlink("data/a.bin", folder.path() / "link.bin");

  EXPECT_EQ(resolve_below(scene, "link.bin").value(), std::filesystem::canonical(inside));
}

}  // namespace
}  // namespace preheat
