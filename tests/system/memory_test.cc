// What a worker takes of its machine beside the cache: as much as the README tells.
#include <algorithm>
#include <fstream>
#include <iostream>
#include <string>

#include "tests/system/render_fixture.h"

namespace preheat {
namespace {

constexpr std::uint64_t kMiB = std::uint64_t{1} << 20U;

// The most that a process has had resident; 0 once it has ended.
std::uint64_t peak_bytes_of(pid_t pid) {
  std::ifstream status("/proc/" + std::to_string(pid) + "/status");
  for (std::string word; status >> word;) {
    if (word != "VmHWM:") { continue; }
    std::uint64_t kibibytes = 0;
    status >> kibibytes;
    return kibibytes << 10U;
  }
  return 0;
}

class WorkerMemory : public RenderFixture {
 protected:
  static void SetUpTestSuite() { make_store("preheat_memory"); }
};

TEST_F(WorkerMemory, StaysWithinCacheAndWhatTheReadmeAddsForEachThread) {
  constexpr std::uint64_t kThreads = 2;
  constexpr std::uint64_t kCacheBytes = 2 * kMiB;
  // More paths than are in flight at once, and so little cache that most of them wait.
  Process master{kPreheat,
                 render_arguments("memory", "512x512", "4",
                                  {"--listen", address_, "--cache", std::to_string(kCacheBytes)}),
                 path("memory_master.log")};
  Process worker{kWorker,
                 {"--connect", address_, "--threads", std::to_string(kThreads)},
                 path("memory_worker.log")};

  std::uint64_t peak_bytes = 0;
  while (master.running()) {
    peak_bytes = std::max(peak_bytes, peak_bytes_of(worker.pid()));
    std::this_thread::sleep_for(milliseconds(20));
  }

  ASSERT_EQ(master.wait(), 0) << master.log();
  ASSERT_EQ(worker.wait(), 0) << worker.log();
  const nlohmann::json report = report_of("memory");
  EXPECT_LE(report["cache"]["peak_bytes"], kCacheBytes);
  EXPECT_GT(report["cache"]["misses"], 100'000) << "few paths waited";
  std::cout << "peak " << peak_bytes / kMiB << " MiB\n";
  EXPECT_GT(peak_bytes, kCacheBytes);
  EXPECT_LE(peak_bytes, kCacheBytes + 256 * kMiB + kThreads * 256 * kMiB);
}

}  // namespace
}  // namespace preheat
