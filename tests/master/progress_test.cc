#include "master/progress.h"

#include <gtest/gtest.h>

#include <cstdio>
#include <memory>
#include <string>

namespace preheat {
namespace {

MasterProgress half_way() {
  MasterProgress progress;
  progress.tiles_done = 32;
  progress.tiles_total = 64;
  progress.workers = 2;
  progress.rays = 20'000'000;
  progress.hit_rate = 0.971;
  progress.seconds = 10.0;
  return progress;
}

struct CloseFile {
  void operator()(std::FILE* file) const { std::fclose(file); }
};

// What the printer writes for a sequence of moments.
std::string printed(bool is_terminal, const std::vector<double>& moments) {
  const std::unique_ptr<std::FILE, CloseFile> file(std::tmpfile());
  ProgressPrinter printer(file.get(), is_terminal);
  for (const double seconds : moments) {
    MasterProgress progress = half_way();
    progress.seconds = seconds;
    printer.update(progress);
  }
  printer.finish();
  std::rewind(file.get());
  std::string text(4096, '\0');
  text.resize(std::fread(text.data(), 1, text.size(), file.get()));
  return text;
}

TEST(FormatProgress, SaysAllThatIsKnown) {
  EXPECT_EQ(format_progress(half_way()),
            " 50% 32/64 tiles  2.00 Mray/s  hit 97.1%  2 workers  0:10 left");
}

TEST(FormatProgress, LeavesOutWhatIsNotKnown) {
  MasterProgress progress;
  progress.tiles_total = 64;
  progress.workers = 1;

  EXPECT_EQ(format_progress(progress), "  0% 0/64 tiles  1 worker");
}

TEST(FormatProgress, CountsHours) {
  MasterProgress progress = half_way();
  progress.seconds = 7325.0;

  EXPECT_NE(format_progress(progress).find("2:02:05 left"), std::string::npos);
}

TEST(ProgressPrinter, WritesAPlainLineEveryTenSecondsIntoAFile) {
  const std::string text = printed(false, {0.1, 5.0, 9.9, 10.0, 10.1, 19.9, 20.1});

  EXPECT_EQ(std::count(text.begin(), text.end(), '\n'), 2);
  EXPECT_EQ(text.find('\r'), std::string::npos);
}

TEST(ProgressPrinter, RedrawsOneLineOnATerminalAndClearsIt) {
  const std::string text = printed(true, {0.1, 0.2});

  EXPECT_EQ(std::count(text.begin(), text.end(), '\n'), 0);
  EXPECT_TRUE(text.ends_with("\r\x1b[K"));
}

}  // namespace
}  // namespace preheat
