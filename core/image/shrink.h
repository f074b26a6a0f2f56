// Images made smaller by any factor: each new pixel is the mean of the area that it covers.
#pragma once

#include <pocket_ptam/image.h>

namespace pptam {

// out is at most as wide and as high as in, whose sides are at most 32767. Pixel centres are integers and the edges lie
// half a pixel further out: by a factor s, x becomes (x + 0.5) s - 0.5. Means are rounded half up, so that halving
// gives the next level of the pyramid.
void shrink(const GreyView& in, const GreyImage& out);

}  // namespace pptam
