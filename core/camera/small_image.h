// Small blurred images: level 4 of the pyramid (of a tiny camera level 3) with a 3x3 binomial blur, made by
// make_small_image() of image/pyramid.h. Full-frame rotation aligns two of them; the relocaliser compares them
// [ptam 5.6].
#pragma once

#include "image/pyramid.h"

namespace pptam {

using SmallImage = GreyImage;

// n times the zero-mean sum of squared differences, n sum d^2 - (sum d)^2 over n pixels with differences d: an integer,
// grey^2. 0 when the images differ only by a brightness offset. Both must have the same size, at most ten million
// pixels.
int64_t small_image_zmssd(const GreyView& a, const GreyView& b);

}  // namespace pptam
