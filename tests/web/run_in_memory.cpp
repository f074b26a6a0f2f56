// The run of tests/bits in WebAssembly: JavaScript puts the recording behind __heap_base, calls run(), and reads
// what was said.
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "tests/bits/run.h"

namespace pptam::test {
namespace {

const uint8_t *next, *end;  // of the recording
char said[128 * 1024];
size_t said_bytes = 0;

bool read(void* to, size_t bytes) {
  if (static_cast<size_t>(end - next) < bytes) return false;
  std::memcpy(to, next, bytes);
  next += bytes;
  return true;
}

void say(const char* text) {
  while (*text != '\0' && said_bytes + 1 < sizeof said) said[said_bytes++] = *text++;
}

alignas(std::max_align_t) std::byte block[kDesktopBlockBytes];
uint8_t image[kDesktopImageBytes];

}  // namespace
}  // namespace pptam::test

// As run_recording(); what it said begins at said_text().
extern "C" [[gnu::visibility("default")]] int run(const uint8_t* recording, size_t bytes, int changed_frame) {
  using namespace pptam::test;
  next = recording;
  end = recording + bytes;
  said_bytes = 0;
  const int code = run_recording({read, say, block, sizeof block, image, sizeof image}, changed_frame);
  said[said_bytes] = '\0';
  return code;
}

extern "C" [[gnu::visibility("default")]] const char* said_text() {
  return pptam::test::said;
}
