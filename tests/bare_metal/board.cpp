// The run on an emulated microcontroller, mps2-an500: vectors, start-up, and files and messages of the computer that
// emulates it, by semihosting. No C library but memcpy and its relatives.
#include <cstddef>
#include <cstdint>

#include "tests/bits/run.h"

// Set by mps2_an500.ld.
extern "C" uint32_t data_load[], data_begin[], data_end[], bss_begin[], bss_end[], stack_top[];

namespace pptam::test {
namespace {

enum class Call : uint32_t { kOpen = 0x01, kWrite0 = 0x04, kRead = 0x06, kCommandLine = 0x15, kExitExtended = 0x20 };

intptr_t semihosting(Call call, const void* arguments) {
  register uint32_t r0 asm("r0") = static_cast<uint32_t>(call);
  register const void* r1 asm("r1") = arguments;
  asm volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
  return static_cast<intptr_t>(r0);
}

void say(const char* text) {
  semihosting(Call::kWrite0, text);
}

[[noreturn]] void leave(int code) {
  constexpr uintptr_t kApplicationExit = 0x20026;
  const uintptr_t arguments[] = {kApplicationExit, static_cast<uintptr_t>(code)};
  for (;;) semihosting(Call::kExitExtended, arguments);
}

intptr_t recording = -1;  // handle

bool read(void* to, size_t bytes) {
  const uintptr_t arguments[] = {static_cast<uintptr_t>(recording), reinterpret_cast<uintptr_t>(to), bytes};
  return semihosting(Call::kRead, arguments) == 0;  // that many bytes were not read
}

// The last word of the command line.
const char* recording_name() {
  static char line[512];
  uintptr_t arguments[] = {reinterpret_cast<uintptr_t>(line), sizeof line};
  if (semihosting(Call::kCommandLine, arguments) != 0) return "";
  const char* name = line;
  for (const char* p = line; *p != '\0'; ++p)
    if (*p == ' ') name = p + 1;
  return name;
}

// In external memory, which nothing clears.
[[gnu::section(".external")]] alignas(std::max_align_t) std::byte block[kBlockBytes];
[[gnu::section(".external")]] uint8_t image[kImageBytes];

[[noreturn]] void run() {
  const char* const name = recording_name();
  size_t length = 0;
  while (name[length] != '\0') ++length;
  constexpr uintptr_t kReadBinary = 1;
  const uintptr_t arguments[] = {reinterpret_cast<uintptr_t>(name), kReadBinary, length};
  recording = semihosting(Call::kOpen, arguments);
  if (recording < 0) {
    say("FAILED: the recording cannot be opened\n");
    leave(1);
  }
  leave(run_recording({read, say, block, sizeof block, image, sizeof image}, -1));
}

[[noreturn]] void fault() {
  say("FAILED: a fault of the processor\n");
  leave(1);
}

[[noreturn]] void reset() {
  volatile uint32_t& coprocessor_access = *reinterpret_cast<volatile uint32_t*>(0xe000ed88);
  coprocessor_access = coprocessor_access | 0xfu << 20;  // the floating point unit
  asm volatile("dsb\n isb");
  for (uint32_t *from = data_load, *to = data_begin; to < data_end;) *to++ = *from++;
  for (uint32_t* to = bss_begin; to < bss_end;) *to++ = 0;
  run();
}

struct Vectors {
  uint32_t* stack;
  void (*reset)();
  void (*faults[5])();  // NMI, hard fault, memory, bus, usage
};
[[gnu::section(".vectors"), gnu::used]] const Vectors vectors = {stack_top, reset, {fault, fault, fault, fault, fault}};

}  // namespace
}  // namespace pptam::test
