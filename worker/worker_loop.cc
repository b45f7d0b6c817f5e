#include "worker/worker_loop.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <csignal>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "cache/renderer.h"
#include "common/self_test.h"
#include "common/zmq_transport.h"
#include "worker/local_address.h"
#include "worker/worker_session.h"

namespace preheat {
namespace {

constexpr std::chrono::milliseconds kWait{50};
constexpr std::chrono::milliseconds kWaitWhileFull{5};
constexpr std::chrono::milliseconds kBetweenLooks{250};
constexpr std::size_t kReceivedPerTurn = 64;
constexpr std::size_t kQueuedMax = 1024;
constexpr std::size_t kQueuedPerPeerMax = PeerServer::kWaitingPerPeerMax;

// This worker's address on the way to the master. A master's name may be known only once it runs;
// until then nobody can be greeted, and where others reach this worker is not known either.
Result<std::string> wait_for_way(Transport& transport, const Endpoint& master,
                                 const WorkerOptions& options,
                                 const std::atomic<int>& stop_signal) {
  const Time end = Clock::now() + from_seconds(options.give_up_seconds);
  for (bool told = false;; told = true) {
    Result<std::string> own = local_address_towards(master);
    if (own) { return own; }
    if (const int signal = stop_signal.load(); signal != 0) {
      return fail(signal == SIGINT ? ExitCode::kInterrupted : ExitCode::kTerminated,
                  "ended by a signal");
    }
    if (Clock::now() >= end) {
      return fail(ExitCode::kMasterGone, fmt::format("after {:.0f} seconds still {}",
                                                     options.give_up_seconds, own.error().message));
    }
    if (!told) { spdlog::info("event=waiting_for_way reason=\"{}\"", own.error().message); }
    transport.wait({}, -1, kBetweenLooks);
  }
}

bool is_any_address(const std::string& host) {
  return host == "*" || host == "0.0.0.0" || host == "[::]";
}

// Where others reach this worker.
struct PeerListener {
  std::optional<Endpoint> wish{};  // of the user's; without one a worker does without, if it must
  std::unique_ptr<Channel> channel{};
  std::string endpoint{};  // as others are told; empty: nobody is served
};

// For one more master, `own` being this worker's address on the way to it.
Result<void> listen_for_peers(Transport& transport, const std::string& own, PeerListener& peers) {
  const Endpoint at = peers.wish.value_or(Endpoint{own, 0});
  peers.endpoint.clear();
  // At an address of the user's choice the socket goes on from master to master: ZeroMQ lets go of
  // a port only some time after its socket is closed.
  if (!peers.wish) { peers.channel.reset(); }
  if (!peers.channel) {
    auto channel = transport.listen(at.text(), ChannelKind::kPeer);
    if (!channel && peers.wish) { return tl::unexpected(channel.error()); }
    if (!channel) {
      spdlog::warn("event=no_peer_socket reason=\"{}\"", channel.error().message);
      return {};
    }
    peers.channel = *std::move(channel);
  }
  const std::uint16_t port = parse_endpoint(peers.channel->endpoint())->port;
  peers.endpoint = Endpoint{is_any_address(at.host) ? own : at.host, port}.text();
  return {};
}

Hello hello_of(const WorkerOptions& options, const std::string& peer_endpoint) {
  Hello hello;
  hello.session = random_session();
  hello.build.text = build_version();
  hello.isa.text = tracing_isa();
  hello.self_test = numeric_self_test();
  hello.threads = options.threads;
  hello.cache_kind = options.cache_kind;
  hello.cache_share = options.cache_share;
  hello.cache_bytes = options.cache_bytes;
  hello.process_id = static_cast<std::uint32_t>(::getpid());
  hello.peer_endpoint.text = peer_endpoint;
  return hello;
}

class WorkerLoop {
 public:
  // `opened` and `peers_in` outlive this; `peers_in` is nullptr where nobody is served.
  WorkerLoop(const WorkerOptions& options, SecureTransport& opened, const Hello& hello, int wake_fd,
             Channel* peers_in)
      : master_(opened.endpoint),
        session_id_(hello.session),
        wake_fd_(wake_fd),
        eviction_(options.eviction),
        reach_settled_(options.security.reach_settled()),
        session_(hello, Timers{}.scaled(time_scale()), from_seconds(options.give_up_seconds),
                 Clock::now()),
        transport_(*opened.transport),
        peers_in_(peers_in) {}

  Result<void> run(const std::atomic<int>& stop_signal) {
    auto control = transport_.connect(master_.text(), ChannelKind::kControl, session_id_);
    if (!control) { return tl::unexpected(control.error()); }
    control_ = std::move(*control);
    while (!finish_) {
      if (const int signal = stop_signal.load(); signal != 0) {
        session_.leave(signal == SIGINT ? ExitCode::kInterrupted : ExitCode::kTerminated);
      }
      turn();
      if (!finish_) { wait(); }
    }
    say_last_words();
    if (finish_->code == ExitCode::kDone) { return {}; }
    return fail(finish_->code, finish_->text);
  }

  // After run(): whether the next master at the same address may want this worker.
  [[nodiscard]] bool next_master() const { return finish_ && finish_->next_master; }

 private:
  // One round: hear, look at the renderer, think, do, say.
  void turn() {
    tell_counts();
    session_.on_handshakes(control_->handshakes());
    receive(control_.get(), ChannelKind::kControl);
    receive(bulk_.get(), ChannelKind::kBulk);
    receive_from_peers();
    if (renderer_) {
      for (RendererEvent& event : renderer_->take_events()) {
        std::visit([this](auto& what) { on(what); }, event);
      }
      tell_counts();
    }
    session_.tick(Clock::now());
    act();
    send();
  }

  void tell_counts() {
    if (renderer_) { session_.set_counts({renderer_->progress(), renderer_->stats()}); }
  }

  void on(const HotSetReady& ready) { session_.on_hot_set_ready(ready.preload); }
  void on(const VoxelNeeded& needed) { session_.on_voxel_needed(needed); }
  void on(const TileDone& done) { session_.on_tile_done(done, Clock::now()); }
  void on(const RendererFailed& failed) { session_.on_renderer_failed(failed.error); }

  void receive(Channel* channel, ChannelKind kind) {
    for (std::size_t i = 0; channel != nullptr && i < kReceivedPerTurn; ++i) {
      const std::optional<Received> received = channel->receive();
      if (!received) { return; }
      const auto frame = decode_frame(received->head.bytes);
      if (!frame) {
        if (frame.error().fault == FrameFault::kVersion) {
          session_.on_other_version(frame.error().version);
        }
        continue;
      }
      if (kind == ChannelKind::kControl) {
        session_.on_control(*frame, Clock::now());
      } else {
        session_.on_bulk(*frame, received->data, Clock::now());
      }
    }
  }

  void receive_from_peers() {
    for (std::size_t i = 0; peers_in_ != nullptr && i < kReceivedPerTurn; ++i) {
      const std::optional<Received> received = peers_in_->receive();
      if (!received) { break; }
      // Whoever sends no sense is not answered.
      const auto frame = decode_frame(received->head.bytes);
      if (frame) { session_.on_peer_request(received->session, *frame, Clock::now()); }
    }
    for (auto& [key, link] : peers_out_) {
      for (std::size_t i = 0; i < kReceivedPerTurn; ++i) {
        const std::optional<Received> received = link.channel->receive();
        if (!received) { break; }
        const auto frame = decode_frame(received->head.bytes);
        if (frame) {
          session_.on_peer_answer(link.session, *frame, received->data, Clock::now());
        } else {
          session_.on_peer_nonsense(link.session, Clock::now());
        }
      }
      if (link.channel->dropped() > 0) { session_.on_peer_nonsense(link.session, Clock::now()); }
    }
  }

  void act() {
    for (WorkerAction& action : session_.take_actions()) {
      std::visit([this](auto& what) { perform(what); }, action);
    }
  }

  void perform(const ConnectBulk& connect) {
    Endpoint endpoint = master_;
    endpoint.port = connect.port;
    auto bulk = transport_.connect(endpoint.text(), ChannelKind::kBulk, session_id_);
    if (!bulk) {
      finish_ = Finish{bulk.error().code, bulk.error().message};
      return;
    }
    bulk_ = std::move(*bulk);
    std::erase_if(queued_,
                  [](const Queued& queued) { return queued.channel == ChannelKind::kBulk; });
  }
  void perform(const ConnectPeer& connect) {
    const PeerAddress& peer = connect.peer;
    // The master's word does not open what the user keeps shut. Who cannot be reached is silent.
    const Result<Endpoint> endpoint = check_endpoint(peer.endpoint.text, reach_settled_);
    if (!endpoint) { return; }
    auto channel = transport_.connect(endpoint->text(), ChannelKind::kPeer, session_id_);
    if (!channel) { return; }
    peers_out_[key_of(peer.session)] = {peer.session, std::move(*channel), {}};
  }
  void perform(const DisconnectPeer& disconnect) { peers_out_.erase(key_of(disconnect.session)); }
  void perform(StartRenderer& start) {
    renderer_.reset();
    start.options.eviction = eviction_;
    renderer_ = std::make_unique<Renderer>(std::move(start.tables), start.settings, start.options,
                                           [fd = wake_fd_] {
                                             const std::uint64_t one = 1;
                                             // Full means that the loop is awake already.
                                             static_cast<void>(!::write(fd, &one, sizeof one));
                                           });
  }
  void perform(SetHotVoxels& hot) {
    renderer_->set_hot_voxels(std::move(hot.voxels), std::move(hot.warm));
  }
  void perform(DeliverVoxel& deliver) {
    const Result<void> taken = renderer_->deliver(deliver.voxel, std::move(deliver.bytes));
    if (!taken) { session_.on_voxel_malformed(deliver.voxel, taken.error().message); }
  }
  void perform(const AddTile& add) { renderer_->add_tile(add.tile); }
  void perform(const CancelTile& cancel) { renderer_->cancel_tile(cancel.tile); }
  void perform(const TellAccesses&) { session_.on_accesses(renderer_->accesses_by_cell()); }
  void perform(Finish& finish) { finish_ = std::move(finish); }

  struct Queued {
    ChannelKind channel{};
    std::vector<std::byte> head{};
    Payload data{};
  };
  using SessionKey = std::pair<std::uint64_t, std::uint64_t>;
  static SessionKey key_of(const SessionId& session) { return {session.low, session.high}; }
  struct PeerLink {
    SessionId session{};
    std::unique_ptr<Channel> channel{};
    std::deque<Queued> queued{};
  };

  // What does not fit is lost: who waits for it looks elsewhere.
  static void add_to(std::deque<Queued>& queue, Queued queued) {
    if (queue.size() < kQueuedPerPeerMax) { queue.push_back(std::move(queued)); }
  }
  // True if nothing is left.
  static bool flush(Channel& channel, const SessionId& to, std::deque<Queued>& queue) {
    while (!queue.empty()) {
      const SendOutcome outcome = channel.send(to, queue.front().head, queue.front().data);
      if (outcome == SendOutcome::kFull) { return false; }
      if (outcome == SendOutcome::kGone) {
        queue.clear();
        break;
      }
      queue.pop_front();
    }
    return true;
  }

  void send_to_peers() {
    for (PeerAnswer& answer : session_.take_answers()) {
      add_to(answers_[key_of(answer.to)],
             {ChannelKind::kPeer, encode_frame(session_.job(), answer.message),
              std::move(answer.data)});
    }
    peers_full_ = false;
    for (auto entry = answers_.begin(); entry != answers_.end();) {
      const bool empty =
          flush(*peers_in_, {entry->first.first, entry->first.second}, entry->second);
      peers_full_ = peers_full_ || !empty;
      entry = empty ? answers_.erase(entry) : std::next(entry);
    }
    for (auto& [key, link] : peers_out_) {
      peers_full_ = !flush(*link.channel, link.session, link.queued) || peers_full_;
    }
  }

  void send() {
    for (Outgoing& outgoing : session_.take_outgoing()) {
      if (outgoing.channel == ChannelKind::kPeer) {
        const auto link = peers_out_.find(key_of(outgoing.to));
        if (link == peers_out_.end()) { continue; }
        add_to(link->second.queued,
               {ChannelKind::kPeer, encode_frame(session_.job(), outgoing.message), {}});
        continue;
      }
      // A Hello is not about a job yet; everything is repeated where it matters, so a full queue
      // may drop it.
      if (queued_.size() == kQueuedMax) { break; }
      queued_.push_back({outgoing.channel, encode_frame(session_.job(), outgoing.message),
                         std::move(outgoing.data)});
    }
    std::deque<Queued> later;
    std::array<bool, 2> full{};
    for (Queued& queued : queued_) {
      const auto index = static_cast<std::size_t>(queued.channel);
      Channel* channel = queued.channel == ChannelKind::kControl ? control_.get() : bulk_.get();
      if (!full[index] && channel->send({}, queued.head, queued.data) == SendOutcome::kSent) {
        continue;
      }
      full[index] = true;  // what comes later stays behind it
      later.push_back(std::move(queued));
    }
    queued_ = std::move(later);
    send_to_peers();
  }

  void wait() {
    std::vector<Channel*> channels{control_.get()};
    if (bulk_) { channels.push_back(bulk_.get()); }
    if (peers_in_ != nullptr) { channels.push_back(peers_in_); }
    for (const auto& [key, link] : peers_out_) { channels.push_back(link.channel.get()); }
    const bool full = !queued_.empty() || peers_full_;
    transport_.wait(channels, wake_fd_, full ? kWaitWhileFull : kWait);
    std::uint64_t wakes = 0;
    static_cast<void>(!::read(wake_fd_, &wakes, sizeof wakes));
  }

  // Whatever the network still takes within a second; ZeroMQ lingers as long again.
  void say_last_words() {
    const Time end = Clock::now() + std::chrono::seconds(1);
    send();
    while (!queued_.empty() && Clock::now() < end) {
      transport_.wait({}, -1, kWaitWhileFull);
      send();
    }
  }

  Endpoint master_;
  SessionId session_id_;
  int wake_fd_;
  Eviction eviction_;
  bool reach_settled_;
  WorkerSession session_;
  Transport& transport_;
  std::unique_ptr<Channel> control_;
  std::unique_ptr<Channel> bulk_;
  std::deque<Queued> queued_;
  Channel* peers_in_;                         // others ask here
  std::map<SessionKey, PeerLink> peers_out_;  // whom this worker asks
  std::map<SessionKey, std::deque<Queued>> answers_;
  bool peers_full_ = false;
  std::optional<Finish> finish_;
  std::unique_ptr<Renderer> renderer_;  // last, so that its threads end before what they wake
};

struct Service {
  Result<void> served{};
  bool next_master = false;  // the next one may want this worker
};

// One master, from the first look for it to its end or this worker's.
Service serve(const WorkerOptions& options, SecureTransport& opened, PeerListener& peers,
              const std::atomic<int>& stop_signal, int wake_fd) {
  const Result<std::string> own =
      wait_for_way(*opened.transport, opened.endpoint, options, stop_signal);
  if (!own) { return {tl::unexpected(own.error()), stop_signal.load() == 0}; }
  if (auto listening = listen_for_peers(*opened.transport, *own, peers); !listening) {
    return {tl::unexpected(listening.error()), false};
  }
  // A new session each time: no master takes this worker for one it has known.
  WorkerLoop loop{options, opened, hello_of(options, peers.endpoint), wake_fd, peers.channel.get()};
  Result<void> served = loop.run(stop_signal);
  return {std::move(served), loop.next_master()};
}

}  // namespace

Result<void> run_worker(const WorkerOptions& options, const std::atomic<int>& stop_signal,
                        int wake_fd) {
  Result<SecureTransport> opened =
      open_transport(options.connect, options.security, KeyRole::kWorker);
  if (!opened) { return tl::unexpected(opened.error()); }
  if (opened->endpoint.port == 0) {
    return fail(
        ExitCode::kUsage,
        fmt::format("bad address \"{}\": a worker needs the master's port", options.connect));
  }
  PeerListener peers;
  if (!options.peer_listen.empty()) {
    Result<Endpoint> wish = check_endpoint(options.peer_listen, options.security.reach_settled());
    if (!wish) { return tl::unexpected(wish.error()); }
    peers.wish = *std::move(wish);
  }
  for (;;) {
    const auto [served, next_master] = serve(options, *opened, peers, stop_signal, wake_fd);
    if (!options.keep || !next_master) { return served; }
    spdlog::info("event=waiting_for_next_master after=\"{}\"",
                 served ? "the job is done" : served.error().message);
  }
}

}  // namespace preheat
