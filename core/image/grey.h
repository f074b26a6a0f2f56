// Any supported camera format to 8-bit grey [phone 3.1].
#pragma once

#include "base/status.h"
#include "image/image.h"

namespace pptam {

// Checks that the frame is complete: non-null, positive even-for-subsampled size, stride at least one row of pixels.
Status validate_frame(const Frame& frame);

// Grey view of a valid frame. Grey and planar YUV frames are used in place (the view points into the frame); others are
// converted into storage, which must have the frame's size. Y = (77 R + 150 G + 29 B + 128) >> 8: the weights sum to
// 256, so a grey BGRA or RGB pixel keeps its value exactly.
GreyView to_grey(const Frame& frame, const GreyImage& storage);

}  // namespace pptam
