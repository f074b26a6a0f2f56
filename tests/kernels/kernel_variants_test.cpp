// Every kernel by hand gives the bits of the plain one: over random pixels, positions, strides and alignments, and at
// the extremes. The comparison itself is kernel_checks.h, which the fuzz target drives too.
#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "tests/kernels/kernel_checks.h"
#include "tests/support/random.h"

namespace pptam {
namespace {

// Bytes for one check: noise, or black and white only, or all the same.
std::vector<uint8_t> bytes(test::Random& random, int style) {
  std::vector<uint8_t> bytes(test::kCheckBytes);
  const int constant = random.integer(0, 255);
  for (uint8_t& byte : bytes) {
    const int noise = random.integer(0, 255);
    byte = static_cast<uint8_t>(style == 0 ? noise : style == 1 ? (noise & 1) * 255 : constant);
  }
  return bytes;
}

TEST(KernelVariants, GiveTheBitsOfThePlainOnes) {
  if (std::string(test::variant_name()) == "plain") GTEST_SKIP() << "this target has no variants by hand";
  test::Random random;
  for (int trial = 0; trial < test::trials(30000); ++trial) {
    const std::vector<uint8_t> input = bytes(random, trial % 3);
    const char* different = test::first_different_kernel(input);
    ASSERT_EQ(different, nullptr) << different << ", trial " << trial;
  }
}

// The comparison can fail: a wrong bit in any output is seen.
TEST(KernelVariants, AWrongBitIsSeen) {
  test::Random random;
  const std::vector<uint8_t> input = bytes(random, 0);
  for (const char* name : test::kKernelNames) {
    const char* different = test::first_different_kernel(input, name);
    ASSERT_NE(different, nullptr) << name;
    EXPECT_STREQ(different, name);
  }
}

}  // namespace
}  // namespace pptam
