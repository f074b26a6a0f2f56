// The system calls that a V4L2 camera takes, so that a test can answer in a device's place.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace pptam::platform {

class V4l2Calls {
 public:
  virtual ~V4l2Calls() = default;
  virtual std::vector<std::string> nodes();  // "/dev/video0", in the order of their numbers
  virtual int open(const char* path);        // for reading and writing, not blocking
  virtual int close(int fd);
  virtual int ioctl(int fd, unsigned long request, void* argument);  // again where a signal interrupts it
  virtual void* mmap(int fd, size_t bytes, int64_t offset);          // null: failed
  virtual int munmap(void* address, size_t bytes);
  // As poll(2) for POLLIN on fd, -1 only to sleep: 1 something happened, 0 the time is over, -1 with errno. Negative
  // times are 0.
  virtual int wait(int fd, int64_t time_ns);
  virtual int64_t now_ns();  // CLOCK_MONOTONIC
};

}  // namespace pptam::platform
