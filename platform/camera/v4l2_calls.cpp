#include "platform/camera/v4l2_calls.h"

#include <fcntl.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <ctime>
#include <filesystem>
#include <utility>

#include "platform/text_file.h"

namespace pptam::platform {

std::vector<std::string> V4l2Calls::nodes() {
  std::vector<std::pair<int64_t, std::string>> found;
  std::error_code ignored;
  for (const auto& entry : std::filesystem::directory_iterator("/dev", ignored)) {
    const std::string name = entry.path().filename().string();
    int64_t number = 0;
    if (name.rfind("video", 0) == 0 && parse_integer(name.substr(5), &number))
      found.emplace_back(number, entry.path().string());
  }
  std::sort(found.begin(), found.end());
  std::vector<std::string> names;
  names.reserve(found.size());
  for (auto& [number, name] : found) names.push_back(std::move(name));
  return names;
}

int V4l2Calls::open(const char* path) {
  return ::open(path, O_RDWR | O_NONBLOCK | O_CLOEXEC);
}

int V4l2Calls::close(int fd) {
  return ::close(fd);
}

int V4l2Calls::ioctl(int fd, unsigned long request, void* argument) {
  for (;;) {
    const int result = ::ioctl(fd, request, argument);
    if (result >= 0 || errno != EINTR) return result;
  }
}

void* V4l2Calls::mmap(int fd, size_t bytes, int64_t offset) {
  void* address = ::mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_SHARED, fd, static_cast<off_t>(offset));
  return address == MAP_FAILED ? nullptr : address;
}

int V4l2Calls::munmap(void* address, size_t bytes) {
  return ::munmap(address, bytes);
}

int V4l2Calls::wait(int fd, int64_t time_ns) {
  constexpr int64_t kMost_ns = 3'600'000'000'000;
  const int64_t waited_ns = std::clamp<int64_t>(time_ns, 0, kMost_ns);
  timespec time = {};
  time.tv_sec = static_cast<time_t>(waited_ns / 1'000'000'000);
  time.tv_nsec = static_cast<long>(waited_ns % 1'000'000'000);
  pollfd events = {fd, POLLIN, 0};
  return ::ppoll(&events, fd < 0 ? 0 : 1, &time, nullptr);
}

int64_t V4l2Calls::now_ns() {
  timespec time = {};
  ::clock_gettime(CLOCK_MONOTONIC, &time);
  return int64_t{time.tv_sec} * 1'000'000'000 + time.tv_nsec;
}

}  // namespace pptam::platform
