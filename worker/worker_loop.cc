#include "worker/worker_loop.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <csignal>
#include <deque>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "cache/renderer.h"
#include "common/self_test.h"
#include "common/zmq_transport.h"
#include "worker/worker_session.h"

namespace preheat {
namespace {

constexpr std::chrono::milliseconds kWait{50};
constexpr std::chrono::milliseconds kWaitWhileFull{5};
constexpr std::size_t kReceivedPerTurn = 64;
constexpr std::size_t kQueuedMax = 1024;

Hello hello_of(const WorkerOptions& options) {
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
  return hello;
}

class WorkerLoop {
 public:
  WorkerLoop(const WorkerOptions& options, SecureTransport& opened, const Hello& hello, int wake_fd)
      : master_(opened.endpoint),
        session_id_(hello.session),
        wake_fd_(wake_fd),
        eviction_(options.eviction),
        session_(hello, Timers{}.scaled(time_scale()), from_seconds(options.give_up_seconds),
                 Clock::now()),
        transport_(*opened.transport) {}

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
  void on(const VoxelNeeded& needed) { session_.on_voxel_needed(needed.voxel); }
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

  void send() {
    for (Outgoing& outgoing : session_.take_outgoing()) {
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
  }

  void wait() {
    std::vector<Channel*> channels{control_.get()};
    if (bulk_) { channels.push_back(bulk_.get()); }
    transport_.wait(channels, wake_fd_, queued_.empty() ? kWait : kWaitWhileFull);
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
  WorkerSession session_;
  Transport& transport_;
  std::unique_ptr<Channel> control_;
  std::unique_ptr<Channel> bulk_;
  std::deque<Queued> queued_;
  std::optional<Finish> finish_;
  std::unique_ptr<Renderer> renderer_;  // last, so that its threads end before what they wake
};

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
  for (;;) {
    // A new session each time: no master takes this worker for one it has known.
    WorkerLoop loop{options, *opened, hello_of(options), wake_fd};
    Result<void> served = loop.run(stop_signal);
    if (!options.keep || !loop.next_master()) { return served; }
    spdlog::info("event=waiting_for_next_master after=\"{}\"",
                 served ? "the job is done" : served.error().message);
  }
}

}  // namespace preheat
