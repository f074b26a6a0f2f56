// Plugin for qemu-user: counts the instructions that the emulated program executes and hands the counts to it.
//
//   qemu-arm -plugin ./libcounting_plugin.so program
//
// Every translated block adds its number of instructions when it is entered, and the sum of their cycle weights: two
// inline additions, so that counting costs little. The program fetches the counts by a system call that no kernel
// knows (instruction_counter.h): its argument is a file descriptor of memory that both sides map.
//
// The weights are static estimates of an ARM1176's issue cycles, in quarters, from its instruction alone: no cache
// misses, no waiting for results. Built for the host. Debian ships no header for the interface; what is used of it is
// declared here (version 1, as in qemu 7.2).
#include <sys/mman.h>

#include <cstddef>
#include <cstdint>
#include <cstring>

#include "tests/budget/instruction_counter.h"

using qemu_plugin_id_t = uint64_t;
struct qemu_plugin_tb;
struct qemu_plugin_insn;
struct qemu_info_t {  // of qemu_plugin_install: only the first field is read
  const char* target_name;
};

extern "C" {
[[gnu::visibility("default")]] extern const int qemu_plugin_version;
const int qemu_plugin_version = 1;

size_t qemu_plugin_tb_n_insns(const qemu_plugin_tb* tb);
qemu_plugin_insn* qemu_plugin_tb_get_insn(const qemu_plugin_tb* tb, size_t index);
const void* qemu_plugin_insn_data(const qemu_plugin_insn* insn);
size_t qemu_plugin_insn_size(const qemu_plugin_insn* insn);
void qemu_plugin_register_vcpu_tb_trans_cb(qemu_plugin_id_t id, void (*callback)(qemu_plugin_id_t, qemu_plugin_tb*));
enum qemu_plugin_op { QEMU_PLUGIN_INLINE_ADD_U64 };
void qemu_plugin_register_vcpu_tb_exec_inline(qemu_plugin_tb* tb, qemu_plugin_op op, void* counter, uint64_t amount);
void qemu_plugin_register_vcpu_syscall_cb(qemu_plugin_id_t id,
                                          void (*callback)(qemu_plugin_id_t, unsigned vcpu, int64_t number, uint64_t a1,
                                                           uint64_t a2, uint64_t a3, uint64_t a4, uint64_t a5,
                                                           uint64_t a6, uint64_t a7, uint64_t a8));
}

namespace {

using pptam::test::CounterPage;

CounterPage counts;  // the running sums; one processor only
bool arm_code = false;

// Issue cycles of one ARM (A32) instruction in quarters, after the ARM1176JZF-S manual's chapter on cycle timings.
uint64_t quarter_cycles(uint32_t code) {
  const auto bits = [code](int high, int low) { return (code >> low) & ((1u << (high - low + 1)) - 1); };
  const uint32_t major = bits(27, 25);
  if (major == 0 && bits(7, 4) == 9) return bits(24, 23) == 1 ? 12 : 8;  // long multiply 3, multiply 2 cycles
  if (major == 3 && bits(4, 4) == 1) return 4;  // media: parallel sums, extension, dual multiply
  if (major == 2 || major == 3) return 4;       // load or store of a word or byte
  if (major == 4) {                             // load or store several: two words a cycle
    uint32_t words = 0;
    for (int i = 0; i < 16; ++i) words += bits(i, i);
    return 4 * (1 + words / 2);
  }
  if (major == 5) return 8;                         // branch: 0 or 1 when predicted, 5 to 7 when not
  if (major == 6) return 4 * (1 + bits(7, 0) / 2);  // VFP load and store
  if (major == 7 && bits(24, 24) == 0 && (bits(11, 8) == 10 || bits(11, 8) == 11)) {
    const bool wide = bits(8, 8) == 1;
    if (bits(4, 4) == 1) return 4;  // transfer between the register files
    const uint32_t operation = bits(23, 23) << 2 | bits(21, 20);
    if (operation == 4) return 4 * (wide ? 29 : 15);                                          // divide
    if (operation == 7 && bits(19, 16) == 1 && bits(7, 6) == 3) return 4 * (wide ? 29 : 15);  // square root
    const bool multiplies = operation < 3;
    return wide && multiplies ? 8 : 4;
  }
  return 4;
}

void on_translation(qemu_plugin_id_t, qemu_plugin_tb* tb) {
  const size_t size = qemu_plugin_tb_n_insns(tb);
  uint64_t quarters = 0;
  for (size_t i = 0; i < size; ++i) {
    const qemu_plugin_insn* insn = qemu_plugin_tb_get_insn(tb, i);
    uint32_t code = 0;
    if (arm_code && qemu_plugin_insn_size(insn) == sizeof code) {
      std::memcpy(&code, qemu_plugin_insn_data(insn), sizeof code);
      quarters += quarter_cycles(code);
    }
  }
  qemu_plugin_register_vcpu_tb_exec_inline(tb, QEMU_PLUGIN_INLINE_ADD_U64, &counts.instructions, size);
  if (quarters > 0)
    qemu_plugin_register_vcpu_tb_exec_inline(tb, QEMU_PLUGIN_INLINE_ADD_U64, &counts.quarter_cycles, quarters);
}

void on_system_call(qemu_plugin_id_t, unsigned, int64_t number, uint64_t descriptor, uint64_t, uint64_t, uint64_t,
                    uint64_t, uint64_t, uint64_t, uint64_t) {
  if (number != pptam::test::kCounterSystemCall) return;
  static CounterPage* page = nullptr;  // the emulated program and its emulator are one process
  if (page == nullptr) {
    void* mapped =
        mmap(nullptr, sizeof(CounterPage), PROT_READ | PROT_WRITE, MAP_SHARED, static_cast<int>(descriptor), 0);
    if (mapped == MAP_FAILED) return;
    page = static_cast<CounterPage*>(mapped);
  }
  *page = counts;
}

}  // namespace

extern "C" [[gnu::visibility("default")]] int qemu_plugin_install(qemu_plugin_id_t id, const qemu_info_t* info, int,
                                                                  char**) {
  arm_code = std::strcmp(info->target_name, "arm") == 0;
  qemu_plugin_register_vcpu_tb_trans_cb(id, on_translation);
  qemu_plugin_register_vcpu_syscall_cb(id, on_system_call);
  return 0;
}
