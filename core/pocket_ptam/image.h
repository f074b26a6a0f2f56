// Image views and frames: pointers into memory that the caller owns.
//
// Pixel centres are integers: the top-left pixel is centred on (0, 0). x runs along columns to the right, y along rows
// downwards. Level 0 is the full image, level l is 2^l times smaller (2x2 box means), so that a level-l pixel centre
// lies at x0 = (xl + 0.5) * 2^l - 0.5 in level 0. All conversions use to_level0() and from_level0().
#pragma once

#include <cstdint>

#include <pocket_ptam/status.h>

namespace pptam {

// A rectangle of pixels, not owned. stride: elements from one row to the next, at least width. Rows need no alignment.
template <class T>
struct ImageView {
  T* data = nullptr;
  int width = 0;
  int height = 0;
  int stride = 0;

  T* row(int y) const { return data + static_cast<int64_t>(y) * stride; }
  T& at(int x, int y) const { return row(y)[x]; }
  bool empty() const { return width <= 0 || height <= 0 || data == nullptr; }
  operator ImageView<const T>() const { return {data, width, height, stride}; }
};
using GreyView = ImageView<const uint8_t>;  // read only
using GreyImage = ImageView<uint8_t>;       // writable

enum class PixelFormat : uint8_t { kGrey, kBgra, kRgb24, kYuyv, kNv12, kNv21, kI420 };

// A camera image. data points to the first plane; for the planar YUV formats only the Y plane is read.
struct Frame {
  const uint8_t* data = nullptr;
  int width = 0;         // pixels
  int height = 0;        // pixels
  int stride_bytes = 0;  // of the first plane
  PixelFormat format = PixelFormat::kGrey;
  int64_t timestamp_ns = 0;  // mid-exposure of the image centre
};

// Checks that the frame is complete: data not null, positive size (even where colour is subsampled), stride at least
// one row of pixels, known format.
Status validate_frame(const Frame& frame);

// Grey view of a valid frame [phone 3.1]. Grey and planar YUV frames are used in place (the view points into the
// frame); others are converted into storage, which must have the frame's size. Y = (77 R + 150 G + 29 B + 128) >> 8:
// the weights sum to 256, so a grey BGRA or RGB pixel keeps its value exactly.
GreyView to_grey(const Frame& frame, const GreyImage& storage);

// A coordinate of level `level`, pixels, in level 0.
constexpr float to_level0(float x, int level) {
  return (x + 0.5f) * static_cast<float>(1 << level) - 0.5f;
}
// A level-0 coordinate, pixels, in level `level`.
constexpr float from_level0(float x0, int level) {
  return (x0 + 0.5f) / static_cast<float>(1 << level) - 0.5f;
}

}  // namespace pptam
