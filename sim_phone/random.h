// Small deterministic random numbers for the emulated phone: the same on every standard library.
#pragma once

#include <cstdint>

namespace pptam::sim {

// A good 64-bit mix of its argument (the finaliser of SplitMix64).
inline uint64_t mixed(uint64_t x) {
  x += 0x9e3779b97f4a7c15ull;
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9ull;
  x = (x ^ (x >> 27)) * 0x94d049bb133111ebull;
  return x ^ (x >> 31);
}

class Random {
 public:
  // Different streams of one seed are independent.
  Random(uint64_t seed, uint64_t stream) : state_(mixed(mixed(seed) ^ stream)) {}

  uint64_t bits() {
    state_ += 0x9e3779b97f4a7c15ull;
    return mixed(state_);
  }
  double uniform(double low, double high) {
    return low + (high - low) * (static_cast<double>(bits() >> 11) * 0x1.0p-53);
  }
  int integer(int low, int high) {  // both included
    return low + static_cast<int>(bits() % static_cast<uint64_t>(high - low + 1));
  }
  bool chance(double probability) { return uniform(0, 1) < probability; }
  double sign() { return chance(0.5) ? 1.0 : -1.0; }

 private:
  uint64_t state_;
};

}  // namespace pptam::sim
