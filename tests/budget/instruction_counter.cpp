#include "tests/budget/instruction_counter.h"

#include <sys/mman.h>
#include <sys/syscall.h>
#include <unistd.h>

namespace pptam::test {
namespace {

// Memory that the plugin can map too, by its descriptor; null if the system has none.
struct SharedPage {
  int descriptor = -1;
  volatile CounterPage* page = nullptr;
  SharedPage() {
    descriptor = static_cast<int>(syscall(SYS_memfd_create, "counter", 0u));
    if (descriptor < 0 || ftruncate(descriptor, sizeof(CounterPage)) != 0) return;
    void* mapped = mmap(nullptr, sizeof(CounterPage), PROT_READ | PROT_WRITE, MAP_SHARED, descriptor, 0);
    if (mapped != MAP_FAILED) page = static_cast<volatile CounterPage*>(mapped);
  }
};

CounterPage read_counter() {
  static const SharedPage shared;
  if (shared.page == nullptr) return {};
  syscall(kCounterSystemCall, shared.descriptor);  // fails without the plugin, and the page stays zero
  return {shared.page->instructions, shared.page->quarter_cycles};
}

CounterPage difference(const CounterPage& a, const CounterPage& b) {
  return {a.instructions - b.instructions, a.quarter_cycles - b.quarter_cycles};
}

}  // namespace

bool counter_available() {
  return read_counter().instructions != 0;
}

Region::Region() {
  read_counter();  // the first call maps the page
  start_ = read_counter();
}

Counts Region::spent() const {
  const CounterPage now = read_counter();
  // What two successive readings are apart.
  const CounterPage overhead = difference(read_counter(), now);
  const CounterPage spent = difference(difference(now, start_), overhead);
  return {static_cast<int64_t>(spent.instructions), static_cast<double>(spent.quarter_cycles) / 4};
}

}  // namespace pptam::test
