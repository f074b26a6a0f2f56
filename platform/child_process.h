// Another program as a child process, without a shell: ffmpeg for video, gnuplot for plots.
//
// Hostile media files are decoded outside of this process, and licences stay apart. A child that stands still is ended:
// nothing here waits longer than its limit.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

namespace pptam::platform {

constexpr int kMaxSilenceS = 20;  // seconds; a busy computer takes under one for a large image. Not swept
constexpr int kMaxEndingS = 120;  // seconds; for a child that writes a file: moving a video's index rewrites it all

// What a child may use; 0: no limit.
struct ChildLimits {
  int silence_s = kMaxSilenceS;  // without output, or without taking input
  size_t memory_bytes = 0;       // of data, as RLIMIT_DATA counts: without the program's own code
  int cpu_s = 0;                 // of all its threads together
};

class ChildProcess {
 public:
  // With kReadStdoutAndLines the child's file descriptor 3 is a pipe, too, whose lines read_line() gives.
  enum class Pipe { kReadStdout, kReadStdoutAndLines, kWriteStdin };

  // Starts argv[0], found in PATH; stderr is collected. Throws InputError ("cannot run ffmpeg: install it, on Debian
  // with: apt install ffmpeg") when it is missing.
  ChildProcess(const std::vector<std::string>& argv, Pipe pipe, const ChildLimits& limits = {});
  ~ChildProcess();  // closes the pipe; ends and reaps a child that still runs
  ChildProcess(const ChildProcess&) = delete;
  ChildProcess& operator=(const ChildProcess&) = delete;

  // Bytes read, fewer than asked only at the end of the output. Throws InputError when nothing comes for that long;
  // the child has been ended then.
  size_t read(void* data, size_t bytes);
  // The next line without its end; false at the end of the output, and for a line of over 4 kB. Throws as read().
  // What the child writes here while nobody reads must fit into a pipe (64 kB), or both wait for each other.
  bool read_line(std::string* line);
  // False once the child has closed its input (it has ended), or has taken nothing for that long; no SIGPIPE.
  bool write(const void* data, size_t bytes);
  // Closes the pipes, waits, returns the exit code (128 + signal when killed by one). A child that does not end within
  // that limit, or kMaxEndingS if it was written to, is killed. Once.
  int finish();
  // The last lines that it wrote to stderr, joined by "; " (after finish()).
  const std::string& errors() const { return errors_; }

 private:
  void kill_silent_child();

  std::string program_;
  int silence_s_;
  int pid_ = -1;
  int pipe_fd_ = -1;
  int lines_fd_ = -1;
  std::string lines_;  // read, not yet asked for
  bool writing_ = false;
  int stderr_fd_ = -1;  // an unlinked temporary file, so that a chatty child never blocks
  std::string errors_;
};

// For a handler of signals that end the process: kills the children that still run, and waits until they are gone, so
// that none makes a file afterwards.
void end_children() noexcept;

}  // namespace pptam::platform
