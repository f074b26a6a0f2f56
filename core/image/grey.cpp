#include "image/grey.h"

#include <bit>
#include <cstring>

namespace pptam {
namespace {

constexpr uint32_t kRed = 77;  // of 256
constexpr uint32_t kGreen = 150;
constexpr uint32_t kBlue = 29;

static_assert(std::endian::native == std::endian::little, "bgra_to_grey reads a pixel as one little-endian word");

// 256 Y + 128 in the upper half of the word (256 x 255 + 128 < 2^16, so nothing is lost at the top). Red and blue share
// one multiplication: (B + R 2^16) (77 + 29 2^16) has 77 R + 29 B in its upper half and 77 B < 2^16, which carries
// nothing, in its lower half.
inline uint32_t weigh_bgra(const uint8_t* pixel, uint32_t green) {
  uint32_t word;
  std::memcpy(&word, pixel, sizeof(word));
  return (word & 0x00ff00ffu) * (kRed + (kBlue << 16)) + ((word & 0x0000ff00u) * green + (128u << 16));
}

void bgra_to_grey(const uint8_t* src, uint8_t* dst, int width) {
  // Volatile, or the compiler replaces the multiply-add of the phone's processor by four shifts and adds.
  const volatile uint32_t green_weight = kGreen << 8;
  const uint32_t green = green_weight;
  int x = 0;
  for (; x + 4 <= width; x += 4) {  // four at a time: one store, and a quarter of the loop's own instructions
    const uint32_t y0 = weigh_bgra(src + 4 * x, green);
    const uint32_t y1 = weigh_bgra(src + 4 * x + 4, green);
    const uint32_t y2 = weigh_bgra(src + 4 * x + 8, green);
    const uint32_t y3 = weigh_bgra(src + 4 * x + 12, green);
    const uint32_t even = (y2 & 0xffff0000u) | (y0 >> 16);
    const uint32_t odd = (y3 & 0xffff0000u) | (y1 >> 16);
    const uint32_t word = ((even >> 8) & 0x00ff00ffu) | (odd & 0xff00ff00u);
    std::memcpy(dst + x, &word, sizeof(word));
  }
  for (; x < width; ++x) dst[x] = static_cast<uint8_t>(weigh_bgra(src + 4 * x, green) >> 24);
}

void rgb_to_grey(const uint8_t* src, uint8_t* dst, int width) {
  for (int x = 0; x < width; ++x, src += 3)
    dst[x] = static_cast<uint8_t>((kRed * src[0] + kGreen * src[1] + kBlue * src[2] + 128) >> 8);
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
        bgra_to_grey(src, storage.row(y), frame.width);
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
