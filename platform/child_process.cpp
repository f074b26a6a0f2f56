#include "platform/child_process.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <filesystem>
#include <string>
#include <thread>
#include <vector>

#include "platform/input_error.h"

extern char** environ;

namespace pptam::platform {
namespace {

constexpr size_t kErrorBytes = 2000;  // of stderr's end that errors() keeps
constexpr int kErrorLines = 5;
constexpr size_t kMaxChildLineBytes = 4096;
constexpr int kLinesFd = 3;      // in the child
constexpr int kFirstOwnFd = 10;  // ours lie above those that the child is given, also if this program began without

void close_fd(int* fd) {
  if (*fd >= 0) ::close(*fd);
  *fd = -1;
}

// Children that run, for end_children(); 0: an empty place. More than fit are not known there.
constexpr size_t kMaxKnownChildren = 64;  // a study's threads have one or two each
std::atomic<int> known_children[kMaxKnownChildren];

void replace_known(int from, int to) {
  for (std::atomic<int>& place : known_children) {
    int expected = from;
    if (place.compare_exchange_strong(expected, to)) return;
  }
}
void remember_child(int pid) {
  replace_known(0, pid);
}
// Before it is reaped: afterwards the number may be another process'.
void forget_child(int pid) {
  replace_known(pid, 0);
}

// Whether the child has ended; it is not reaped. False also when that cannot be told.
bool has_ended(int pid, int options) {
  siginfo_t info = {};
  int result = 0;
  do {
    result = ::waitid(P_PID, static_cast<id_t>(pid), &info, WEXITED | WNOWAIT | options);
  } while (result < 0 && errno == EINTR);
  return result == 0 && info.si_pid == pid;
}

int wait_for(int pid) {
  has_ended(pid, 0);
  forget_child(pid);
  int status = 0;
  while (::waitpid(pid, &status, 0) < 0) {
    if (errno != EINTR) return -1;
  }
  return status;
}

// The same, but the child is killed after the time given.
int wait_for(int pid, std::chrono::seconds most) {
  using Clock = std::chrono::steady_clock;
  constexpr std::chrono::microseconds kLongestPause(20000);
  const Clock::time_point end = Clock::now() + most;
  for (std::chrono::microseconds pause(200); Clock::now() < end; pause = std::min(2 * pause, kLongestPause)) {
    if (has_ended(pid, WNOHANG)) return wait_for(pid);
    std::this_thread::sleep_for(pause);
  }
  ::kill(pid, SIGKILL);
  return wait_for(pid);
}

// False when nothing can be read or written for so long.
bool wait_until_ready(int fd, short event, int most_s) {
  pollfd one = {fd, event, 0};
  for (;;) {
    const int ready = ::poll(&one, 1, most_s * 1000);
    if (ready >= 0 || errno != EINTR) return ready != 0;
  }
}

void move_up(int* fd) {
  const int moved = ::fcntl(*fd, F_DUPFD_CLOEXEC, kFirstOwnFd);
  if (moved < 0) return;
  ::close(*fd);
  *fd = moved;
}

// ends[0] for reading, ends[1] for writing; ours never waits.
bool open_pipe(int* ends, bool reading) {
  if (::pipe2(ends, O_CLOEXEC) != 0) {
    ends[0] = ends[1] = -1;
    return false;
  }
  move_up(&ends[0]);
  move_up(&ends[1]);
  const int ours = reading ? ends[0] : ends[1];
  return ::fcntl(ours, F_SETFL, ::fcntl(ours, F_GETFL) | O_NONBLOCK) == 0;
}

void limit(int pid, const ChildLimits& limits) {
  const rlimit memory = {limits.memory_bytes, limits.memory_bytes};
  const rlimit cpu = {static_cast<rlim_t>(limits.cpu_s), static_cast<rlim_t>(limits.cpu_s)};
  if (limits.memory_bytes > 0) ::prlimit(pid, RLIMIT_DATA, &memory, nullptr);
  if (limits.cpu_s > 0) ::prlimit(pid, RLIMIT_CPU, &cpu, nullptr);
}

// Readable and writable, already unlinked, closed on exec.
int open_scratch_file() {
  std::error_code ignored;
  std::filesystem::path folder = std::filesystem::temp_directory_path(ignored);
  if (folder.empty()) folder = "/tmp";
  std::string name = (folder / "pocket-ptam-XXXXXX").string();
  const int fd = ::mkostemp(name.data(), O_CLOEXEC);
  if (fd >= 0) ::unlink(name.c_str());
  return fd;
}

std::string last_lines(int fd) {
  const off_t size = ::lseek(fd, 0, SEEK_END);
  const off_t begin = std::max<off_t>(0, size - static_cast<off_t>(kErrorBytes));
  std::string tail(static_cast<size_t>(std::max<off_t>(0, size - begin)), '\0');
  const ssize_t got = ::pread(fd, tail.data(), tail.size(), begin);
  tail.resize(static_cast<size_t>(std::max<ssize_t>(0, got)));

  std::vector<std::string> lines(1);
  for (const char c : tail) {
    if (c == '\n' || c == '\r') {
      if (!lines.back().empty()) lines.emplace_back();
    } else {
      lines.back().push_back(static_cast<unsigned char>(c) < ' ' || c == '\x7f' ? ' ' : c);  // no terminal codes
    }
  }
  if (lines.back().empty()) lines.pop_back();
  std::string joined;
  const size_t skip = lines.size() > kErrorLines ? lines.size() - kErrorLines : 0;
  for (size_t i = skip; i < lines.size(); ++i) joined += (joined.empty() ? "" : "; ") + lines[i];
  return joined;
}

}  // namespace

ChildProcess::ChildProcess(const std::vector<std::string>& argv, Pipe pipe, const ChildLimits& limits)
    : program_(argv.at(0)), silence_s_(limits.silence_s), writing_(pipe == Pipe::kWriteStdin) {
  const bool with_lines = pipe == Pipe::kReadStdoutAndLines;
  int data[2] = {-1, -1};
  int lines[2] = {-1, -1};
  stderr_fd_ = open_scratch_file();
  if (stderr_fd_ >= 0) move_up(&stderr_fd_);
  const bool ready = stderr_fd_ >= 0 && open_pipe(data, !writing_) && (!with_lines || open_pipe(lines, true));
  const std::string why = std::strerror(errno);
  pipe_fd_ = writing_ ? data[1] : data[0];
  lines_fd_ = lines[0];
  int child_end = writing_ ? data[0] : data[1];
  int error = 0;
  pid_t pid = -1;
  if (ready) {
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    const int piped = writing_ ? STDIN_FILENO : STDOUT_FILENO;
    const int silent = writing_ ? STDOUT_FILENO : STDIN_FILENO;
    posix_spawn_file_actions_adddup2(&actions, child_end, piped);
    posix_spawn_file_actions_adddup2(&actions, stderr_fd_, STDERR_FILENO);
    posix_spawn_file_actions_addopen(&actions, silent, "/dev/null", O_RDWR, 0);
    if (with_lines) posix_spawn_file_actions_adddup2(&actions, lines[1], kLinesFd);
    std::vector<char*> arguments;
    arguments.reserve(argv.size() + 1);
    for (const std::string& word : argv) arguments.push_back(const_cast<char*>(word.c_str()));
    arguments.push_back(nullptr);
    // A process group of its own: a Ctrl-C on the terminal is ours to answer, a video that is being encoded goes on.
    posix_spawnattr_t attributes;
    posix_spawnattr_init(&attributes);
    sigset_t defaults;
    sigemptyset(&defaults);
    sigaddset(&defaults, SIGPIPE);
    posix_spawnattr_setsigdefault(&attributes, &defaults);
    posix_spawnattr_setpgroup(&attributes, 0);
    posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETPGROUP | POSIX_SPAWN_SETSIGDEF | POSIX_SPAWN_SETSIGMASK);
    // A handler that ends this process must know of the child: its signals wait until it is remembered.
    sigset_t all, before;
    sigfillset(&all);
    pthread_sigmask(SIG_BLOCK, &all, &before);
    posix_spawnattr_setsigmask(&attributes, &before);
    error = ::posix_spawnp(&pid, program_.c_str(), &actions, &attributes, arguments.data(), environ);
    if (error == 0) remember_child(pid);
    pthread_sigmask(SIG_SETMASK, &before, nullptr);
    posix_spawnattr_destroy(&attributes);
    posix_spawn_file_actions_destroy(&actions);
  }
  close_fd(&child_end);
  close_fd(&lines[1]);
  if (!ready || error != 0) {
    close_fd(&pipe_fd_);
    close_fd(&lines_fd_);
    close_fd(&stderr_fd_);
    if (!ready) throw InputError("cannot run " + program_ + ": no temporary file or pipe: " + why);
    if (error != ENOENT) throw InputError("cannot run " + program_ + ": " + std::strerror(error));
    const std::string package = program_ == "ffprobe" ? "ffmpeg" : program_;
    throw InputError("cannot run " + program_ + ": install it, on Debian with: apt install " + package);
  }
  pid_ = pid;
  limit(pid_, limits);
}

ChildProcess::~ChildProcess() {
  close_fd(&pipe_fd_);
  close_fd(&lines_fd_);
  if (pid_ > 0) {
    ::kill(pid_, SIGKILL);
    wait_for(pid_);
  }
  close_fd(&stderr_fd_);
}

void ChildProcess::kill_silent_child() {
  if (pid_ > 0) ::kill(pid_, SIGKILL);
  close_fd(&pipe_fd_);
  close_fd(&lines_fd_);
  throw InputError(program_ + " gave nothing for " + std::to_string(silence_s_) + " seconds and was ended");
}

size_t ChildProcess::read(void* data, size_t bytes) {
  size_t done = 0;
  while (done < bytes && pipe_fd_ >= 0) {
    const ssize_t got = ::read(pipe_fd_, static_cast<char*>(data) + done, bytes - done);
    if (got == 0) break;
    if (got > 0) done += static_cast<size_t>(got);
    if (got < 0 && errno == EAGAIN && !wait_until_ready(pipe_fd_, POLLIN, silence_s_)) kill_silent_child();
    if (got < 0 && errno != EINTR && errno != EAGAIN) break;
  }
  return done;
}

bool ChildProcess::read_line(std::string* line) {
  size_t end = lines_.find('\n');
  while (end == std::string::npos && lines_.size() <= kMaxChildLineBytes && lines_fd_ >= 0) {
    char chunk[kMaxChildLineBytes];
    const ssize_t got = ::read(lines_fd_, chunk, sizeof chunk);
    if (got == 0) break;
    if (got > 0) lines_.append(chunk, static_cast<size_t>(got));
    if (got < 0 && errno == EAGAIN && !wait_until_ready(lines_fd_, POLLIN, silence_s_)) kill_silent_child();
    if (got < 0 && errno != EINTR && errno != EAGAIN) break;
    end = lines_.find('\n');
  }
  if (end == std::string::npos) return false;
  line->assign(lines_, 0, end);
  lines_.erase(0, end + 1);
  return true;
}

bool ChildProcess::write(const void* data, size_t bytes) {
  // A write to a child that has ended raises SIGPIPE: held back in this thread, and taken away before it is let go.
  sigset_t sigpipe, pending, before;
  sigemptyset(&sigpipe);
  sigaddset(&sigpipe, SIGPIPE);
  sigpending(&pending);
  const bool was_pending = sigismember(&pending, SIGPIPE) == 1;
  pthread_sigmask(SIG_BLOCK, &sigpipe, &before);

  size_t done = 0;
  bool broken = pipe_fd_ < 0;
  while (done < bytes && !broken) {
    const ssize_t put = ::write(pipe_fd_, static_cast<const char*>(data) + done, bytes - done);
    if (put >= 0) {
      done += static_cast<size_t>(put);
    } else if (errno == EAGAIN) {
      broken = !wait_until_ready(pipe_fd_, POLLOUT, silence_s_);
    } else if (errno != EINTR) {
      broken = true;
      const timespec now = {0, 0};
      if (errno == EPIPE && !was_pending) sigtimedwait(&sigpipe, nullptr, &now);
    }
  }
  pthread_sigmask(SIG_SETMASK, &before, nullptr);
  return !broken;
}

int ChildProcess::finish() {
  close_fd(&pipe_fd_);
  close_fd(&lines_fd_);
  if (pid_ <= 0) return -1;
  const int status = wait_for(pid_, std::chrono::seconds(writing_ ? kMaxEndingS : silence_s_));
  pid_ = -1;
  errors_ = last_lines(stderr_fd_);
  return WIFSIGNALED(status) ? 128 + WTERMSIG(status) : WEXITSTATUS(status);
}

void end_children() noexcept {
  for (const std::atomic<int>& place : known_children) {
    const int pid = place.load();
    if (pid <= 0) continue;
    ::kill(pid, SIGKILL);
    ::waitpid(pid, nullptr, 0);
  }
}

}  // namespace pptam::platform
