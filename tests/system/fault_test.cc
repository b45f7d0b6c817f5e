// Masters and workers as processes, with what goes wrong in real life: killed, stopped, late, of
// another version, alone, talked to by strangers. The image is always that of `--local`.
//
// PREHEAT_KILLS sets how many workers are killed in one render, and how many homes in several
// (default 6).

#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <random>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include "cache/renderer.h"
#include "common/codec.h"
#include "common/self_test.h"
#include "common/zmq_transport.h"
#include "tests/system/render_fixture.h"

namespace preheat {
namespace {

using ::testing::HasSubstr;

class Faults : public RenderFixture {
 protected:
  static void SetUpTestSuite() {
    make_store("preheat_faults");
    run_well("local", render_arguments("local", {"--local"}));
    expected = report_of("local")["image"]["pixels_sha256"];
  }
  void TearDown() override { workers_.clear(); }

  static std::vector<std::string> render_arguments(const std::string& name,
                                                   const std::vector<std::string>& more) {
    return RenderFixture::render_arguments(name, "160x120", "8", more);
  }

  // A master that waits for workers at address_, in tiles of 8: 300 of them.
  std::unique_ptr<Process> start_master(const std::string& name,
                                        std::vector<std::string> more = {}) {
    std::vector<std::string> all{"--listen", address_, "--ledger",    path(name + ".ledger"),
                                 "--cache",  "60%",    "--tile-size", "8"};
    all.insert(all.end(), more.begin(), more.end());
    fs::remove(path(name + ".ledger"));
    return std::make_unique<Process>(kPreheat, render_arguments(name, all), path(name + ".log"),
                                     time_scale_);
  }
  Process& start_worker() {
    const std::string log = path("worker" + std::to_string(workers_.size()) + ".log");
    workers_.push_back(std::make_unique<Process>(
        kWorker, std::vector<std::string>{"--connect", address_}, log, time_scale_));
    return *workers_.back();
  }

  // Events so far.
  static std::vector<nlohmann::json> ledger_of(const std::string& name) {
    std::vector<nlohmann::json> events;
    std::ifstream stream(path(name + ".ledger"));
    for (std::string line; std::getline(stream, line);) {
      nlohmann::json event = nlohmann::json::parse(line, nullptr, /*allow_exceptions=*/false);
      if (!event.is_discarded()) { events.push_back(std::move(event)); }
    }
    return events;
  }
  static std::size_t count(const std::string& name, const std::string& event) {
    std::size_t found = 0;
    for (const nlohmann::json& entry : ledger_of(name)) {
      found += entry["event"] == event ? 1U : 0U;
    }
    return found;
  }
  static bool wait_for(const std::string& name, const std::string& event, std::size_t at_least,
                       Process& master) {
    while (master.running()) {
      if (count(name, event) >= at_least) { return true; }
      std::this_thread::sleep_for(milliseconds(5));
    }
    return count(name, event) >= at_least;
  }

  // Exit 0, the image of --local, every tile committed exactly once, no two results different.
  static void expect_whole(const std::string& name, Process& master) {
    ASSERT_EQ(master.wait(), 0) << master.log();
    const nlohmann::json report = report_of(name);
    EXPECT_EQ(report["image"]["pixels_sha256"], expected);
    EXPECT_EQ(report["leases"]["mismatches"], 0);
    std::map<int, int> commits;
    for (const nlohmann::json& event : ledger_of(name)) {
      if (event["event"] == "commit") { ++commits[event["tile"].get<int>()]; }
    }
    EXPECT_EQ(commits.size(), 300U);
    for (const auto& [tile, times] : commits) { EXPECT_EQ(times, 1) << "tile " << tile; }
  }

  std::string time_scale_ = kTimeScale;
  std::vector<std::unique_ptr<Process>> workers_{};
};

TEST_F(Faults, WorkersKilledAtRandomMomentsChangeNothing) {
  const std::uint32_t seed = std::random_device{}();
  SCOPED_TRACE("seed " + std::to_string(seed));
  std::mt19937 random{seed};
  const char* const wanted = std::getenv("PREHEAT_KILLS");
  const int kills_max = wanted == nullptr ? 6 : std::atoi(wanted);
  const auto master = start_master("killed", {"--wait-workers", "2"});
  std::vector<Process*> alive;
  for (int i = 0; i < 3; ++i) { alive.push_back(&start_worker()); }
  ASSERT_TRUE(wait_for("killed", "lease", 1, *master)) << master->log();
  int kills = 0;
  while (master->running() && kills < kills_max) {
    std::this_thread::sleep_for(milliseconds(20 + random() % 300));
    Process*& victim = alive[random() % alive.size()];
    victim->signal(SIGKILL);
    static_cast<void>(victim->wait());
    ++kills;
    victim = &start_worker();
  }

  expect_whole("killed", *master);
  std::cout << kills << " kills, seed " << seed << ", leases "
            << report_of("killed")["leases"].dump() << '\n';
  EXPECT_GE(count("killed", "lost"), 1U);
}

TEST_F(Faults, AWorkerThatIsStoppedAndContinuedComesBack) {
  time_scale_ = "4";  // dead after 1.25 s: two seconds here are eight in earnest
  const auto master = start_master("stopped", {"--wait-workers", "2"});
  Process& other = start_worker();
  Process& stopped = start_worker();
  ASSERT_TRUE(wait_for("stopped", "commit", 10, *master)) << master->log();

  // Both, as one alone would end the small image before the other is back.
  other.signal(SIGSTOP);
  stopped.signal(SIGSTOP);
  ASSERT_TRUE(wait_for("stopped", "lost", 2, *master)) << master->log();
  stopped.signal(SIGCONT);
  ASSERT_TRUE(wait_for("stopped", "join", 3, *master)) << master->log();
  other.signal(SIGCONT);

  expect_whole("stopped", *master);
  EXPECT_EQ(stopped.wait(), 0) << stopped.log();
}

TEST_F(Faults, AWorkerThatJoinsHalfWayTakesItsShare) {
  const auto master = start_master("joined");
  Process& first = start_worker();
  ASSERT_TRUE(wait_for("joined", "commit", 100, *master)) << master->log();
  Process& second = start_worker();

  expect_whole("joined", *master);
  EXPECT_EQ(first.wait(), 0);
  EXPECT_EQ(second.wait(), 0) << second.log();
  std::map<int, int> tiles;
  for (const nlohmann::json& event : ledger_of("joined")) {
    if (event["event"] == "commit") { ++tiles[event["worker"].get<int>()]; }
  }
  EXPECT_GE(tiles[1], 1);
}

TEST_F(Faults, AWorkerEndedByASignalHandsItsLeasesBack) {
  const auto master = start_master("left", {"--wait-workers", "2"});
  start_worker();
  Process& leaver = start_worker();
  ASSERT_TRUE(wait_for("left", "commit", 10, *master)) << master->log();

  leaver.signal(SIGTERM);

  EXPECT_EQ(leaver.wait(), 143) << leaver.log();
  expect_whole("left", *master);
  EXPECT_EQ(count("left", "lost"), 0U);
  EXPECT_EQ(report_of("left")["leases"]["expired"], 0);
}

TEST_F(Faults, AMasterEndedByASignalSaysSoToItsWorkers) {
  for (const int signal : {SIGINT, SIGTERM}) {
    const auto master = start_master("ended");
    Process& worker = start_worker();
    ASSERT_TRUE(wait_for("ended", "commit", 3, *master)) << master->log();

    master->signal(signal);

    EXPECT_EQ(master->wait(), 128 + signal) << master->log();
    EXPECT_EQ(worker.wait(), 0) << worker.log();
    EXPECT_FALSE(fs::exists(path("ended.exr")));
  }
}

TEST_F(Faults, AWorkerWhoseMasterWasKilledGivesUp) {
  const auto master = start_master("orphan");
  Process worker{kWorker, {"--connect", address_, "--give-up", "2"}, path("orphan_worker.log")};
  ASSERT_TRUE(wait_for("orphan", "commit", 3, *master)) << master->log();

  master->signal(SIGKILL);

  EXPECT_EQ(worker.wait(), 4) << worker.log();
  EXPECT_THAT(worker.log(), HasSubstr("no word from the master for 2 seconds"));
}

TEST_F(Faults, StartedWorkersEndWithTheirMaster) {
  Process master{kPreheat, render_arguments("children", {"--workers", "2"}), path("children.log")};
  const auto end = std::chrono::steady_clock::now() + kPatience;
  while (master.log().find("event=worker_ready") == std::string::npos && master.running() &&
         std::chrono::steady_clock::now() < end) {
    std::this_thread::sleep_for(milliseconds(5));
  }
  std::vector<int> pids;
  std::istringstream log(master.log());
  for (std::string word; log >> word;) {
    if (word.starts_with("pid=")) { pids.push_back(std::atoi(word.c_str() + 4)); }
  }
  ASSERT_EQ(pids.size(), 2U) << master.log();

  master.signal(SIGKILL);
  static_cast<void>(master.wait());

  for (const int pid : pids) {
    while (::kill(pid, 0) == 0 && std::chrono::steady_clock::now() < end) {
      std::this_thread::sleep_for(milliseconds(5));
    }
    EXPECT_NE(::kill(pid, 0), 0) << "worker " << pid << " outlived its master";
  }
}

TEST_F(Faults, StrangersOnBothPortsDisturbNobody) {
  const auto master = start_master("strangers");
  start_worker();
  ASSERT_TRUE(wait_for("strangers", "commit", 3, *master)) << master->log();
  std::mt19937 random{7};
  std::vector<int> strangers;
  for (int i = 0; i < 100; ++i) {
    const int fd = connect_raw(port_ + static_cast<unsigned>(i % 2));
    ASSERT_GE(fd, 0);
    std::string garbage(random() % 2000, '\0');
    for (char& byte : garbage) { byte = static_cast<char>(random()); }
    static_cast<void>(::send(fd, garbage.data(), garbage.size(), MSG_NOSIGNAL));
    strangers.push_back(fd);
  }
  // And one that speaks ZeroMQ, but nothing else of ours.
  const auto transport = make_zmq_transport();
  const auto channel = transport->connect(address_, ChannelKind::kControl, random_session());
  for (int i = 0; i < 100; ++i) {
    std::vector<std::byte> garbage(1 + random() % 300);
    for (std::byte& byte : garbage) { byte = static_cast<std::byte>(random()); }
    static_cast<void>((*channel)->send({}, garbage, {}));
    std::this_thread::sleep_for(milliseconds(1));
  }

  expect_whole("strangers", *master);
  EXPECT_EQ(count("strangers", "lost"), 0U);
  for (const int fd : strangers) { ::close(fd); }
}

// The next control frame within ten seconds.
std::optional<Received> next_frame(Transport& transport, Channel& channel) {
  const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(10);
  while (std::chrono::steady_clock::now() < end) {
    if (auto received = channel.receive()) { return received; }
    std::array<Channel*, 1> channels{&channel};
    transport.wait(channels, -1, milliseconds(50));
  }
  return std::nullopt;
}

TEST_F(Faults, AWorkerOfAnotherVersionIsRefusedWithBothVersions) {
  const auto master = start_master("refused");
  const auto transport = make_zmq_transport();
  const SessionId session = random_session();
  const auto channel = transport->connect(address_, ChannelKind::kControl, session);
  Hello hello;
  hello.session = session;
  hello.build.text = "9.9.9";
  const std::vector<std::byte> said = encode_frame({}, hello);
  while ((*channel)->send({}, said, {}) != SendOutcome::kSent && master->running()) {
    std::this_thread::sleep_for(milliseconds(5));
  }

  const auto received = next_frame(*transport, **channel);
  ASSERT_TRUE(received.has_value()) << master->log();
  const auto frame = decode_frame(received->head.bytes);
  ASSERT_TRUE(frame.has_value());
  const auto* refusal = std::get_if<Refuse>(&frame->message);
  ASSERT_NE(refusal, nullptr);
  EXPECT_EQ(refusal->exit_code, 7);
  EXPECT_THAT(refusal->text.text, HasSubstr("9.9.9"));
  EXPECT_THAT(refusal->text.text, HasSubstr(build_version()));

  start_worker();
  expect_whole("refused", *master);
}

TEST_F(Faults, AWorkerLeavesAMasterOfAnotherProtocolVersion) {
  const auto transport = make_zmq_transport();
  const auto server = transport->listen(address_, ChannelKind::kControl);
  ASSERT_TRUE(server.has_value()) << server.error().message;
  Process& worker = start_worker();
  const auto hello = next_frame(*transport, **server);
  ASSERT_TRUE(hello.has_value()) << worker.log();

  std::vector<std::byte> answer = encode_frame({}, Refuse{7, {"no"}});
  answer[4] = std::byte{kProtocolVersion + 1};
  ASSERT_EQ((*server)->send(hello->session, answer, {}), SendOutcome::kSent);

  EXPECT_EQ(worker.wait(), 7);
  EXPECT_THAT(worker.log(), HasSubstr("version " + std::to_string(kProtocolVersion + 1)));
  EXPECT_THAT(worker.log(), HasSubstr("version " + std::to_string(kProtocolVersion)));
}

// How long the renders took in which nobody and in which somebody was killed is printed, not
// judged.
TEST_F(Faults, HomesKilledDuringFetchesCostTimeOnly) {
  const std::uint32_t seed = std::random_device{}();
  SCOPED_TRACE("seed " + std::to_string(seed));
  std::mt19937 random{seed};
  const char* const wanted = std::getenv("PREHEAT_KILLS");
  const int kills_wanted = wanted == nullptr ? 6 : std::atoi(wanted);
  const std::vector<std::string> options{"--wait-workers", "3", "--cache", "10%"};
  const auto undisturbed = start_master("homes", options);
  for (int i = 0; i < 3; ++i) { start_worker(); }
  expect_whole("homes", *undisturbed);
  const nlohmann::json clean = report_of("homes");
  EXPECT_GT(clean["sources"]["remote_peer_bytes"], 0);
  int kills = 0;
  std::uint64_t timeouts = 0;
  double seconds_most = 0.0;
  for (int round = 0; kills < kills_wanted && round < 10 * kills_wanted; ++round) {
    workers_.clear();
    const auto master = start_master("homes", options);
    std::vector<Process*> alive;
    for (int i = 0; i < 3; ++i) { alive.push_back(&start_worker()); }
    ASSERT_TRUE(wait_for("homes", "lease", 1, *master)) << master->log();
    for (int i = 0; i < 3 && kills < kills_wanted; ++i) {
      std::this_thread::sleep_for(milliseconds(50 + random() % 400));
      if (!master->running()) { break; }
      Process*& victim = alive[random() % alive.size()];
      victim->signal(SIGKILL);
      static_cast<void>(victim->wait());
      ++kills;
      victim = &start_worker();
    }
    expect_whole("homes", *master);
    const nlohmann::json report = report_of("homes");
    timeouts += report["sources"]["peer_timeouts"].get<std::uint64_t>();
    seconds_most = std::max(seconds_most, report["time"]["render"].get<double>());
  }

  EXPECT_EQ(kills, kills_wanted);
  std::cout << kills << " kills, seed " << seed << ", " << timeouts
            << " times a peer was given up, render " << clean["time"]["render"]
            << " s undisturbed, at most " << seconds_most << " s with up to three kills\n";
}

// A worker that joins, renders nothing, and is the home of its part of the scene and the first that
// the hot set is asked of; it answers others in one wrong way.
class BadPeer {
 public:
  enum class Way { kWrongBytes, kWrongVoxel, kHugeFrame, kNonsense, kSilence, kPromises };

  BadPeer(const std::string& master, Way way)
      : way_(way), thread_([this, master] { run(master); }) {}
  ~BadPeer() {
    stop_ = true;
    thread_.join();
  }
  [[nodiscard]] bool welcomed() const { return welcomed_; }
  [[nodiscard]] int asked() const { return asked_; }

 private:
  void run(const std::string& master) {
    const auto transport = make_zmq_transport();
    const SessionId session = random_session();
    const auto peers = transport->listen("tcp://127.0.0.1:*", ChannelKind::kPeer);
    const auto control = transport->connect(master, ChannelKind::kControl, session);
    Hello hello;
    hello.session = session;
    hello.build.text = build_version();
    hello.isa.text = tracing_isa();
    hello.self_test = numeric_self_test();
    hello.peer_endpoint.text = (*peers)->endpoint();
    // Of a plan that the master has not made.
    WorkerHeartbeat heartbeat;
    heartbeat.homes_version = UINT32_MAX;
    auto said_last = std::chrono::steady_clock::now() - std::chrono::hours(1);
    while (!stop_) {
      const auto now = std::chrono::steady_clock::now();
      if (now - said_last > milliseconds(300)) {
        said_last = now;
        static_cast<void>((*control)->send(
            {}, welcomed_ ? encode_frame(job_, heartbeat) : encode_frame({}, hello), {}));
      }
      while (const auto received = (*control)->receive()) {
        const auto frame = decode_frame(received->head.bytes);
        if (frame && std::holds_alternative<Welcome>(frame->message)) {
          job_ = frame->job;
          welcomed_ = true;
        }
      }
      while (const auto received = (*peers)->receive()) {
        const auto frame = decode_frame(received->head.bytes);
        if (frame) { answer(**peers, received->session, std::get<RangeRequest>(frame->message)); }
      }
      const std::array<Channel*, 2> channels{control->get(), peers->get()};
      transport->wait(channels, -1, milliseconds(20));
    }
  }

  void answer(Channel& channel, const SessionId& to, const RangeRequest& range) {
    ++asked_;
    auto bytes = std::make_shared<std::vector<std::byte>>(range.bytes);
    RangeReply reply{range.object, range.voxel, range.offset};
    std::vector<std::byte> head = encode_frame(job_, reply);
    switch (way_) {
      case Way::kWrongBytes:
        break;
      case Way::kWrongVoxel:
        reply.voxel = VoxelId{index_of(range.voxel) ^ 1U};
        head = encode_frame(job_, reply);
        break;
      case Way::kHugeFrame:
        bytes->resize(64 * kChunkBytesMax);
        break;
      case Way::kNonsense:
        head.assign(50, std::byte{0x5A});
        break;
      case Way::kSilence:
        return;
      case Way::kPromises:
        head = encode_frame(job_, VoxelLater{});
        bytes->clear();
        break;
    }
    static_cast<void>(channel.send(to, head, {*bytes, bytes}));
  }

  Way way_;
  JobKey job_{};
  std::atomic<bool> stop_{false};
  std::atomic<bool> welcomed_{false};
  std::atomic<int> asked_{0};
  std::thread thread_;
};

TEST_F(Faults, APeerThatLiesOrStallsCostsTimeOnly) {
  using Way = BadPeer::Way;
  for (const Way way : {Way::kWrongBytes, Way::kWrongVoxel, Way::kHugeFrame, Way::kNonsense,
                        Way::kSilence, Way::kPromises}) {
    SCOPED_TRACE("way " + std::to_string(static_cast<int>(way)));
    workers_.clear();
    const auto master = start_master("bad_peer", {"--wait-workers", "3", "--cache", "25%"});
    const BadPeer peer{address_, way};
    while (!peer.welcomed() && master->running()) { std::this_thread::sleep_for(milliseconds(5)); }
    for (int i = 0; i < 2; ++i) { start_worker(); }

    expect_whole("bad_peer", *master);

    const nlohmann::json sources = report_of("bad_peer")["sources"];
    EXPECT_GT(peer.asked(), 0);
    if (way == Way::kWrongBytes || way == Way::kNonsense) {
      EXPECT_GE(sources["peer_lies"], 1) << sources;
    } else {
      EXPECT_GE(sources["peer_timeouts"].get<int>() + sources["peer_lies"].get<int>(), 1)
          << sources;
    }
    std::cout << "way " << static_cast<int>(way) << ": asked " << peer.asked() << " times, "
              << sources["peer_timeouts"] << " timeouts, " << sources["peer_lies"] << " lies, "
              << report_of("bad_peer")["time"]["total"] << " s\n";
  }
}

TEST_F(Faults, AUsedPortIsNamed) {
  const int fd = ::socket(AF_INET, SOCK_STREAM, 0);
  const sockaddr_in address = loopback(port_);
  ASSERT_EQ(::bind(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
  ASSERT_EQ(::listen(fd, 1), 0);

  const auto master = start_master("used");

  EXPECT_EQ(master->wait(), 2);
  EXPECT_THAT(master->log(), HasSubstr(address_));
  EXPECT_THAT(master->log(), HasSubstr("Address already in use"));
  ::close(fd);
}

TEST_F(Faults, NobodyComes) {
  // 60 s of waiting in one.
  Process master{kPreheat, render_arguments("alone", {"--listen", address_}), path("alone.log"),
                 "60"};
  Process worker{
      kWorker, {"--connect", "tcp://127.0.0.1:1", "--give-up", "0.5"}, path("alone_worker.log")};

  EXPECT_EQ(master.wait(), 3);
  EXPECT_THAT(master.log(), HasSubstr("no workers in time: 0 of 1"));
  EXPECT_EQ(worker.wait(), 4);
}

TEST_F(Faults, AWorkerWaitsForANameThatIsNotKnownYet) {
  const std::vector<std::string> arguments{"--connect", "tcp://preheat.invalid:4000",
                                           "--insecure-no-auth", "--give-up"};
  std::vector<std::string> hasty = arguments;
  hasty.emplace_back("0.5");
  std::vector<std::string> patient = arguments;
  patient.emplace_back("600");

  Process gives_up{kWorker, hasty, path("gives_up.log")};
  Process waits{kWorker, patient, path("waits.log")};

  EXPECT_EQ(gives_up.wait(), 4);
  EXPECT_THAT(gives_up.log(), HasSubstr("preheat.invalid"));
  while (waits.running() && waits.log().find("event=waiting_for_way") == std::string::npos) {
    std::this_thread::sleep_for(milliseconds(5));
  }
  waits.signal(SIGTERM);
  EXPECT_EQ(waits.wait(), 143) << waits.log();
}

TEST_F(Faults, ADamagedVoxelEndsTheJobAndIsNamed) {
  fs::copy_file(path("demo.store"), path("damaged.store"), fs::copy_options::overwrite_existing);
  const auto bytes = static_cast<std::streamoff>(fs::file_size(path("damaged.store")));
  {
    std::fstream file(path("damaged.store"), std::ios::in | std::ios::out | std::ios::binary);
    // Blocks are most of a store and come first.
    for (std::streamoff at = bytes / 8; at < bytes / 2; at += 4096) {
      file.seekg(at);
      const int byte = file.get();
      file.seekp(at);
      file.put(static_cast<char>(byte ^ 0x55));
    }
  }
  std::vector<std::string> arguments = render_arguments("damaged", {"--workers", "1"});
  arguments[1] = path("damaged.store");

  Process master{kPreheat, arguments, path("damaged.log")};

  EXPECT_EQ(master.wait(), 5) << master.log();
  EXPECT_THAT(master.log(), HasSubstr("voxel"));
  EXPECT_FALSE(fs::exists(path("damaged.exr")));
}

}  // namespace
}  // namespace preheat
