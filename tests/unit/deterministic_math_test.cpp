// The polynomials against double precision, and their exact bits on every target.
#include "base/deterministic_math.h"

#include <gtest/gtest.h>

#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>

#include "tests/support/random.h"

namespace pptam {
namespace {

// The header's promise: 2 ulp of 1. The polynomial's error (below 0.25 ulp) and two to three roundings of half an ulp
// of the result (at most 0.5 ulp of 1 each, up to pi/2).
constexpr double kTolerance = 2.0 * 0x1p-23;

TEST(DeterministicMath, SineAndCosineMatchDoubleOverTheWholeDomain) {
  test::Random random;
  double worst = 0;
  for (int i = 0; i < 200000; ++i) {
    const double range = i % 2 == 0 ? 4.0 : 1000.0;
    const float x = static_cast<float>(random.uniform(-range, range));
    worst = std::max(worst, std::fabs(static_cast<double>(det_sin(x)) - std::sin(static_cast<double>(x))));
    worst = std::max(worst, std::fabs(static_cast<double>(det_cos(x)) - std::cos(static_cast<double>(x))));
  }
  RecordProperty("worst_ulp_of_1", std::to_string(worst / 0x1p-23));
  EXPECT_LT(worst, kTolerance);
}

TEST(DeterministicMath, SmallSinesKeepTheirRelativePrecision) {
  // x - x^3/6 with x^2/6 < 2e-3: one rounding, so 1 ulp of the result.
  for (float x = 1e-20f; x < 0.1f; x *= 1.7f) {
    EXPECT_NEAR(static_cast<double>(det_sin(x)) / std::sin(static_cast<double>(x)), 1.0, 0x1p-23);
    EXPECT_EQ(det_sin(-x), -det_sin(x));
    EXPECT_EQ(det_cos(-x), det_cos(x));
  }
  EXPECT_EQ(det_sin(0.0f), 0.0f);
  EXPECT_EQ(det_cos(0.0f), 1.0f);
}

TEST(DeterministicMath, ArcTangentsMatchDouble) {
  test::Random random;
  double worst = 0;
  double worst2 = 0;
  for (int i = 0; i < 200000; ++i) {
    const float x = static_cast<float>(random.uniform(-1, 1) * std::exp(random.uniform(-20, 20)));
    const float y = static_cast<float>(random.uniform(-1, 1) * std::exp(random.uniform(-20, 20)));
    worst = std::max(worst, std::fabs(static_cast<double>(det_atan(x)) - std::atan(static_cast<double>(x))));
    worst2 = std::max(worst2, std::fabs(static_cast<double>(det_atan2(y, x)) -
                                        std::atan2(static_cast<double>(y), static_cast<double>(x))));
  }
  RecordProperty("worst_ulp_of_1", std::to_string(worst / 0x1p-23));
  RecordProperty("worst_ulp_of_1_atan2", std::to_string(worst2 / 0x1p-23));
  EXPECT_LT(worst, kTolerance);
  // One more subtraction, from pi: its rounding is up to one ulp of 1.
  EXPECT_LT(worst2, kTolerance + 0x1p-23);
}

TEST(DeterministicMath, ArcTangentsAtTheAxesAndExtremes) {
  const double pi = std::acos(-1.0);
  EXPECT_EQ(det_atan2(0.0f, 0.0f), 0.0f);
  EXPECT_EQ(det_atan2(0.0f, 2.0f), 0.0f);
  EXPECT_NEAR(det_atan2(0.0f, -2.0f), pi, kTolerance);
  EXPECT_NEAR(det_atan2(3.0f, 0.0f), pi / 2, kTolerance);
  EXPECT_NEAR(det_atan2(-3.0f, 0.0f), -pi / 2, kTolerance);
  const float largest = std::numeric_limits<float>::max();
  EXPECT_NEAR(det_atan(largest), pi / 2, kTolerance);
  EXPECT_NEAR(det_atan2(largest, largest), pi / 4, kTolerance);
  EXPECT_NEAR(det_atan2(1e-38f, -1e-38f), 3 * pi / 4, 2 * kTolerance);
}

TEST(DeterministicMath, ExponentialMatchesDoubleAndClamps) {
  test::Random random;
  double worst = 0;
  for (int i = 0; i < 100000; ++i) {
    const float x = static_cast<float>(random.uniform(-80, 80));
    const double expected = std::exp(static_cast<double>(x));
    worst = std::max(worst, std::fabs(static_cast<double>(det_exp(x)) / expected - 1.0));
  }
  RecordProperty("worst_ulp_of_1", std::to_string(worst / 0x1p-23));
  EXPECT_LT(worst, kTolerance);
  EXPECT_EQ(det_exp(0.0f), 1.0f);
  EXPECT_EQ(det_exp(1000.0f), det_exp(80.0f));
  EXPECT_EQ(det_exp(-1000.0f), det_exp(-80.0f));
}

TEST(DeterministicMath, CubeRootMatchesDouble) {
  test::Random random;
  double worst = 0;
  for (int i = 0; i < 100000; ++i) {
    const float x = static_cast<float>((i % 2 == 0 ? 1.0 : -1.0) * std::pow(10.0, random.uniform(-30, 30)));
    worst = std::max(worst, std::fabs(static_cast<double>(det_cbrt(x)) / std::cbrt(static_cast<double>(x)) - 1.0));
  }
  RecordProperty("worst_ulp_of_1", std::to_string(worst / 0x1p-23));
  EXPECT_LT(worst, kTolerance);
  EXPECT_EQ(det_cbrt(0.0f), 0.0f);
}

TEST(DeterministicMath, NanAndTheOutsideOfTheDomainGiveNan) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const float infinity = std::numeric_limits<float>::infinity();
  for (const float x : {nan, infinity, -infinity, 1001.0f, -3e38f}) {
    EXPECT_TRUE(std::isnan(det_sin(x)));
    EXPECT_TRUE(std::isnan(det_cos(x)));
  }
  EXPECT_TRUE(std::isnan(det_atan(nan)));
  EXPECT_TRUE(std::isnan(det_atan2(nan, 1.0f)));
  EXPECT_TRUE(std::isnan(det_atan2(1.0f, nan)));
  EXPECT_TRUE(std::isnan(det_exp(nan)));
  EXPECT_TRUE(std::isnan(det_cbrt(nan)));
  EXPECT_TRUE(std::isnan(det_cbrt(infinity)));
}

// FNV-1a over the bits of every function on a sweep of arguments; flip is xored into one result, for the control.
uint64_t sweep_hash(uint32_t flip) {
  uint64_t hash = 14695981039346656037ull;
  const auto add = [&hash](float value) { hash = (hash ^ std::bit_cast<uint32_t>(value)) * 1099511628211ull; };
  for (int i = -20000; i <= 20000; ++i) {
    const float x = static_cast<float>(i) * 0x1.8p-9f;  // exact; up to 58.6
    add(det_sin(x));
    add(det_cos(x * 16.0f));
    add(det_atan(x));
    add(det_atan2(x, 3.0f - x));
    add(det_exp(x));
    add(det_cbrt(x));
    if (i == 0) add(std::bit_cast<float>(std::bit_cast<uint32_t>(det_exp(x)) ^ flip));
  }
  return hash;
}

TEST(DeterministicMath, EveryTargetGivesTheSameBits) {
  constexpr uint64_t kGolden = 10503737312216256753ull;
  EXPECT_EQ(sweep_hash(0), kGolden);
  EXPECT_NE(sweep_hash(1), kGolden) << "one wrong last bit among 240000 must show";
}

}  // namespace
}  // namespace pptam
