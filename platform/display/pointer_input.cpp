#include "platform/display/pointer_input.h"

#include <fcntl.h>
#include <linux/input.h>
#include <sys/ioctl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <ctime>
#include <filesystem>
#include <iterator>

namespace pptam::platform {
namespace {

constexpr int64_t kLookEvery_ns = 2'000'000'000;

int64_t monotonic_ns() {
  timespec now = {};
  ::clock_gettime(CLOCK_MONOTONIC, &now);
  return int64_t{now.tv_sec} * 1'000'000'000 + now.tv_nsec;
}

bool has_key(int fd, unsigned code) {
  std::array<uint8_t, KEY_MAX / 8 + 1> bits = {};
  if (::ioctl(fd, EVIOCGBIT(EV_KEY, bits.size()), bits.data()) < 0) return false;
  return (bits[code / 8] >> (code % 8) & 1) != 0;
}

// Of a keyboard with the letters where they are on most: the kernel knows places, not letters.
char character_of(unsigned code) {
  switch (code) {
    case KEY_T:
      return 't';
    case KEY_R:
      return 'r';
    case KEY_L:
      return 'l';
    case KEY_M:
      return 'm';
    case KEY_S:
      return 's';
    case KEY_P:
      return 'p';
    case KEY_V:
      return 'v';
    case KEY_H:
      return 'h';
    case KEY_Q:
    case KEY_ESC:
      return 'q';
    default:
      return 0;
  }
}

}  // namespace

PointerInput::~PointerInput() {
  for (const auto& [path, device] : devices_) {
    if (device.fd >= 0) ::close(device.fd);
  }
}

void PointerInput::look_for_devices() {
  std::error_code error;
  for (std::filesystem::directory_iterator entry("/dev/input", error), end; !error && entry != end;
       entry.increment(error)) {
    const std::string path = entry->path().string();
    struct stat node = {};
    if (entry->path().filename().string().rfind("event", 0) != 0 || ::stat(path.c_str(), &node) != 0) continue;
    const auto known = devices_.find(path);
    if (known != devices_.end() && (known->second.fd >= 0 || known->second.node == node.st_ino)) continue;
    int fd = ::open(path.c_str(), O_RDONLY | O_NONBLOCK | O_CLOEXEC);
    if (fd < 0) continue;  // tried again: a new device is root's alone for a moment
    if (!has_key(fd, BTN_LEFT) && !has_key(fd, BTN_TOUCH) && !(with_keys_ && has_key(fd, KEY_T))) {
      ::close(fd);
      fd = -1;
    }
    devices_[path] = {fd, node.st_ino};
  }
}

PointerInput::What PointerInput::next(char* key) {
  const int64_t now_ns = monotonic_ns();
  if (now_ns >= look_again_ns_) {
    look_again_ns_ = now_ns + kLookEvery_ns;
    look_for_devices();
  }
  for (auto device = devices_.begin(); device != devices_.end();) {
    input_event event = {};
    ssize_t got = 0;
    const int fd = device->second.fd;
    while (fd >= 0 && (got = ::read(fd, &event, sizeof event)) == sizeof event) {
      if (event.type != EV_KEY || event.value != 1) continue;
      if (event.code == BTN_LEFT || event.code == BTN_TOUCH) return What::kTap;
      *key = with_keys_ ? character_of(event.code) : '\0';
      if (*key != 0) return What::kKey;
    }
    const bool gone = fd >= 0 && got < 0 && errno == ENODEV;
    if (gone) ::close(fd);
    device = gone ? devices_.erase(device) : std::next(device);
  }
  return What::kNothing;
}

}  // namespace pptam::platform
