// Tukey's biweight: its shape, its scale, and the efficiency that fixes the cut-off.
#include "geometry/robust.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "tests/support/random.h"

namespace pptam {
namespace {

TEST(Robust, WeightFallsFromOneToZeroAtTheCutoff) {
  for (const float sigma : {0.3f, 1.0f, 7.0f}) {
    const float c = kTukeyCutoff * sigma;
    EXPECT_EQ(tukey_weight(0.0f, sigma), 1.0f);
    EXPECT_EQ(tukey_weight(c * c * 1.0001f, sigma), 0.0f);
    EXPECT_EQ(tukey_weight(1e30f, sigma), 0.0f);
    float previous = 1.0f;
    for (int i = 1; i <= 100; ++i) {
      const float e = c * static_cast<float>(i) / 100.0f;
      const float weight = tukey_weight(e * e, sigma);
      EXPECT_LE(weight, previous);
      EXPECT_GE(weight, 0.0f);
      previous = weight;
    }
    EXPECT_NEAR(tukey_weight(0.25f * c * c, sigma), 0.5625f, 1e-6f);  // (1 - 1/4)^2
  }
}

TEST(Robust, NothingIsTrustedWithoutAScale) {
  EXPECT_EQ(tukey_weight(0.0f, 0.0f), 0.0f);
  EXPECT_EQ(tukey_weight(std::nanf(""), 1.0f), 0.0f);
  EXPECT_EQ(tukey_weight(1.0f, std::nanf("")), 0.0f);
}

TEST(Robust, CostDerivativeIsHalfTheWeight) {
  for (const float sigma : {0.5f, 2.0f}) {
    const double c2 = std::pow(static_cast<double>(kTukeyCutoff) * static_cast<double>(sigma), 2);
    for (int i = 1; i < 100; ++i) {
      const double e2 = c2 * i / 100.0;
      // Step c2/100: truncation of the central difference of c2/6 (1 - (1 - u)^3) is h^2/6 * f''' = (1/100)^2 / 6,
      // 1.7e-5; rounding is 6e-8 c2/6 / (c2/50) = 5e-7.
      const double h = c2 / 100.0;
      const auto cost = [sigma](double v) { return static_cast<double>(tukey_cost(static_cast<float>(v), sigma)); };
      const double derivative = (cost(e2 + h) - cost(e2 - h)) / (2 * h);
      if (i < 99) {
        EXPECT_NEAR(derivative, 0.5 * static_cast<double>(tukey_weight(static_cast<float>(e2), sigma)), 3e-5);
      }
    }
    EXPECT_NEAR(tukey_cost(static_cast<float>(3 * c2), sigma), c2 / 6, 1e-5 * c2);
    EXPECT_NEAR(tukey_cost(static_cast<float>(1e-4 * c2), sigma), 0.5 * 1e-4 * c2, 1e-7 * c2);  // quadratic near 0
  }
}

TEST(Robust, SigmaFromTheMedianOfGaussianNoise) {
  test::Random random;
  const int n = 20000;
  std::vector<float> squared;
  for (int i = 0; i < n; ++i) {
    const double x = 2.5 * random.gaussian();
    const double y = 2.5 * random.gaussian();
    squared.push_back(static_cast<float>(x * x + y * y));
  }
  // The median of |e|/sigma (Rayleigh, density 1.1774/2 = 0.589 there) has standard deviation 1/(2 * 0.589 sqrt(n)) =
  // 0.0060, that is 0.51 % of 1.1774; four of them. The twelve-uniform gaussian's own error is under 0.5 %.
  EXPECT_NEAR(robust_sigma(squared), 2.5, 2.5 * 0.025);
  // A third of gross outliers moves the median to the 75 % quantile of the inliers: sqrt(ln 4 / ln 2) = 1.41 times.
  for (int i = 0; i < n / 3; ++i) squared[static_cast<size_t>(3 * i)] = 1e6f;
  EXPECT_NEAR(robust_sigma(squared), 2.5 * 1.414, 2.5 * 0.04);
  EXPECT_EQ(robust_sigma(std::span<float>()), 0.0f);
}

// Efficiency of the weighted location estimate, E[psi']^2 / E[psi^2] relative to the Gaussian's, where in two
// dimensions psi = w(e) e and E[psi'] = E[w + (dw/de) e / 2]; integrated over the Rayleigh density of e.
double efficiency(double c) {
  double slope = 0;
  double variance = 0;
  const double h = 1e-3;
  for (double e = 0.5 * h; e < c; e += h) {
    const double density = e * std::exp(-0.5 * e * e) * h;
    const double a = 1 - e * e / (c * c);
    slope += density * (a * a - 2 * a * e * e / (c * c));
    variance += density * a * a * a * a * e * e / 2;
  }
  return slope * slope / variance;
}

TEST(Robust, TheCutoffIsNinetyFivePercentEfficientInTwoDimensions) {
  EXPECT_NEAR(efficiency(static_cast<double>(kTukeyCutoff)), 0.95, 0.001);
  EXPECT_NEAR(efficiency(4.685), 0.929, 0.001) << "the one-dimensional cut-off";
}

}  // namespace
}  // namespace pptam
