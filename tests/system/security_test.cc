// Master and workers with keys, as processes: who takes part, who is told what, and what somebody
// in between gets to read. The image is that of `--local`.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/stat.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <map>
#include <memory>
#include <mutex>
#include <nlohmann/json.hpp>
#include <string_view>

#include "common/codec.h"
#include "common/zmq_transport.h"
#include "tests/system/render_fixture.h"

namespace preheat {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

std::string content(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

// Passes TCP connections on from one loopback address to another, same port, and writes down what
// it sees of both directions.
class Relay {
 public:
  Relay(const std::string& from, const std::string& to, const std::vector<unsigned>& ports)
      : to_(to) {
    for (const unsigned port : ports) {
      const int fd = ::socket(AF_INET, SOCK_STREAM | SOCK_NONBLOCK, 0);
      const int yes = 1;
      ::setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes);
      const sockaddr_in address = at(from, port);
      if (::bind(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0 ||
          ::listen(fd, 16) != 0) {
        ADD_FAILURE() << "no relay on " << from << ":" << port;
      }
      listening_[fd] = port;
    }
    thread_ = std::thread([this] { run(); });
  }
  ~Relay() {
    stop_ = true;
    thread_.join();
    for (const auto& [fd, port] : listening_) { ::close(fd); }
    for (const auto& [fd, other] : joined_) { ::close(fd); }
  }
  Relay(const Relay&) = delete;
  Relay& operator=(const Relay&) = delete;

  [[nodiscard]] std::string seen() const {
    const std::lock_guard lock{mutex_};
    std::string all;
    for (const auto& [fd, bytes] : seen_) { all += bytes; }
    return all;
  }

 private:
  static sockaddr_in at(const std::string& host, unsigned port) {
    sockaddr_in address = loopback(port);
    ::inet_pton(AF_INET, host.c_str(), &address.sin_addr);
    return address;
  }

  void accept_on(int listening, unsigned port) {
    const int here = ::accept(listening, nullptr, nullptr);
    if (here < 0) { return; }
    const int there = ::socket(AF_INET, SOCK_STREAM, 0);
    const sockaddr_in address = at(to_, port);
    if (::connect(there, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) {
      ::close(here);
      ::close(there);
      return;
    }
    joined_[here] = there;
    joined_[there] = here;
  }

  void pass_on(int from) {
    std::array<char, 65536> bytes{};
    const ssize_t got = ::recv(from, bytes.data(), bytes.size(), 0);
    const int to = joined_[from];
    if (got <= 0) {
      for (const int fd : {from, to}) {
        joined_.erase(fd);
        ::close(fd);
      }
      return;
    }
    {
      const std::lock_guard lock{mutex_};
      seen_[from].append(bytes.data(), static_cast<std::size_t>(got));
    }
    for (ssize_t sent = 0; sent < got;) {
      const ssize_t now =
          ::send(to, bytes.data() + sent, static_cast<std::size_t>(got - sent), MSG_NOSIGNAL);
      if (now <= 0) { return; }
      sent += now;
    }
  }

  void run() {
    while (!stop_) {
      std::vector<pollfd> waiting;
      for (const auto& [fd, port] : listening_) { waiting.push_back({fd, POLLIN, 0}); }
      for (const auto& [fd, other] : joined_) { waiting.push_back({fd, POLLIN, 0}); }
      ::poll(waiting.data(), waiting.size(), 20);
      for (const pollfd& ready : waiting) {
        if (ready.revents == 0) { continue; }
        const auto listening = listening_.find(ready.fd);
        if (listening != listening_.end()) {
          accept_on(ready.fd, listening->second);
        } else if (joined_.contains(ready.fd)) {
          pass_on(ready.fd);
        }
      }
    }
  }

  std::string to_;
  std::map<int, unsigned> listening_{};
  std::map<int, int> joined_{};
  mutable std::mutex mutex_{};
  std::map<int, std::string> seen_{};
  std::atomic<bool> stop_{false};
  std::thread thread_{};
};

class Security : public RenderFixture {
 protected:
  static void SetUpTestSuite() {
    make_store("preheat_security");
    run_well("local", render_arguments("local", {"--local"}));
    run_well("keygen", {"keygen", path("keys")});
    run_well("keygen", {"keygen", path("foreign_keys")});
    expected = report_of("local")["image"]["pixels_sha256"];
  }

  static std::vector<std::string> render_arguments(const std::string& name,
                                                   const std::vector<std::string>& more) {
    return RenderFixture::render_arguments(name, "64x48", "2", more);
  }

  std::unique_ptr<Process> start_master(const std::string& name, std::vector<std::string> more) {
    more.insert(more.end(), {"--listen", address_});
    return std::make_unique<Process>(kPreheat, render_arguments(name, more), path(name + ".log"));
  }
  static std::unique_ptr<Process> start_worker(const std::string& name, const std::string& address,
                                               const std::vector<std::string>& more) {
    std::vector<std::string> arguments{"--connect", address};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return std::make_unique<Process>(kWorker, arguments, path(name + "_worker.log"));
  }
  // Until the master listens; false if it ended before.
  static bool listens(Process& master) {
    while (master.log().find("event=listening") == std::string::npos) {
      if (!master.running()) { return false; }
      std::this_thread::sleep_for(milliseconds(5));
    }
    return true;
  }
  static void expect_whole(const std::string& name, Process& master) {
    ASSERT_EQ(master.wait(), 0) << master.log();
    EXPECT_EQ(report_of(name)["image"]["pixels_sha256"], expected);
  }
};

TEST_F(Security, WithKeysTheImageIsTheSame) {
  const auto master = start_master("keys", {"--keys", path("keys")});
  const auto worker = start_worker("keys", address_, {"--keys", path("keys")});

  expect_whole("keys", *master);
  EXPECT_EQ(worker->wait(), 0) << worker->log();
  EXPECT_EQ(report_of("keys")["settings"]["security"], "curve");
}

TEST_F(Security, StartedWorkersGetTheKeysOfTheirMaster) {
  Process master{kPreheat, render_arguments("children", {"--workers", "2", "--keys", path("keys")}),
                 path("children.log")};

  expect_whole("children", master);
  EXPECT_EQ(report_of("children")["settings"]["security"], "curve");
}

TEST_F(Security, AForeignAddressWithoutKeysIsRefusedWithBothWaysOut) {
  const auto both_ways_out =
      AllOf(HasSubstr("--keys"), HasSubstr("keygen"), HasSubstr("--insecure-no-auth"));
  Process master{kPreheat, render_arguments("foreign", {"--listen", "tcp://0.0.0.0:*"}),
                 path("foreign.log")};
  const auto worker = start_worker("foreign", "tcp://192.0.2.1:4000", {});
  Process status{kPreheat, {"status", "--connect", "tcp://192.0.2.1:4000"}, path("foreign_s.log")};

  EXPECT_EQ(master.wait(), 2);
  EXPECT_THAT(master.log(), AllOf(HasSubstr("tcp://0.0.0.0:*"), both_ways_out));
  EXPECT_EQ(worker->wait(), 2);
  EXPECT_THAT(worker->log(), AllOf(HasSubstr("tcp://192.0.2.1:4000"), both_ways_out));
  EXPECT_EQ(status.wait(), 2);
  EXPECT_THAT(status.log(), AllOf(HasSubstr("tcp://192.0.2.1:4000"), both_ways_out));
}

TEST_F(Security, AnOpenDoorIsWarnedOfAndRecorded) {
  const std::string all = "tcp://0.0.0.0:" + std::to_string(port_);
  Process master{kPreheat, render_arguments("open", {"--listen", all, "--insecure-no-auth"}),
                 path("open.log")};
  const auto worker = start_worker("open", address_, {});

  expect_whole("open", master);
  EXPECT_THAT(master.log(), HasSubstr("event=insecure"));
  EXPECT_EQ(report_of("open")["settings"]["security"], "none (--insecure-no-auth)");
  EXPECT_THAT(content(path("open.exr")), HasSubstr("none (--insecure-no-auth)"));
}

TEST_F(Security, KeysOpenAForeignAddress) {
  const std::string all = "tcp://0.0.0.0:" + std::to_string(port_);
  Process master{kPreheat, render_arguments("reach", {"--listen", all, "--keys", path("keys")}),
                 path("reach.log")};
  const auto worker = start_worker("reach", address_, {"--keys", path("keys")});

  expect_whole("reach", master);
  EXPECT_EQ(master.log().find("event=insecure"), std::string::npos);
}

TEST_F(Security, TheEndpointFileLeadsWorkersToAPortThatTheSystemChose) {
  Process master{kPreheat,
                 render_arguments("endpoint", {"--listen", "tcp://0.0.0.0:*", "--keys",
                                               path("keys"), "--endpoint-file", path("endpoint")}),
                 path("endpoint.log")};
  ASSERT_TRUE(listens(master)) << master.log();
  while (!fs::exists(path("endpoint")) && master.running()) {
    std::this_thread::sleep_for(milliseconds(5));
  }

  std::string endpoint = content(path("endpoint"));
  ASSERT_THAT(endpoint, ::testing::MatchesRegex("tcp://[^:]+:[0-9]+\n"));
  EXPECT_THAT(endpoint, ::testing::Not(HasSubstr("0.0.0.0")));
  // The name need not be known to every machine that runs tests: the port is what was not known.
  endpoint.pop_back();
  const auto worker =
      start_worker("endpoint", "tcp://127.0.0.1" + endpoint.substr(endpoint.rfind(':')),
                   {"--keys", path("keys")});

  expect_whole("endpoint", master);
}

TEST_F(Security, AFloodOfSilentConnectionsLeavesRoomForWorkers) {
  constexpr int kStrangers = 1000;
  std::vector<std::string> arguments =
      render_arguments("flood", {"--listen", address_, "--keys", path("keys")});
  arguments.insert(arguments.begin(), {"-c", "ulimit -S -n 256; exec \"$@\"", "sh", kPreheat});
  Process master{"/bin/sh", arguments, path("flood.log")};
  ASSERT_TRUE(listens(master)) << master.log();

  // What it began with was too little, and it took what it may.
  const std::string limits = content("/proc/" + std::to_string(master.pid()) + "/limits");
  EXPECT_THAT(limits, ::testing::ContainsRegex("Max open files +[0-9]+"));
  EXPECT_THAT(limits, ::testing::Not(::testing::ContainsRegex("Max open files +256 ")));
  std::vector<int> strangers;
  for (int i = 0; i < kStrangers; ++i) { strangers.push_back(connect_raw(port_)); }
  EXPECT_THAT(strangers, ::testing::Not(::testing::Contains(-1)));
  const auto worker = start_worker("flood", address_, {"--keys", path("keys")});
  expect_whole("flood", master);
  for (const int fd : strangers) { ::close(fd); }
}

TEST_F(Security, WhoIsNotTrustedEndsWithAReasonAndTheRenderGoesOn) {
  // A worker key that nobody listed, for the right master.
  fs::create_directories(path("unlisted/worker"));
  fs::permissions(path("unlisted/worker"), fs::perms::owner_all);
  fs::copy_file(path("foreign_keys/worker/worker.key"), path("unlisted/worker/worker.key"));
  fs::copy_file(path("keys/worker/master.pub"), path("unlisted/worker/master.pub"));
  const auto master = start_master("trust", {"--keys", path("keys")});
  ASSERT_TRUE(listens(*master)) << master->log();

  const auto unlisted = start_worker("unlisted", address_, {"--keys", path("unlisted")});
  const auto keyless = start_worker("keyless", address_, {});
  // All keys are another farm's: it cannot even ask.
  const auto foreign =
      start_worker("other", address_, {"--keys", path("foreign_keys"), "--give-up", "3"});
  EXPECT_EQ(unlisted->wait(), 4);
  EXPECT_THAT(unlisted->log(), HasSubstr("does not list this key"));
  EXPECT_EQ(keyless->wait(), 4);
  EXPECT_THAT(keyless->log(), HasSubstr("only one of both sides has keys"));
  EXPECT_EQ(foreign->wait(), 4);
  EXPECT_THAT(foreign->log(), HasSubstr("master.pub"));
  EXPECT_THAT(master->log(), HasSubstr("event=connection_denied"));

  const auto worker = start_worker("trust", address_, {"--keys", path("keys")});
  expect_whole("trust", *master);
  EXPECT_EQ(report_of("trust")["workers"].size(), 1U);
  EXPECT_GE(report_of("trust")["connections_denied"], 1);
}

TEST_F(Security, AKeyThatOthersCanReadIsRefusedByBothPrograms) {
  run_well("keygen", {"keygen", path("loose")});
  ASSERT_EQ(::chmod(path("loose/master/master.key").c_str(), 0644), 0);
  ASSERT_EQ(::chmod(path("loose/worker/worker.key").c_str(), 0640), 0);

  const auto master = start_master("loose", {"--keys", path("loose")});
  const auto worker = start_worker("loose", address_, {"--keys", path("loose")});

  EXPECT_EQ(master->wait(), 2);
  EXPECT_THAT(master->log(), AllOf(HasSubstr(path("loose/master/master.key")), HasSubstr("0644")));
  EXPECT_EQ(worker->wait(), 2);
  EXPECT_THAT(worker->log(), AllOf(HasSubstr(path("loose/worker/worker.key")), HasSubstr("0640")));
}

TEST_F(Security, KeygenNeverOverwritesAndChecksWhatIsThere) {
  const std::string before = content(path("keys/master/master.key"));
  Process again{kPreheat, {"keygen", path("keys")}, path("again.log")};
  Process there{kPreheat, {"keygen", path("keys"), "--if-missing"}, path("there.log")};

  EXPECT_EQ(again.wait(), 6);
  EXPECT_THAT(again.log(), HasSubstr("master.key is there already"));
  EXPECT_EQ(there.wait(), 0) << there.log();
  EXPECT_EQ(content(path("keys/master/master.key")), before);
}

TEST_F(Security, AnAllowListIsReadAgainOnHangup) {
  run_well("keygen", {"keygen", path("growing")});
  const std::string listed = path("growing/master/authorized_workers/worker.pub");
  fs::rename(listed, path("worker.pub"));
  const auto master = start_master("growing", {"--keys", path("growing")});
  ASSERT_TRUE(listens(*master)) << master->log();
  const auto early = start_worker("early", address_, {"--keys", path("growing")});
  EXPECT_EQ(early->wait(), 4) << early->log();

  fs::rename(path("worker.pub"), listed);
  master->signal(SIGHUP);
  while (master->running() && master->log().find("event=keys_reloaded") == std::string::npos) {
    std::this_thread::sleep_for(milliseconds(5));
  }
  const auto late = start_worker("late", address_, {"--keys", path("growing")});

  EXPECT_THAT(master->log(), HasSubstr("event=no_worker_listed"));
  expect_whole("growing", *master);
  EXPECT_EQ(late->wait(), 0) << late->log();
}

TEST_F(Security, StatusIsToldToTheMastersOwnKeyOnly) {
  const auto master = start_master("status", {"--keys", path("keys")});
  ASSERT_TRUE(listens(*master)) << master->log();
  Process asked{kPreheat,
                {"status", "--connect", address_, "--keys", path("keys"), "--timeout", "30",
                 "--json", path("status_answer.json")},
                path("asked.log")};
  EXPECT_EQ(asked.wait(), 0) << asked.log();
  Process foreign{
      kPreheat,
      {"status", "--connect", address_, "--keys", path("foreign_keys"), "--timeout", "1"},
      path("foreign_status.log")};
  EXPECT_EQ(foreign.wait(), 4) << foreign.log();
  Process keyless{kPreheat, {"status", "--connect", address_}, path("keyless_status.log")};
  EXPECT_EQ(keyless.wait(), 4);
  EXPECT_THAT(keyless.log(), HasSubstr("only one of both sides has keys"));

  const auto answer = nlohmann::json::parse(std::ifstream(path("status_answer.json")));
  EXPECT_EQ(answer["phase"], "waiting");
  EXPECT_EQ(answer["tiles"]["done"], 0);
  EXPECT_EQ(answer["tiles"]["total"], 48);  // of 8x8
  EXPECT_EQ(answer["workers"]["here"], 0);
  EXPECT_TRUE(answer["hit_rate"].is_null());

  // A worker's key asks too, and gets to work but no answer.
  Keys keys = *load_keys(path("keys"), KeyRole::kWorker);
  auto allowed = std::make_shared<AllowList>(keys);
  const auto transport = make_zmq_transport(secure_with(std::move(keys), allowed));
  const auto channel = transport->connect(address_, ChannelKind::kControl, random_session());
  while ((*channel)->send({}, encode_frame({}, StatusRequest{}), {}) != SendOutcome::kSent &&
         master->running()) {
    std::this_thread::sleep_for(milliseconds(5));
  }
  const auto worker = start_worker("status", address_, {"--keys", path("keys")});
  expect_whole("status", *master);
  EXPECT_FALSE((*channel)->receive().has_value());
}

TEST_F(Security, StatusWithoutKeysAndWithoutAMaster) {
  Process nobody{kPreheat,
                 {"status", "--connect", "tcp://127.0.0.1:1", "--timeout", "0.5"},
                 path("nobody.log")};
  EXPECT_EQ(nobody.wait(), 4);
  EXPECT_THAT(nobody.log(), HasSubstr("no master answers at tcp://127.0.0.1:1"));

  const auto master = start_master("plain", {});
  ASSERT_TRUE(listens(*master)) << master->log();
  Process status{
      kPreheat, {"status", "--connect", address_, "--timeout", "30"}, path("plain_status.log")};
  EXPECT_EQ(status.wait(), 0);
  EXPECT_THAT(status.log(), AllOf(HasSubstr("phase    waiting"), HasSubstr("tiles    0 of 4")));
  const auto worker = start_worker("plain", address_, {});
  expect_whole("plain", *master);
}

TEST_F(Security, AKeptWorkerServesOneMasterAfterTheOther) {
  const auto worker =
      start_worker("kept", address_, {"--keys", path("keys"), "--keep", "--give-up", "1"});
  for (const char* const name : {"kept1", "kept2"}) {
    const auto master = start_master(name, {"--keys", path("keys")});
    expect_whole(name, *master);
  }

  EXPECT_TRUE(worker->running()) << worker->log();
  worker->signal(SIGTERM);
  EXPECT_EQ(worker->wait(), 143) << worker->log();
}

// One of them at a port of the user's choice, which has to be there for the second master too.
TEST_F(Security, KeptWorkersServeEachOtherUnderEveryMaster) {
  const std::vector<std::string> view{"--size", "160x120", "--spp", "8", "--tile-size", "8"};
  std::vector<std::string> local = view;
  local.emplace_back("--local");
  run_well("whole", render_arguments("whole", local));
  const std::string place = "tcp://127.0.0.2:" + std::to_string(port_);
  const std::vector<std::string> kept{"--keys", path("keys"), "--keep"};
  std::vector<std::string> placed = kept;
  placed.insert(placed.end(), {"--peer-listen", place});
  const auto first = start_worker("first_peer", address_, placed);
  const auto second = start_worker("second_peer", address_, kept);

  for (const char* const name : {"served1", "served2"}) {
    std::vector<std::string> more = view;
    more.insert(more.end(), {"--keys", path("keys"), "--wait-workers", "2", "--cache", "10%"});
    const auto master = start_master(name, more);
    ASSERT_EQ(master->wait(), 0) << master->log();
    const nlohmann::json report = report_of(name);
    EXPECT_EQ(report["image"]["pixels_sha256"], report_of("whole")["image"]["pixels_sha256"]);
    EXPECT_GT(report["sources"]["remote_peer_bytes"], 0);
    EXPECT_EQ(report["sources"]["peer_lies"], 0);
  }
  EXPECT_TRUE(first->running()) << first->log();
  EXPECT_TRUE(second->running()) << second->log();
}

// What a listener between a worker and its master finds of the store and of our frames.
struct Overheard {
  std::size_t frames = 0;
  std::size_t slices = 0;  // of the store's bytes
};

Overheard overhear(const std::string& seen, const std::string& store) {
  Overheard overheard;
  const std::string frame{'P', 'H', 'H', 'T', static_cast<char>(kProtocolVersion), '\0'};
  for (std::size_t at = 0; (at = seen.find(frame, at)) != std::string::npos; ++at) {
    ++overheard.frames;
  }
  constexpr std::size_t kSlices = 256;
  constexpr std::size_t kSliceBytes = 32;
  for (std::size_t i = 0; i < kSlices; ++i) {
    const std::string_view slice =
        std::string_view(store).substr(store.size() / kSlices * i, kSliceBytes);
    // Zeros and the like would be found anywhere.
    std::string distinct(slice);
    std::sort(distinct.begin(), distinct.end());
    distinct.erase(std::unique(distinct.begin(), distinct.end()), distinct.end());
    if (distinct.size() >= 12 && seen.find(slice) != std::string::npos) { ++overheard.slices; }
  }
  return overheard;
}

TEST_F(Security, WhoListensInBetweenReadsNothing) {
  const std::string store = content(path("demo.store"));
  std::map<bool, Overheard> overheard;
  for (const bool with_keys : {false, true}) {
    SetUp();
    const std::string name = with_keys ? "heard_keys" : "heard_plain";
    const std::vector<std::string> keys =
        with_keys ? std::vector<std::string>{"--keys", path("keys")} : std::vector<std::string>{};
    const Relay relay{"127.0.0.2", "127.0.0.1", {port_, port_ + 1}};
    const auto master = start_master(name, keys);
    const auto worker = start_worker(name, "tcp://127.0.0.2:" + std::to_string(port_), keys);
    expect_whole(name, *master);
    overheard[with_keys] = overhear(relay.seen(), store);
    EXPECT_GT(relay.seen().size(), 100'000U);
  }

  // Without keys it is all there, or this test would prove nothing.
  EXPECT_GE(overheard[false].frames, 10U);
  EXPECT_GE(overheard[false].slices, 10U);
  EXPECT_EQ(overheard[true].frames, 0U);
  EXPECT_EQ(overheard[true].slices, 0U);
}

}  // namespace
}  // namespace preheat
