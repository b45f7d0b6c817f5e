#include "master/worker_processes.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <thread>

namespace preheat {
namespace {

// Between fork and exec only what is safe in a copy of a process with threads.
[[noreturn]] void become(const char* program, char* const* arguments, pid_t parent,
                         int error_pipe) {
  ::prctl(PR_SET_PDEATHSIG, SIGTERM);
  if (::getppid() != parent) { ::_exit(1); }
  ::setpgid(0, 0);
  sigset_t none;
  sigemptyset(&none);
  ::sigprocmask(SIG_SETMASK, &none, nullptr);
  const int nothing = ::open("/dev/null", O_RDONLY);
  ::dup2(nothing, STDIN_FILENO);
  ::dup2(STDERR_FILENO, STDOUT_FILENO);
  // Sockets and the store are not the child's business; the pipe closes itself.
  ::dup2(error_pipe, 3);
  ::fcntl(3, F_SETFD, FD_CLOEXEC);
  ::close_range(4, ~0U, 0);
  ::execvp(program, arguments);
  const int error = errno;
  static_cast<void>(!::write(3, &error, sizeof error));
  ::_exit(127);
}

}  // namespace

Result<void> WorkerProcesses::start(const std::string& program,
                                    const std::vector<std::string>& arguments) {
  const auto failed = [&program](int error) {
    return fail(ExitCode::kFailed,
                fmt::format("cannot start {}: {}", program, std::strerror(error)));
  };
  std::vector<char*> argv{const_cast<char*>(program.c_str())};
  for (const std::string& argument : arguments) {
    argv.push_back(const_cast<char*>(argument.c_str()));
  }
  argv.push_back(nullptr);
  std::array<int, 2> error_pipe{};
  if (::pipe2(error_pipe.data(), O_CLOEXEC) != 0) { return failed(errno); }
  const pid_t parent = ::getpid();
  const pid_t child = ::fork();
  if (child == 0) { become(program.c_str(), argv.data(), parent, error_pipe[1]); }
  const int fork_error = errno;
  ::close(error_pipe[1]);
  int error = 0;
  ssize_t got = 0;
  do {
    got = child < 0 ? 0 : ::read(error_pipe[0], &error, sizeof error);
  } while (got < 0 && errno == EINTR);
  ::close(error_pipe[0]);
  if (child < 0) { return failed(fork_error); }
  if (got > 0) {
    ::waitpid(child, nullptr, 0);
    return failed(error);
  }
  pids_.push_back(child);
  return {};
}

std::vector<WorkerProcesses::Ended> WorkerProcesses::reap() {
  std::vector<Ended> ended;
  std::erase_if(pids_, [&ended](pid_t pid) {
    int status = 0;
    const pid_t result = ::waitpid(pid, &status, WNOHANG);
    if (result == 0 || (result < 0 && errno == EINTR)) { return false; }
    ended.push_back({pid, result < 0            ? std::string("lost")
                          : WIFSIGNALED(status) ? fmt::format("signal {}", WTERMSIG(status))
                                                : fmt::format("exit {}", WEXITSTATUS(status))});
    return true;
  });
  return ended;
}

void WorkerProcesses::signal_all(int signal) const {
  for (const pid_t pid : pids_) { ::kill(pid, signal); }
}

void WorkerProcesses::wait_for_all(Duration patience) {
  const Time end = Clock::now() + patience;
  while (!pids_.empty() && Clock::now() < end) {
    static_cast<void>(reap());
    if (!pids_.empty()) { std::this_thread::sleep_for(std::chrono::milliseconds(2)); }
  }
}

void WorkerProcesses::end_all(Duration patience, Duration grace) {
  wait_for_all(patience);
  if (pids_.empty()) { return; }
  signal_all(SIGTERM);
  wait_for_all(grace);
  if (pids_.empty()) { return; }
  signal_all(SIGKILL);
  wait_for_all(grace);
}

WorkerProcesses::~WorkerProcesses() {
  signal_all(SIGKILL);
  for (const pid_t pid : pids_) { ::waitpid(pid, nullptr, 0); }
}

}  // namespace preheat
