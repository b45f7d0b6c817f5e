#include "master/endpoint_file.h"

#include <gtest/gtest.h>

#include "tests/scenes/scratch_folder.h"

namespace preheat {
namespace {

TEST(EndpointFile, NamesTheMachineInPlaceOfAllInterfaces) {
  struct Case {
    const char* bound;
    const char* reachable;
  };
  for (const Case& c :
       {Case{"tcp://0.0.0.0:4000", "tcp://node7:4000"}, Case{"tcp://[::]:4000", "tcp://node7:4000"},
        Case{"tcp://*:4000", "tcp://node7:4000"},
        Case{"tcp://10.0.0.1:4000", "tcp://10.0.0.1:4000"},
        Case{"tcp://127.0.0.1:4000", "tcp://127.0.0.1:4000"}}) {
    EXPECT_EQ(reachable(*parse_endpoint(c.bound), "node7").text(), c.reachable) << c.bound;
  }
}

TEST(EndpointFile, IsOneLineThatIsAnAddress) {
  const test::ScratchFolder folder;

  ASSERT_TRUE(write_endpoint(folder / "endpoint", "tcp://127.0.0.1:4000").has_value());
  EXPECT_EQ(test::read_file(folder / "endpoint"), "tcp://127.0.0.1:4000\n");
  EXPECT_EQ(folder.file_count(), 1U);

  const auto missing = write_endpoint(folder / "no/endpoint", "tcp://127.0.0.1:4000");
  ASSERT_FALSE(missing.has_value());
  EXPECT_EQ(missing.error().code, ExitCode::kOutputUnwritable);
  EXPECT_TRUE(write_endpoint("", "tcp://127.0.0.1:4000").has_value());
}

}  // namespace
}  // namespace preheat
