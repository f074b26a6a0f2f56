// Another program as a child process, without a shell: ffmpeg for video, gnuplot for plots.
//
// Hostile media files are decoded outside of this process, and licences stay apart.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

namespace pptam::platform {

class ChildProcess {
 public:
  enum class Pipe { kReadStdout, kWriteStdin };

  // Starts argv[0], found in PATH, with one pipe; stderr is collected. Throws InputError ("cannot run ffmpeg: install
  // it, on Debian with: apt install ffmpeg") when it is missing.
  ChildProcess(const std::vector<std::string>& argv, Pipe pipe);
  ~ChildProcess();  // closes the pipe; ends and reaps a child that still runs
  ChildProcess(const ChildProcess&) = delete;
  ChildProcess& operator=(const ChildProcess&) = delete;

  // Bytes read, fewer than asked only at the end of the output.
  size_t read(void* data, size_t bytes);
  // False once the child has closed its input (it has ended); no SIGPIPE.
  bool write(const void* data, size_t bytes);
  // Closes the pipe, waits, returns the exit code (128 + signal when killed by one). Once.
  int finish();
  // The last lines that it wrote to stderr, joined by "; " (after finish()).
  const std::string& errors() const { return errors_; }

 private:
  int pid_ = -1;
  int pipe_fd_ = -1;
  int stderr_fd_ = -1;  // an unlinked temporary file, so that a chatty child never blocks
  std::string errors_;
};

}  // namespace pptam::platform
