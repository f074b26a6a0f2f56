// Order statistics of small samples.
#pragma once

#include <algorithm>
#include <cstddef>
#include <limits>
#include <vector>

namespace pptam::platform {

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();  // a value that there is not; shown as "-"

// The value that a share of the values does not exceed; NaN without values.
inline double percentile(std::vector<double> values, double share) {
  if (values.empty()) return kNone;
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1) + 0.5);
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

}  // namespace pptam::platform
