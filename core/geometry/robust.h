// The Tukey biweight and its scale [ptam 5.4], for residuals of one component or two.
//
// e2 is a residual's squared norm, in units of its expected sigma: for image points errors divided by their level's
// sigma, for edges distances along the normal.
#pragma once

#include <algorithm>
#include <cmath>
#include <span>

namespace pptam {

// Cut-off in units of sigma: 95 % efficient for Gaussian residuals of two components.
constexpr float kTukeyCutoff = 5.12f;
// The same for residuals of one component.
constexpr float kTukeyCutoff1d = 4.685f;

// Smallest scale that residuals may show, in units of their level's sigma (2^level px): no less than what sub-pixel
// refinement adds (0.02 to 0.12 by contrast, tests/kernels), so that a few perfect points do not reject all others.
constexpr float kRobustSigmaFloor = 0.15f;

// Median of the values, the larger of the two in the middle; reorders them. 0 when empty.
inline float median_of(std::span<float> values) {
  if (values.empty()) return 0.0f;
  auto middle = values.begin() + static_cast<long>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// sigma of a component from the median of squared norms. Two components: median(|e|^2) = 2 ln 2 sigma^2,
// sqrt(2 ln 2) = 1.1774; one: median(|e|) = 0.6745 sigma. Reorders values. 0 when empty.
inline float robust_sigma(std::span<float> squared_norms) {
  return std::sqrt(median_of(squared_norms)) / 1.1774f;
}
inline float robust_sigma_1d(std::span<float> squared_norms) {
  return std::sqrt(median_of(squared_norms)) * 1.4826f;
}

// The biweight at one scale.
class Tukey {
 public:
  explicit Tukey(float sigma, float cutoff = kTukeyCutoff) : cutoff_sq_(cutoff * cutoff * sigma * sigma) {}
  // (1 - e2/c2)^2 within the cut-off c, 0 outside.
  float weight(float e2) const {
    if (!(e2 < cutoff_sq_)) return 0.0f;
    const float a = 1.0f - e2 / cutoff_sq_;
    return a * a;
  }
  // Objective c2/6 (1 - (1 - e2/c2)^3), saturating at c2/6; its derivative with respect to e2 is half the weight.
  float cost(float e2) const {
    if (!(e2 < cutoff_sq_)) return saturated();
    const float a = 1.0f - e2 / cutoff_sq_;
    return cutoff_sq_ / 6.0f * (1.0f - a * a * a);
  }
  float saturated() const { return cutoff_sq_ / 6.0f; }

 private:
  float cutoff_sq_;
};

inline float tukey_weight(float e2, float sigma) {
  return Tukey(sigma).weight(e2);
}
inline float tukey_cost(float e2, float sigma) {
  return Tukey(sigma).cost(e2);
}

}  // namespace pptam
