// Taps of mice and touch screens, and keys, where no window system hands them on: from the kernel's /dev/input.
#pragma once

#include <sys/types.h>

#include <cstdint>
#include <map>
#include <string>

namespace pptam::platform {

class PointerInput {
 public:
  // with_keys: keyboards too, where standard input is no terminal, which gives their characters itself.
  explicit PointerInput(bool with_keys) : with_keys_(with_keys) {}
  ~PointerInput();
  PointerInput(const PointerInput&) = delete;
  PointerInput& operator=(const PointerInput&) = delete;

  enum class What { kNothing, kTap, kKey };
  // Does not wait. Devices that come and go are noticed within two seconds.
  What next(char* key);

 private:
  void look_for_devices();

  struct Device {
    int fd;      // -1: of no interest
    ino_t node;  // another one: another device has taken its path
  };

  bool with_keys_;
  int64_t look_again_ns_ = 0;
  std::map<std::string, Device> devices_;  // by path
};

}  // namespace pptam::platform
