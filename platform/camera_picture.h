// A camera's image as it is shown: with its colours, where the camera gives them.
#pragma once

#include <cstdint>

#include <pocket_ptam/image.h>

namespace pptam::platform {

// Grey and packed formats are shown as they are; planar ones grey, unless their chroma is given.
struct Picture {
  Frame frame;  // pixels null: the picture drawn last, once more
  // Of NV12 and NV21 one plane, of I420 both: half as wide and high, rounded up.
  const uint8_t* chroma[2] = {nullptr, nullptr};
  int chroma_stride_bytes = 0;
  int x = 0, y = 0, width = 0, height = 0;  // the part that is shown; width 0: all
  int turn_degrees = 0;                     // of that part, clockwise: 0, 90, 180, 270
};

}  // namespace pptam::platform
