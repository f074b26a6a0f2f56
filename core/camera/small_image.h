// Small blurred images: level 4 of the pyramid with a 3x3 binomial blur (image/pyramid.h makes them). Full-frame
// rotation aligns two of them, the relocaliser compares them [ptam 5.6].
#pragma once

#include "image/pyramid.h"

namespace pptam {

using SmallImage = GreyImage;

// Zero-mean sum of squared differences, n sum d^2 - (sum d)^2 of the differences d of n pixels: n times what its name
// says, and a whole number. 0: equal but for brightness. Both of the same size, at most 8192 pixels.
int64_t small_image_zmssd(const GreyView& a, const GreyView& b);

}  // namespace pptam
