// preheat-worker: renders tiles for a master until the job is done.
#include <spdlog/spdlog.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <atomic>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <string>

#include "common/byte_size.h"
#include "common/limits.h"
#include "common/log.h"
#include "common/self_test.h"
#include "worker/worker_loop.h"

namespace {

std::atomic<int> stop_signal{0};
std::atomic<int> stop_wake_fd{-1};

// The first signal asks for an orderly end; the handler is gone after it, so a second one ends the
// process at once.
extern "C" void on_stop_signal(int signal) {
  stop_signal.store(signal);
  const int saved = errno;
  const std::uint64_t one = 1;
  static_cast<void>(!::write(stop_wake_fd.load(), &one, sizeof one));
  errno = saved;
}

void catch_stop_signals() {
  struct sigaction action {};
  action.sa_handler = on_stop_signal;
  action.sa_flags = static_cast<int>(SA_RESETHAND);
  sigemptyset(&action.sa_mask);
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) { ::sigaction(signal, &action, nullptr); }
  ::signal(SIGPIPE, SIG_IGN);
}

preheat::Result<void> read_cache_size(const std::string& text, preheat::WorkerOptions& options) {
  if (text.empty()) { return {}; }
  if (text.ends_with('%')) {
    options.cache_kind = preheat::CacheRequestKind::kShare;
    return preheat::parse_percentage(text).map([&](double share) { options.cache_share = share; });
  }
  options.cache_kind = preheat::CacheRequestKind::kBytes;
  return preheat::parse_bytes(text).map([&](std::uint64_t bytes) { options.cache_bytes = bytes; });
}

}  // namespace

int main(int argc, char** argv) {
  using preheat::ExitCode;
  preheat::set_up_logging("preheat-worker");
  preheat::WorkerOptions options;
  std::string cache;
  CLI::App app{
      "Renders tiles for a preheat master. All it knows of the scene comes over the network; it "
      "opens no scene file and keeps at most --cache bytes of it. Ends with 0 when the job is "
      "done, "
      "4 when the master is gone or refuses, 7 when versions or instruction sets differ."};
  app.add_option("--connect", options.connect,
                 "The master's address, tcp://HOST:PORT, as `preheat render --listen` names it")
      ->required();
  app.add_option("--cache", cache,
                 "Memory for voxels: bytes, or with KiB, MiB, GiB, or a percentage of the scene's "
                 "resident size; the master decides without it");
  app.add_option("--threads", options.threads, "Tracing threads")
      ->check(CLI::Range(1U, preheat::kThreadsMax))
      ->capture_default_str();
  app.add_option("--give-up", options.give_up_seconds,
                 "Seconds without a word from the master before giving up")
      ->check(CLI::Range(0.1, 1e6))
      ->capture_default_str();
  app.add_option_function<std::string>(
         "--eviction",
         [&options](const std::string& name) { options.eviction = *preheat::eviction_of(name); },
         "Which voxel goes first when the cache is full: lru, lfu or s3-fifo")
      ->check([](const std::string& name) {
        return preheat::eviction_of(name) ? std::string{}
                                          : "eviction \"" + name + "\" is not lru, lfu or s3-fifo";
      })
      ->envname("PREHEAT_EVICTION");
  app.add_option("--peer-listen", options.peer_listen,
                 "Where other workers ask this one for voxels, tcp://HOST:PORT, port 0 = any; "
                 "without it any port of the address that the way to the master begins at");
  app.add_flag("--keep", options.keep,
               "Stay when the job is done or the master is gone, and serve the next master at "
               "this address; ends by a signal, or with 4 or 7 when refused");
  auto* const insecure = app.add_flag("--insecure-no-auth", options.security.insecure_no_auth,
                                      "Allow an address that is not loopback without keys: "
                                      "nothing is encrypted or authenticated");
  app.add_option("--keys", options.security.keys_folder,
                 "Folder made by `preheat keygen`; this program reads DIR/worker")
      ->type_name("DIR")
      ->envname("PREHEAT_KEYS")
      ->excludes(insecure);
  app.set_version_flag("--version", std::string("preheat-worker ") + preheat::build_version());
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : static_cast<int>(ExitCode::kUsage);
  }
  if (const auto fine = read_cache_size(cache, options); !fine) {
    spdlog::error("{}", fine.error().message);
    return static_cast<int>(fine.error().code);
  }
  const int wake_fd = ::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
  if (wake_fd < 0) {
    spdlog::error("event=eventfd_failed reason=\"{}\"", std::strerror(errno));
    return static_cast<int>(ExitCode::kFailed);
  }
  stop_wake_fd.store(wake_fd);
  catch_stop_signals();
  const auto done = preheat::run_worker(options, stop_signal, wake_fd);
  if (done) { return static_cast<int>(ExitCode::kDone); }
  spdlog::error("event=worker_ended exit={} reason=\"{}\"", static_cast<int>(done.error().code),
                done.error().message);
  return static_cast<int>(done.error().code);
}
