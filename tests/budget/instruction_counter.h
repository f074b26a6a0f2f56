// Reads how many instructions this program has executed, when it runs under qemu-user with counting_plugin; natively
// the counts are zero and available() is false.
//
//   Region region;
//   work();
//   const Counts spent = region.spent();   // the same in every run of one executable
#pragma once

#include <cstdint>

namespace pptam::test {

constexpr int64_t kCounterSystemCall = 20564;  // used by no processor's Linux

struct CounterPage {  // shared with the plugin
  uint64_t instructions;
  uint64_t quarter_cycles;
};

struct Counts {
  int64_t instructions = 0;
  double cycles = 0;  // estimated, ARM1176
};

// Whether a plugin answers.
bool counter_available();

class Region {
 public:
  Region();
  // Since construction, what the counting itself takes left out.
  Counts spent() const;

 private:
  CounterPage start_;
};

}  // namespace pptam::test
