#include "platform/child_process.h"

#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <string>
#include <vector>

#include "platform/input_error.h"

extern char** environ;

namespace pptam::platform {
namespace {

constexpr size_t kErrorBytes = 2000;  // of stderr's end that errors() keeps
constexpr int kErrorLines = 5;

void close_fd(int* fd) {
  if (*fd >= 0) ::close(*fd);
  *fd = -1;
}

int wait_for(int pid) {
  int status = 0;
  while (::waitpid(pid, &status, 0) < 0) {
    if (errno != EINTR) return -1;
  }
  return status;
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

ChildProcess::ChildProcess(const std::vector<std::string>& argv, Pipe pipe) {
  const std::string& program = argv.at(0);
  int ends[2];
  stderr_fd_ = open_scratch_file();
  if (stderr_fd_ < 0 || ::pipe2(ends, O_CLOEXEC) != 0) {
    const std::string why = std::strerror(errno);
    close_fd(&stderr_fd_);
    throw InputError("cannot run " + program + ": no temporary file or pipe: " + why);
  }
  const bool reading = pipe == Pipe::kReadStdout;
  int child_end = reading ? ends[1] : ends[0];
  pipe_fd_ = reading ? ends[0] : ends[1];

  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  const int piped = reading ? STDOUT_FILENO : STDIN_FILENO;
  const int silent = reading ? STDIN_FILENO : STDOUT_FILENO;
  posix_spawn_file_actions_adddup2(&actions, child_end, piped);
  posix_spawn_file_actions_adddup2(&actions, stderr_fd_, STDERR_FILENO);
  posix_spawn_file_actions_addopen(&actions, silent, "/dev/null", O_RDWR, 0);
  std::vector<char*> arguments;
  arguments.reserve(argv.size() + 1);
  for (const std::string& word : argv) arguments.push_back(const_cast<char*>(word.c_str()));
  arguments.push_back(nullptr);
  pid_t pid = -1;
  const int error = ::posix_spawnp(&pid, program.c_str(), &actions, nullptr, arguments.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  close_fd(&child_end);
  if (error != 0) {
    close_fd(&pipe_fd_);
    close_fd(&stderr_fd_);
    if (error != ENOENT) throw InputError("cannot run " + program + ": " + std::strerror(error));
    const std::string package = program == "ffprobe" ? "ffmpeg" : program;
    throw InputError("cannot run " + program + ": install it, on Debian with: apt install " + package);
  }
  pid_ = pid;
}

ChildProcess::~ChildProcess() {
  close_fd(&pipe_fd_);
  if (pid_ > 0) {
    ::kill(pid_, SIGKILL);
    wait_for(pid_);
  }
  close_fd(&stderr_fd_);
}

size_t ChildProcess::read(void* data, size_t bytes) {
  size_t done = 0;
  while (done < bytes && pipe_fd_ >= 0) {
    const ssize_t got = ::read(pipe_fd_, static_cast<char*>(data) + done, bytes - done);
    if (got == 0) break;
    if (got < 0 && errno != EINTR) break;
    if (got > 0) done += static_cast<size_t>(got);
  }
  return done;
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
  if (pid_ <= 0) return -1;
  const int status = wait_for(pid_);
  pid_ = -1;
  errors_ = last_lines(stderr_fd_);
  return WIFSIGNALED(status) ? 128 + WTERMSIG(status) : WEXITSTATUS(status);
}

}  // namespace pptam::platform
