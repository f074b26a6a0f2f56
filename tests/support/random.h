// Random numbers for tests: the seed comes from the suite's and test's names, is printed when the test fails, and
// PPTAM_TEST_SEED=N replays one.
#pragma once

#include <gtest/gtest.h>

#include <cstdint>
#include <cstdlib>
#include <random>
#include <string>

namespace pptam::test {

// How often to repeat a random trial: a tenth on ARM processors, which are small or emulated. The bits are the same
// there, so that the statistics are this computer's business.
constexpr int trials(int usual) {
#if defined(__arm__) || defined(__aarch64__)
  return usual / 10;
#else
  return usual;
#endif
}

class Random {
 public:
  Random()
      : seed_(choose_seed()),
        engine_(seed_),
        trace_(__FILE__, __LINE__, "replay with PPTAM_TEST_SEED=" + std::to_string(seed_)) {}
  double uniform(double low, double high) {
    return low + (high - low) * (static_cast<double>(engine_() >> 11) * 0x1.0p-53);
  }
  int integer(int low, int high) {  // both included
    return low + static_cast<int>(engine_() % static_cast<uint64_t>(high - low + 1));
  }
  double gaussian() {  // sum of twelve uniforms: the same on every standard library
    double sum = -6;
    for (int i = 0; i < 12; ++i) sum += uniform(0, 1);
    return sum;
  }
  uint64_t seed() const { return seed_; }

 private:
  static uint64_t choose_seed() {
    if (const char* text = std::getenv("PPTAM_TEST_SEED")) return std::strtoull(text, nullptr, 10);
    const auto* info = ::testing::UnitTest::GetInstance()->current_test_info();
    uint64_t hash = 14695981039346656037ull;  // FNV-1a
    for (const char c : std::string(info->test_suite_name()) + "." + info->name())
      hash = (hash ^ static_cast<uint8_t>(c)) * 1099511628211ull;
    return hash;
  }
  uint64_t seed_;
  std::mt19937_64 engine_;
  ::testing::ScopedTrace trace_;
};

}  // namespace pptam::test
