// Differential fuzzing: on any bytes, every kernel by hand gives the bits of the plain one, and reads nothing beyond
// its input (address sanitizer). tests/fuzz/run.sh builds and runs it.
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>

#include "tests/kernels/kernel_checks.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (const char* name = pptam::test::first_different_kernel({data, size})) {
    std::fprintf(stderr, "%s differs from the plain kernel\n", name);
    std::abort();
  }
  return 0;
}
