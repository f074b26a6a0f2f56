// What targets that call the C interface share: the input is a script of numbers, and every status is looked at.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>

#include <pocket_ptam/pocket_ptam_c.h>

namespace pptam::test {

inline void require(bool condition, const char* what) {
  if (condition) return;
  std::fprintf(stderr, "%s\n", what);
  std::abort();
}

inline pptam_status checked(const pptam_status& status) {
  require(status.code >= PPTAM_OK && status.code <= PPTAM_CONFIG_MISMATCH, "a status that is none");
  require((status.message[0] == '\0') == (status.code == PPTAM_OK), "a message without, or none with, a trouble");
  return status;
}

class Script {
 public:
  Script(const uint8_t* data, size_t size) : data_(data), size_(size) {}
  bool more() const { return size_ > 0; }
  template <class T>
  T take() {
    T value = {};
    const size_t bytes = std::min(size_, sizeof value);
    if (bytes > 0) std::memcpy(static_cast<void*>(&value), data_, bytes);  // an empty input's data_ is null
    data_ += bytes;
    size_ -= bytes;
    return value;
  }
  // Four bytes of it are others: at a place, of any kind.
  template <class T>
  void change(T* it) {
    const size_t offset = take<uint16_t>() % (sizeof *it - 3);
    const auto number = take<uint32_t>();
    std::memcpy(reinterpret_cast<char*>(it) + offset, &number, sizeof number);
  }

 private:
  const uint8_t* data_;
  size_t size_;
};

}  // namespace pptam::test
