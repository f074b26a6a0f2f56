#include "camera/small_image.h"

namespace pptam {

int64_t small_image_zmssd(const GreyView& a, const GreyView& b) {
  int64_t sum = 0, sum_sq = 0;
  for (int y = 0; y < a.height; ++y) {
    for (int x = 0; x < a.width; ++x) {
      const int d = static_cast<int>(a.at(x, y)) - static_cast<int>(b.at(x, y));
      sum += d;
      sum_sq += d * d;
    }
  }
  return sum_sq * (a.width * a.height) - sum * sum;
}

}  // namespace pptam
