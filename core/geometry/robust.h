// The Tukey biweight and its scale [ptam 5.4].
//
// Residuals are 2-D image errors divided by their level's sigma; e2 is their squared norm.
#pragma once

#include <algorithm>
#include <cmath>
#include <span>

namespace pptam {

// Cut-off in units of sigma: 95 % efficient for two-dimensional Gaussian residuals.
constexpr float kTukeyCutoff = 5.12f;

// Smallest scale that residuals may show, in units of their level's sigma (2^level px): no less than what sub-pixel
// refinement adds (0.02 to 0.12 by contrast, tests/kernels), so that a few perfect points do not reject all others.
constexpr float kRobustSigmaFloor = 0.15f;

// sigma of one coordinate from the median of squared 2-D norms: median(|e|^2) = 2 ln 2 sigma^2, sqrt(2 ln 2) = 1.1774.
// Reorders values. 0 when empty.
inline float robust_sigma(std::span<float> squared_norms) {
  if (squared_norms.empty()) return 0.0f;
  auto middle = squared_norms.begin() + static_cast<long>(squared_norms.size() / 2);
  std::nth_element(squared_norms.begin(), middle, squared_norms.end());
  return std::sqrt(*middle) / 1.1774f;
}

// Weight (1 - e2/c2)^2 within the cut-off c = kTukeyCutoff * sigma, 0 outside.
inline float tukey_weight(float e2, float sigma) {
  const float c2 = kTukeyCutoff * kTukeyCutoff * sigma * sigma;
  if (!(e2 < c2)) return 0.0f;
  const float a = 1.0f - e2 / c2;
  return a * a;
}

// Objective c2/6 (1 - (1 - e2/c2)^3), saturating at c2/6; its derivative with respect to e2 is half the weight.
inline float tukey_cost(float e2, float sigma) {
  const float c2 = kTukeyCutoff * kTukeyCutoff * sigma * sigma;
  if (!(e2 < c2)) return c2 / 6.0f;
  const float a = 1.0f - e2 / c2;
  return c2 / 6.0f * (1.0f - a * a * a);
}

}  // namespace pptam
