// The Tukey biweight and its robust scale [ptam 5.4], for residuals of one or two components.
//
// e2 is a residual's squared norm, after division by its expected sigma: that of the pyramid level for image points.
// Edges have one component, the distance along the normal.
#pragma once

#include <algorithm>
#include <cmath>
#include <span>

namespace pptam {

// Cut-offs in units of sigma, for 95 % efficiency with Gaussian residuals: of two components, and of one. The
// textbook's 4.685 is 92.9 % efficient in two dimensions.
constexpr float kTukeyCutoff = 5.12f;
constexpr float kTukeyCutoff1d = 4.685f;

// Floor of the robust scale, in units of the level's sigma (2^level px). Above the noise of sub-pixel refinement, which
// is 0.02 to 0.12 depending on contrast (tests/kernels), so that a few perfect points do not reject all others.
constexpr float kRobustSigmaFloor = 0.15f;

// Ratio of a Gaussian residual's median norm to sigma, two components: sqrt(2 ln 2).
constexpr float kMedianOverSigma = 1.1774f;
// Ratio of sigma to a Gaussian residual's median magnitude, one component: 1 / 0.6745.
constexpr float kSigmaOverMedian1d = 1.4826f;

// Median of the values (of an even number, the larger of the two in the middle). Reorders values. 0 when empty.
inline float median_of(std::span<float> values) {
  if (values.empty()) return 0.0f;
  auto middle = values.begin() + static_cast<long>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// Robust sigma of a component from the squared norms of residuals of two components (robust_sigma) or of one
// (robust_sigma_1d). Reorders values. 0 when empty.
inline float robust_sigma(std::span<float> squared_norms) {
  return std::sqrt(median_of(squared_norms)) / kMedianOverSigma;
}
inline float robust_sigma_1d(std::span<float> squared_norms) {
  return std::sqrt(median_of(squared_norms)) * kSigmaOverMedian1d;
}

// The biweight for one sigma and cut-off.
class Tukey {
 public:
  explicit Tukey(float sigma, float cutoff = kTukeyCutoff) : cutoff_sq_(cutoff * cutoff * sigma * sigma) {}
  // (1 - e2/c2)^2 within the cut-off c, 0 outside.
  float weight(float e2) const {
    if (!(e2 < cutoff_sq_)) return 0.0f;
    const float a = 1.0f - e2 / cutoff_sq_;
    return a * a;
  }
  // Objective c2/6 (1 - (1 - e2/c2)^3) within the cut-off, c2/6 outside. Its derivative by e2 is half the weight.
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
