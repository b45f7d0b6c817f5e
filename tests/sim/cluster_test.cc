// A whole cluster in one thread: the master's job and many workers' sessions over a network that
// delays, loses and damages, with workers that die, stop, continue and join, and that as peers lie,
// are silent, talk nonsense or cannot be reached. Seeds replay.

#include <gtest/gtest.h>
#include <spdlog/spdlog.h>

#include <deque>
#include <map>
#include <memory>
#include <random>
#include <set>
#include <string>

#include "common/content_hash.h"
#include "common/scene_tables_codec.h"
#include "master/job.h"
#include "tests/scenes/grid_store.h"
#include "tests/scenes/soups.h"
#include "worker/worker_session.h"

namespace preheat {
namespace {

using std::chrono::milliseconds;

constexpr std::uint32_t kTileSize = 8;
constexpr std::uint32_t kWidth = 100;
constexpr std::uint32_t kHeight = 60;
constexpr const char* kBuild = "sim";

struct Faults {
  double loss = 0.0;
  double damage = 0.0;
  bool kills = false;
  bool stops = false;
  bool master_stops = false;
  bool peers = true;             // workers serve each other
  double liars = 0.0;            // share of workers that send others wrong bytes
  double stallers = 0.0;         // that take requests and answer none
  double promisers = 0.0;        // that only ever say "later"
  double babblers = 0.0;         // that answer with what is no message
  bool peer_partitions = false;  // some cannot reach some others, for a while
  int slowness = 1;              // of the first worker: how many times as long a tile takes
};

enum class Manners : std::uint8_t { kHonest, kLiar, kStaller, kPromiser, kBabbler };

float value_of(TileId tile) { return 0.5F + static_cast<float>(index_of(tile)); }

// The scene that the simulated master serves.
struct SimScene {
  test::GridStore store = test::cut_into_grid(test::soup(300, 0.1F, 7), 3);
  std::vector<std::byte> tables{};

  SimScene() {
    std::uint64_t offset = 0;
    for (std::size_t voxel = 0; voxel < store.blocks.size(); ++voxel) {
      store.tables.voxels[voxel].hash = content_hash(store.blocks[voxel]->bytes());
      store.tables.voxels[voxel].block_offset = offset;
      offset += (store.blocks[voxel]->bytes().size() + 15) / 16 * 16;
    }
    tables = encode_scene_tables(store.tables);
  }
};

// A renderer that computes nothing: every tile needs two voxels and some time.
struct SimWorker {
  SessionId id{};
  Manners manners = Manners::kHonest;
  std::unique_ptr<WorkerSession> session{};
  std::mt19937_64 random{};
  bool alive = true;
  Time stopped_until{};
  bool started = false;
  std::set<VoxelId> hot_missing{};
  bool hot_set = false;
  bool hot_told = false;
  std::set<VoxelId> held{};
  std::deque<TileId> queue{};
  std::optional<TileId> tile{};
  std::set<VoxelId> tile_needs{};
  Time tile_end{};
  RendererCounts counts{};
  std::vector<CellAccesses>
      accesses{};  // one camera ray for every tile, in the voxel of its number
  std::optional<ExitCode> exit{};
  std::set<std::uint64_t> connected{};  // to these peers
};

class Cluster {
 public:
  Cluster(std::uint64_t seed, const Faults& faults) : random_(seed), faults_(faults) {
    JobOptions options;
    options.key = {1, seed};
    options.settings.width = kWidth;
    options.settings.height = kHeight;
    options.tile_size = kTileSize;
    options.count_accesses = AccessCounting::kExact;
    options.bulk_port = 4001;
    options.address = "sim";
    options.build = kBuild;
    options.seed = seed;
    options.peers = faults.peers;
    options.ledger = [this](const std::string& line) {
      commits_ += line.find("\"commit\"") != std::string::npos ? 1U : 0U;
    };
    job_ = std::make_unique<Job>(
        options,
        JobScene{scene_.tables, content_hash(scene_.tables),
                 VoxelServer{scene_.tables, scene_.store.blocks.size(),
                             [this](VoxelId voxel) {
                               return scene_.store.blocks[index_of(voxel)]->bytes();
                             }},
                 [](VoxelId) { return true; },
                 [this](const CacheSize&) { return Result<WorkerPlan>(plan()); },
                 scene_.store.tables.voxels, std::vector<double>(scene_.store.blocks.size(), 1.0)},
        now_);
  }

  [[nodiscard]] Time now() const { return now_; }

  void join() {
    auto worker = std::make_unique<SimWorker>();
    worker->id = {random_(), random_()};
    worker->random.seed(random_());
    Hello hello;
    hello.session = worker->id;
    hello.build.text = kBuild;
    hello.peer_endpoint.text = "tcp://127.0.0.1:1";
    worker->manners = manners();
    worker->session =
        std::make_unique<WorkerSession>(hello, Timers{}, std::chrono::seconds(60), now_);
    workers_.push_back(std::move(worker));
  }

  void run(Duration limit) {
    const Time end = now_ + limit;
    while (!job_->over() && now_ < end) { step(); }
  }

  void step() {
    now_ += milliseconds(1 + random_() % 20);
    disturb();
    const bool master_runs = now_ >= master_stopped_until_;
    deliver(master_runs);
    for (auto& worker : workers_) {
      if (worker->alive && now_ >= worker->stopped_until) { run_worker(*worker); }
    }
    if (!master_runs) { return; }
    job_->tick(now_);
    for (Outgoing& outgoing : job_->take_outgoing()) { post_to_worker(outgoing); }
  }

  Job& job() { return *job_; }
  [[nodiscard]] std::uint64_t commits() const { return commits_; }
  std::vector<std::unique_ptr<SimWorker>>& workers() { return workers_; }
  std::uint64_t lost = 0;
  std::uint64_t killed = 0;
  std::uint64_t stopped = 0;
  std::uint64_t bad_answers = 0;
  std::uint64_t cut_off = 0;

  [[nodiscard]] SourceStats sources() const {
    SourceStats sum;
    for (const auto& worker : workers_) {
      RendererCounts counts = worker->counts;
      worker->session->set_counts(counts);
      sum.add(worker->session->counts().stats.sources);
    }
    return sum;
  }

 private:
  enum class Route : std::uint8_t { kToMaster, kToWorker, kPeerRequest, kPeerAnswer };
  struct Mail {
    Route route{};
    ChannelKind channel{};
    SessionId session{};  // of the worker that sends to the master, else of the one that receives
    SessionId from{};     // between peers
    std::vector<std::byte> head{};
    std::vector<std::byte> data{};
  };

  [[nodiscard]] std::size_t hot_count() const { return scene_.store.blocks.size() / 2; }

  Manners manners() {
    if (chance(faults_.liars)) { return Manners::kLiar; }
    if (chance(faults_.stallers)) { return Manners::kStaller; }
    if (chance(faults_.promisers)) { return Manners::kPromiser; }
    return chance(faults_.babblers) ? Manners::kBabbler : Manners::kHonest;
  }

  WorkerPlan plan() const {
    auto hot = std::make_shared<EncodedPlan>();
    const auto add = [&](std::uint32_t id) {
      for (unsigned byte = 0; byte < 4; ++byte) {
        hot->bytes.push_back(static_cast<std::byte>(id >> (8 * byte)));
      }
    };
    for (; hot->hot_count < hot_count(); ++hot->hot_count) {
      add(static_cast<std::uint32_t>(hot->hot_count));
    }
    add(kPlanDivider);
    for (std::size_t voxel = hot_count(); voxel < 2 * hot_count(); ++voxel) {
      add(static_cast<std::uint32_t>(voxel));
    }
    hot->hash = content_hash(hot->bytes);
    const std::uint64_t limit = scene_.store.tables.resident_bytes();
    return {2 * limit, limit / 20, hot};
  }

  bool chance(double probability) {
    return static_cast<double>(random_() >> 11) * 0x1p-53 < probability;
  }

  void disturb() {
    if (faults_.kills && chance(0.002)) {
      const std::size_t victim = random_() % workers_.size();
      if (workers_[victim]->alive) {
        workers_[victim]->alive = false;
        ++killed;
        // Half of the time the connection tells, else only silence does.
        if (chance(0.5)) { job_->on_gone(workers_[victim]->id, now_); }
        join();
      }
    }
    if (faults_.stops && chance(0.002)) {
      workers_[random_() % workers_.size()]->stopped_until = now_ + std::chrono::seconds(8);
      ++stopped;
    }
    if (faults_.peer_partitions && chance(0.002)) {
      const auto a = workers_[random_() % workers_.size()]->id.low;
      const auto b = workers_[random_() % workers_.size()]->id.low;
      cut_until_[{a, b}] = now_ + std::chrono::seconds(1 + random_() % 20);
    }
    // One stop at a time: workers rightly give up a master that is away for a minute.
    if (faults_.master_stops && now_ >= master_stopped_until_ && chance(0.0005)) {
      master_stopped_until_ = now_ + std::chrono::seconds(20);
      ++stopped;
    }
  }

  // Messages of one connection keep their order; what is lost was lost with its connection.
  void post(Mail mail) {
    if (chance(faults_.loss)) {
      ++lost;
      return;
    }
    if (!mail.data.empty() && chance(faults_.damage)) {
      mail.data[random_() % mail.data.size()] ^= std::byte{4};
    }
    const auto link = std::tuple(mail.route, mail.channel, mail.session.low, mail.from.low);
    Time& last = link_last_[link];
    last = std::max(last, now_ + milliseconds(random_() % 30));
    mail_.emplace(last, std::move(mail));
  }

  void post_to_worker(const Outgoing& outgoing) {
    const auto& bytes = outgoing.data.bytes;
    post({Route::kToWorker,
          outgoing.channel,
          outgoing.to,
          {},
          encode_frame(job_->key(), outgoing.message),
          {bytes.begin(), bytes.end()}});
  }

  void deliver(bool master_runs) {
    std::multimap<Time, Mail> later;
    while (!mail_.empty() && mail_.begin()->first <= now_) {
      const Mail mail = std::move(mail_.extract(mail_.begin()).mapped());
      const Payload data{mail.data, std::make_shared<int>()};
      if (mail.route == Route::kToMaster) {
        const auto frame = decode_frame(mail.head);
        ASSERT_TRUE(frame.has_value());
        if (!master_runs) {
          later.emplace(now_, mail);
        } else if (mail.channel == ChannelKind::kControl) {
          job_->on_control(mail.session, *frame, now_);
        } else {
          job_->on_bulk(mail.session, *frame, data, now_);
        }
        continue;
      }
      for (auto& worker : workers_) {
        if (worker->id != mail.session || !worker->alive) { continue; }
        if (now_ < worker->stopped_until) {
          later.emplace(now_, mail);
        } else {
          deliver_to(*worker, mail, data);
        }
      }
    }
    mail_.merge(later);
  }

  void deliver_to(SimWorker& worker, const Mail& mail, const Payload& data) {
    const auto frame = decode_frame(mail.head);
    if (mail.route == Route::kPeerRequest) {
      ASSERT_TRUE(frame.has_value());
      worker.session->on_peer_request(mail.from, *frame, now_);
    } else if (mail.route == Route::kPeerAnswer && !frame) {
      worker.session->on_peer_nonsense(mail.from, now_);
    } else if (mail.route == Route::kPeerAnswer) {
      if (worker.connected.contains(mail.from.low)) {
        worker.session->on_peer_answer(mail.from, *frame, data, now_);
      }
    } else if (mail.channel == ChannelKind::kControl) {
      ASSERT_TRUE(frame.has_value());
      worker.session->on_control(*frame, now_);
    } else {
      ASSERT_TRUE(frame.has_value());
      worker.session->on_bulk(*frame, data, now_);
    }
  }

  bool is_cut(const SessionId& a, const SessionId& b) {
    for (const auto& pair : {std::pair(a.low, b.low), std::pair(b.low, a.low)}) {
      const auto cut = cut_until_.find(pair);
      if (cut != cut_until_.end() && now_ < cut->second) { return true; }
    }
    return false;
  }

  // What this worker tells another one, if anything.
  void post_answer(const SimWorker& worker, const PeerAnswer& answer) {
    if (is_cut(worker.id, answer.to)) {
      ++cut_off;
      return;
    }
    Mail mail{Route::kPeerAnswer,
              ChannelKind::kPeer,
              answer.to,
              worker.id,
              encode_frame(worker.session->job(), answer.message),
              {answer.data.bytes.begin(), answer.data.bytes.end()}};
    bad_answers += worker.manners == Manners::kHonest ? 0 : 1;
    switch (worker.manners) {
      case Manners::kHonest:
        break;
      case Manners::kLiar:
        if (!mail.data.empty()) { mail.data[random_() % mail.data.size()] ^= std::byte{4}; }
        break;
      case Manners::kStaller:
        return;
      case Manners::kPromiser:
        mail.head = encode_frame(worker.session->job(), VoxelLater{});
        mail.data.clear();
        break;
      case Manners::kBabbler:
        mail.head.assign(random_() % 100, std::byte{7});
        break;
    }
    post(std::move(mail));
  }

  void run_worker(SimWorker& worker) {
    if (worker.exit) { return; }
    render(worker);
    worker.session->set_counts(worker.counts);
    worker.session->tick(now_);
    for (WorkerAction& action : worker.session->take_actions()) {
      std::visit([&](auto& what) { perform(worker, what); }, action);
    }
    for (Outgoing& outgoing : worker.session->take_outgoing()) {
      const auto& bytes = outgoing.data.bytes;
      const bool to_peer = outgoing.channel == ChannelKind::kPeer;
      EXPECT_TRUE(!to_peer || worker.connected.contains(outgoing.to.low));
      if (to_peer && is_cut(worker.id, outgoing.to)) {
        ++cut_off;
        continue;
      }
      post({to_peer ? Route::kPeerRequest : Route::kToMaster,
            outgoing.channel,
            to_peer ? outgoing.to : worker.id,
            worker.id,
            encode_frame(worker.session->job(), outgoing.message),
            {bytes.begin(), bytes.end()}});
    }
    for (const PeerAnswer& answer : worker.session->take_answers()) { post_answer(worker, answer); }
  }

  void render(SimWorker& worker) {
    if (worker.hot_set && !worker.hot_told && worker.hot_missing.empty()) {
      worker.hot_told = true;
      worker.session->on_hot_set_ready({});
    }
    if (!worker.hot_told) { return; }
    if (worker.tile && worker.tile_needs.empty()) {
      ++worker.counts.progress;
      if (now_ >= worker.tile_end) {
        const TileRect rect = TileGrid{kWidth, kHeight, kTileSize}.rect(*worker.tile);
        const std::size_t pixels = std::size_t{rect.width} * rect.height;
        TileDone done{*worker.tile,
                      {std::vector<float>(pixels * 3, value_of(*worker.tile)),
                       std::vector<float>(pixels, 0.0F)}};
        ++worker.accesses[index_of(*worker.tile) % worker.accesses.size()].camera;
        worker.tile.reset();
        ++worker.counts.stats.tiles;
        worker.session->on_tile_done(done, now_);
      }
    }
    if (!worker.tile && !worker.queue.empty()) {
      worker.tile = worker.queue.front();
      worker.queue.pop_front();
      const int times = &worker == workers_.front().get() ? faults_.slowness : 1;
      worker.tile_end = now_ + times * milliseconds(50 + worker.random() % 300);
      for (int i = 0; i < 2; ++i) {
        const VoxelId voxel{
            static_cast<std::uint32_t>(worker.random() % scene_.store.blocks.size())};
        if (worker.held.contains(voxel) || !worker.tile_needs.insert(voxel).second) { continue; }
        worker.session->on_voxel_needed({voxel, worker.random() % 4 != 0});
      }
    }
  }

  void perform(SimWorker& /*worker*/, const ConnectBulk& /*connect*/) {}
  void perform(SimWorker& worker, const ConnectPeer& connect) {
    worker.connected.insert(connect.peer.session.low);
    EXPECT_LE(worker.connected.size(), WorkerSession::kPeersConnectedMax);
  }
  void perform(SimWorker& worker, const DisconnectPeer& disconnect) {
    EXPECT_EQ(worker.connected.erase(disconnect.session.low), 1U);
  }
  void perform(SimWorker& worker, const StartRenderer& start) {
    EXPECT_EQ(start.tables.voxels.size(), scene_.store.blocks.size());
    EXPECT_FALSE(worker.started);
    worker.started = true;
    worker.accesses.resize(start.tables.voxels.size());
  }
  void perform(SimWorker& worker, const SetHotVoxels& hot) {
    EXPECT_TRUE(worker.started);
    worker.hot_set = true;
    worker.hot_missing.insert(hot.voxels.begin(), hot.voxels.end());
    EXPECT_EQ(hot.voxels.size(), hot_count());
    EXPECT_EQ(hot.warm.size(), hot_count());
    for (const VoxelId voxel : hot.warm) { EXPECT_GE(index_of(voxel), hot_count()); }
  }
  void perform(SimWorker& worker, const DeliverVoxel& deliver) {
    const auto& expected = scene_.store.blocks[index_of(deliver.voxel)]->bytes();
    EXPECT_TRUE(std::equal(deliver.bytes.bytes.begin(), deliver.bytes.bytes.end(), expected.begin(),
                           expected.end()));
    worker.hot_missing.erase(deliver.voxel);
    worker.tile_needs.erase(deliver.voxel);
    if (worker.random() % 2 == 0) { worker.held.insert(deliver.voxel); }
  }
  void perform(SimWorker& worker, const AddTile& add) { worker.queue.push_back(add.tile); }
  void perform(SimWorker& worker, const CancelTile& cancel) {
    std::erase(worker.queue, cancel.tile);
  }
  void perform(SimWorker& worker, const TellAccesses& /*tell*/) {
    worker.session->on_accesses(worker.accesses);
  }
  void perform(SimWorker& worker, const Finish& finish) { worker.exit = finish.code; }

  std::mt19937_64 random_;
  Faults faults_;
  SimScene scene_;
  Time now_ = Time{} + std::chrono::hours(1);
  std::unique_ptr<Job> job_;
  std::vector<std::unique_ptr<SimWorker>> workers_;
  std::multimap<Time, Mail> mail_;
  std::map<std::tuple<Route, ChannelKind, std::uint64_t, std::uint64_t>, Time> link_last_;
  std::map<std::pair<std::uint64_t, std::uint64_t>, Time> cut_until_;
  Time master_stopped_until_{};
  std::uint64_t commits_ = 0;
};

// Every tile committed once, and every pixel is that of its tile.
void expect_whole(Cluster& cluster) {
  ASSERT_TRUE(cluster.job().over());
  const auto result = cluster.job().take_result();
  ASSERT_TRUE(result.has_value()) << result.error().message;
  EXPECT_TRUE(result->poisoned_tiles.empty());
  EXPECT_EQ(result->leases.mismatches, 0U);
  const TileGrid grid{kWidth, kHeight, kTileSize};
  EXPECT_EQ(cluster.commits(), grid.count());
  for (std::uint32_t y = 0; y < kHeight; ++y) {
    for (std::uint32_t x = 0; x < kWidth; ++x) {
      const TileId tile{y / kTileSize * grid.columns() + x / kTileSize};
      ASSERT_EQ(result->film.rgb()[(std::size_t{y} * kWidth + x) * 3], value_of(tile));
    }
  }
}

TEST(Cluster, RendersWithoutFaultsAndWithoutDuplicates) {
  Cluster cluster{1, {}};
  for (int i = 0; i < 3; ++i) { cluster.join(); }
  cluster.run(std::chrono::minutes(5));

  ASSERT_TRUE(cluster.job().over());
  for (const auto& worker : cluster.workers()) { EXPECT_EQ(worker->exit, ExitCode::kDone); }
  expect_whole(cluster);
}

TEST(Cluster, RendersOnlyTheLastTilesTwiceWhereNothingFailed) {
  Cluster cluster{2, {}};
  for (int i = 0; i < 3; ++i) { cluster.join(); }
  cluster.run(std::chrono::minutes(5));
  const auto result = cluster.job().take_result();

  ASSERT_TRUE(result.has_value());
  EXPECT_EQ(result->leases.expired, 0U);
  EXPECT_EQ(result->leases.granted - result->leases.doubled, 104U);
  EXPECT_GT(result->leases.doubled, 0U);
  EXPECT_LE(result->leases.duplicates, result->leases.doubled);
  // Each worker told what it had counted; what was cancelled before its end may count too.
  double accesses = 0.0;
  for (const double voxel : result->accesses_by_voxel) { accesses += voxel; }
  EXPECT_GE(accesses, 104.0);
  EXPECT_LE(accesses, 104.0 + static_cast<double>(result->leases.doubled));
}

TEST(Cluster, ASlowWorkerDoesNotHoldUpTheEnd) {
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    // Its three first tiles would take it ten minutes; the others need 10 seconds for all tiles.
    Cluster cluster{seed, {.slowness = 1000}};
    for (int i = 0; i < 3; ++i) { cluster.join(); }
    const Time begin = cluster.now();
    cluster.run(std::chrono::minutes(60));

    EXPECT_LT(cluster.now() - begin, std::chrono::seconds(25));
    expect_whole(cluster);
  }
}

TEST(Cluster, SaysNothingOfTheVoxelsIfAWorkerIsLostWithItsCounts) {
  std::uint64_t silent = 0;
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Cluster cluster{seed, {.kills = true}};
    for (int i = 0; i < 4; ++i) { cluster.join(); }
    cluster.run(std::chrono::minutes(60));
    const auto result = cluster.job().take_result();
    ASSERT_TRUE(result.has_value());
    if (result->accesses_by_voxel.empty()) {
      ++silent;
      continue;
    }
    double accesses = 0.0;
    for (const double voxel : result->accesses_by_voxel) { accesses += voxel; }
    EXPECT_GE(accesses, 104.0);
  }
  EXPECT_GT(silent, 0U);
}

struct Case {
  const char* name;
  Faults faults;
  friend void PrintTo(const Case& c, std::ostream* out) { *out << c.name; }
};

class ClusterFaults : public ::testing::TestWithParam<Case> {};

TEST_P(ClusterFaults, EndInTheSameImage) {
  std::uint64_t lost = 0;
  std::uint64_t killed = 0;
  std::uint64_t stopped = 0;
  std::uint64_t bad_answers = 0;
  std::uint64_t cut_off = 0;
  SourceStats sources;
  for (std::uint64_t seed = 1; seed <= 25; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Cluster cluster{seed, GetParam().faults};
    for (int i = 0; i < 4; ++i) { cluster.join(); }
    cluster.run(std::chrono::minutes(60));
    expect_whole(cluster);
    lost += cluster.lost;
    killed += cluster.killed;
    stopped += cluster.stopped;
    bad_answers += cluster.bad_answers;
    cut_off += cluster.cut_off;
    sources.add(cluster.sources());
  }
  // The faults were there.
  EXPECT_EQ(lost > 0, GetParam().faults.loss > 0.0);
  EXPECT_EQ(killed > 0, GetParam().faults.kills);
  EXPECT_EQ(stopped > 0, GetParam().faults.stops || GetParam().faults.master_stops);
  const Faults& faults = GetParam().faults;
  EXPECT_EQ(bad_answers > 0,
            faults.liars + faults.stallers + faults.promisers + faults.babblers > 0.0);
  EXPECT_EQ(cut_off > 0, faults.peer_partitions);
  EXPECT_EQ(sources.peer_lies > 0,
            faults.liars > 0.0 || faults.babblers > 0.0 || faults.damage > 0.0);
  EXPECT_EQ(sources.remote_peer_bytes > 0, faults.peers);
}

INSTANTIATE_TEST_SUITE_P(
    Kinds, ClusterFaults,
    ::testing::Values(Case{"Loss", {.loss = 0.05}}, Case{"Damage", {.damage = 0.002}},
                      Case{"Kills", {.kills = true}}, Case{"Stops", {.stops = true}},
                      Case{"MasterStops", {.master_stops = true}},
                      Case{"NoPeers", {.peers = false}}, Case{"Liars", {.liars = 0.3}},
                      Case{"Stallers", {.stallers = 0.3}}, Case{"Promisers", {.promisers = 0.3}},
                      Case{"Babblers", {.babblers = 0.3}},
                      Case{"PeerPartitions", {.peer_partitions = true}},
                      Case{"BadPeersThatDie", {.kills = true, .liars = 0.2, .stallers = 0.2}},
                      Case{"All",
                           {.loss = 0.02,
                            .damage = 0.001,
                            .kills = true,
                            .stops = true,
                            .master_stops = true,
                            .liars = 0.1,
                            .stallers = 0.1,
                            .promisers = 0.1,
                            .babblers = 0.1,
                            .peer_partitions = true}}),
    [](const auto& instance) { return instance.param.name; });

TEST(Cluster, WithoutWorkersEndsInTime) {
  Cluster cluster{1, {}};
  cluster.run(std::chrono::minutes(5));

  ASSERT_TRUE(cluster.job().over());
  const auto result = cluster.job().take_result();
  ASSERT_FALSE(result.has_value());
  EXPECT_EQ(result.error().code, ExitCode::kNoWorkers);
}

TEST(Cluster, AWorkerWithoutMasterGivesUp) {
  Hello hello;
  const Time start{};
  WorkerSession session{hello, Timers{}, std::chrono::seconds(60), start};
  for (int second = 1; second < 60; ++second) {
    session.tick(start + std::chrono::seconds(second));
  }
  EXPECT_FALSE(session.over());

  session.tick(start + std::chrono::seconds(60));

  EXPECT_TRUE(session.over());
  const auto actions = session.take_actions();
  ASSERT_EQ(actions.size(), 1U);
  EXPECT_EQ(std::get<Finish>(actions[0]).code, ExitCode::kMasterGone);
}

// A million log lines would say nothing.
class Quiet : public ::testing::Environment {
  void SetUp() override { spdlog::set_level(spdlog::level::off); }
};
const auto* const quiet = ::testing::AddGlobalTestEnvironment(new Quiet);

}  // namespace
}  // namespace preheat
