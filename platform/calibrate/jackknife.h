// How far a statistic of a clip's frames can be trusted: its spread when a tenth of them, side by side, is left out at
// a time (jackknife). Neighbouring frames err alike, so that blocks are left out, not single frames.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

namespace pptam::platform {

constexpr int kJackknifeBlocks = 10;

inline double sum_of(const std::vector<double>& values) {
  double sum = 0;
  for (const double value : values) sum += value;
  return sum;
}

// Of one value or more.
inline double median_of(std::vector<double> values) {
  std::nth_element(values.begin(), values.begin() + static_cast<ptrdiff_t>(values.size() / 2), values.end());
  return values[values.size() / 2];
}

// Mean of the values but those of a block left out. block -1: of all.
inline double mean_without(const std::vector<double>& values, int block) {
  double sum = 0, count = 0;
  for (size_t i = 0; i < values.size(); ++i) {
    if (static_cast<int>(i * kJackknifeBlocks / values.size()) == block) continue;
    sum += values[i];
    count += 1;
  }
  return sum / count;
}

// Standard deviation of a statistic of all blocks from its values without each.
template <class Statistic>
double jackknife_sigma(const Statistic& without) {
  double mean = 0, squares = 0;
  double values[kJackknifeBlocks];
  for (int block = 0; block < kJackknifeBlocks; ++block) {
    values[block] = without(block);
    mean += values[block] / kJackknifeBlocks;
  }
  for (const double value : values) squares += (value - mean) * (value - mean);
  return std::sqrt(squares * (kJackknifeBlocks - 1) / kJackknifeBlocks);
}

// The minimum of a parabola through the costs at middle - step, middle and middle + step, at most `far` from the
// middle, and its standard deviation. Where it opens downwards: `far` towards the lower side.
struct Minimum {
  double at = 0, sigma = 0;
};
inline Minimum jackknifed_minimum(const std::vector<double>& low, const std::vector<double>& middle,
                                  const std::vector<double>& high, double at, double step, double far) {
  const auto without = [&](int block) {
    const double a = mean_without(low, block), b = mean_without(middle, block), c = mean_without(high, block);
    const double curvature = a + c - 2 * b;
    return at + (curvature > 0 ? std::clamp(0.5 * step * (a - c) / curvature, -far, far) : std::copysign(far, a - c));
  };
  return {without(-1), jackknife_sigma(without)};
}

}  // namespace pptam::platform
