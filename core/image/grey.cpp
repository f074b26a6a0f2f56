#include <pocket_ptam/image.h>
#include "base/assert.h"
#include "image/kernels.h"

namespace pptam {
namespace {

void rgb_to_grey(const uint8_t* src, uint8_t* dst, int width) {
  for (int x = 0; x < width; ++x, src += 3)
    dst[x] = static_cast<uint8_t>((kRedWeight * src[0] + kGreenWeight * src[1] + kBlueWeight * src[2] + 128) >> 8);
}

void yuyv_to_grey(const uint8_t* src, uint8_t* dst, int width) {
  for (int x = 0; x < width; ++x) dst[x] = src[2 * x];
}

// Bytes a pixel takes in the first plane; 0 for a format that does not exist.
int bytes_per_pixel(PixelFormat format) {
  switch (format) {
    case PixelFormat::kGrey:
    case PixelFormat::kNv12:
    case PixelFormat::kNv21:
    case PixelFormat::kI420:
      return 1;
    case PixelFormat::kYuyv:
      return 2;
    case PixelFormat::kRgb24:
      return 3;
    case PixelFormat::kBgra:
      return 4;
  }
  return 0;
}

}  // namespace

Status validate_frame(const Frame& frame) {
  if (!frame.data) return {StatusCode::kInvalidArgument, "the frame's data pointer is null"};
  if (frame.width <= 0 || frame.height <= 0)
    return {StatusCode::kInvalidArgument, "the frame's width and height must be positive"};
  const int bytes = bytes_per_pixel(frame.format);
  if (bytes == 0) return {StatusCode::kInvalidArgument, "the frame's pixel format is unknown"};
  const bool planar =
      frame.format == PixelFormat::kNv12 || frame.format == PixelFormat::kNv21 || frame.format == PixelFormat::kI420;
  if ((planar || frame.format == PixelFormat::kYuyv) && frame.width % 2 != 0)
    return {StatusCode::kInvalidArgument, "a frame with subsampled colour must have an even width"};
  if (planar && frame.height % 2 != 0)
    return {StatusCode::kInvalidArgument, "a planar YUV frame must have an even height"};
  if (frame.stride_bytes < static_cast<int64_t>(frame.width) * bytes)
    return {StatusCode::kInvalidArgument, "the frame's stride is less than one row of pixels"};
  return {};
}

GreyView to_grey(const Frame& frame, const GreyImage& storage) {
  if (bytes_per_pixel(frame.format) == 1) return {frame.data, frame.width, frame.height, frame.stride_bytes};
  PPTAM_ASSERT(storage.width == frame.width && storage.height == frame.height && storage.data);
  for (int y = 0; y < frame.height; ++y) {
    const uint8_t* src = frame.data + static_cast<int64_t>(y) * frame.stride_bytes;
    switch (frame.format) {
      case PixelFormat::kBgra:
        kernel::bgra_row(src, storage.row(y), frame.width);
        break;
      case PixelFormat::kRgb24:
        rgb_to_grey(src, storage.row(y), frame.width);
        break;
      default:
        yuyv_to_grey(src, storage.row(y), frame.width);
        break;
    }
  }
  return storage;
}

}  // namespace pptam
