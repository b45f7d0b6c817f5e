// The programs as child processes, and ports for them.
#pragma once

#include <fcntl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <optional>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "tests/common/raw_connection.h"

namespace preheat {

namespace fs = std::filesystem;
using std::chrono::milliseconds;

// Timers as they are, so that a busy machine is not taken for a dead worker.
inline constexpr const char* kTimeScale = "1";
inline constexpr milliseconds kPatience{240'000};

// A child with its stdout and stderr in a file; killed if the test ends before it.
class Process {
 public:
  Process(const std::string& program, const std::vector<std::string>& arguments, fs::path log,
          const std::string& time_scale = kTimeScale)
      : log_(std::move(log)) {
    std::vector<char*> argv{const_cast<char*>(program.c_str())};
    for (const std::string& argument : arguments) {
      argv.push_back(const_cast<char*>(argument.c_str()));
    }
    argv.push_back(nullptr);
    pid_ = ::fork();
    if (pid_ != 0) { return; }
    const int out = ::open(log_.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0600);
    ::dup2(out, STDOUT_FILENO);
    ::dup2(out, STDERR_FILENO);
    ::setenv("PREHEAT_TIME_SCALE", time_scale.c_str(), 1);
    ::setenv("PREHEAT_LOG", "info", 1);
    ::execv(program.c_str(), argv.data());
    ::_exit(127);
  }
  ~Process() {
    if (running()) {
      ::kill(pid_, SIGKILL);
      ::waitpid(pid_, nullptr, 0);
    }
  }
  Process(const Process&) = delete;
  Process& operator=(const Process&) = delete;

  [[nodiscard]] pid_t pid() const { return pid_; }
  void signal(int number) const { ::kill(pid_, number); }

  [[nodiscard]] bool running() {
    if (!ended_) {
      int status = 0;
      if (::waitpid(pid_, &status, WNOHANG) == pid_) {
        ended_ = WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
      }
    }
    return !ended_;
  }

  // The exit code, a negative signal, or nothing after a minute.
  [[nodiscard]] std::optional<int> wait() {
    const auto end = std::chrono::steady_clock::now() + kPatience;
    while (running() && std::chrono::steady_clock::now() < end) {
      std::this_thread::sleep_for(milliseconds(5));
    }
    return ended_;
  }

  [[nodiscard]] std::string log() const {
    std::ifstream stream(log_);
    return {std::istreambuf_iterator<char>(stream), {}};
  }

 private:
  fs::path log_;
  pid_t pid_ = 0;
  std::optional<int> ended_{};
};

inline bool is_free(unsigned port) {
  const int fd = ::socket(AF_INET, SOCK_STREAM, 0);
  const sockaddr_in address = loopback(port);
  const bool free = ::bind(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0;
  ::close(fd);
  return free;
}

// A port with the one above, below the range from which the system takes its own.
inline unsigned free_port_pair() {
  std::mt19937 random{
      static_cast<std::uint32_t>(::getpid()) * 7919U +
      static_cast<std::uint32_t>(std::chrono::steady_clock::now().time_since_epoch().count())};
  for (;;) {
    const auto port = static_cast<unsigned>(20000 + random() % 10000);
    if (is_free(port) && is_free(port + 1)) { return port; }
  }
}

}  // namespace preheat
