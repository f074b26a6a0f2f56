#include "platform/camera/luminance.h"

#include <jerror.h>
#include <jpeglib.h>

#include <csetjmp>
#include <cstddef>
#include <cstdio>  // jpeglib.h needs it

namespace pptam::platform {
namespace {

// libjpeg tells errors by a call that must not return, and damage by a call that may: what follows was guessed.
struct JpegErrors {
  jpeg_error_mgr manager;  // first: libjpeg gives it back as its own
  std::jmp_buf out;
  bool damaged;
  char text[JMSG_LENGTH_MAX];
};

[[noreturn]] void on_jpeg_error(j_common_ptr info) {
  auto* errors = reinterpret_cast<JpegErrors*>(info->err);
  info->err->format_message(info, errors->text);
  std::longjmp(errors->out, 1);  // NOLINT: the library is C, and no object of ours lies between
}

void on_jpeg_message(j_common_ptr info, int level) {
  if (level >= 0) return;  // a trace
  // Bytes between markers lose nothing, and many cameras send them.
  if (info->err->msg_code == JWRN_EXTRANEOUS_DATA) return;
  auto* errors = reinterpret_cast<JpegErrors*>(info->err);
  if (!errors->damaged) info->err->format_message(info, errors->text);
  errors->damaged = true;
}

void no_output(j_common_ptr /*info*/) {}

enum class JpegResult { kGood, kDamaged, kOtherSize, kOtherKind };

// No object with a destructor in here: an error jumps out of it.
JpegResult decode_grey(const uint8_t* data, size_t bytes, int width, int height, uint8_t* out, JpegErrors* errors) {
  jpeg_decompress_struct info;
  errors->damaged = false;
  errors->text[0] = '\0';
  info.err = jpeg_std_error(&errors->manager);
  errors->manager.error_exit = on_jpeg_error;
  errors->manager.emit_message = on_jpeg_message;
  errors->manager.output_message = no_output;
  if (setjmp(errors->out) != 0) {  // NOLINT: as above
    jpeg_destroy_decompress(&info);
    return JpegResult::kDamaged;
  }
  jpeg_create_decompress(&info);
  jpeg_mem_src(&info, data, static_cast<unsigned long>(bytes));
  jpeg_read_header(&info, TRUE);
  JpegResult result = JpegResult::kGood;
  if (info.image_width != static_cast<unsigned>(width) || info.image_height != static_cast<unsigned>(height)) {
    result = JpegResult::kOtherSize;
  } else if (info.progressive_mode || info.arith_code || info.num_components == 4) {  // a few bytes may take minutes
    result = JpegResult::kOtherKind;
  } else {
    info.out_color_space = JCS_GRAYSCALE;  // takes the first component as it is
    info.dct_method = JDCT_ISLOW;          // the only one with the same bits on every processor
    jpeg_start_decompress(&info);
    while (info.output_scanline < info.output_height) {
      JSAMPROW row = out + static_cast<size_t>(info.output_scanline) * static_cast<size_t>(width);
      jpeg_read_scanlines(&info, &row, 1);
    }
    jpeg_finish_decompress(&info);
    if (errors->damaged) result = JpegResult::kDamaged;
  }
  jpeg_destroy_decompress(&info);
  return result;
}

}  // namespace

bool Luminance::read_jpeg(const DeviceFrame& frame) {
  JpegErrors errors;
  const JpegResult result = decode_grey(frame.data, frame.bytes, frame.width, frame.height, pixels_.data(), &errors);
  switch (result) {
    case JpegResult::kGood:
      return true;
    case JpegResult::kDamaged:
      trouble_ = std::string("a damaged JPEG: ") + errors.text;
      break;
    case JpegResult::kOtherSize:
      trouble_ = "a JPEG of another size";
      break;
    case JpegResult::kOtherKind:
      trouble_ = "a JPEG that no camera makes";
      break;
  }
  return false;
}

bool Luminance::read(const DeviceFrame& frame, GreyView* view) {
  const auto width = static_cast<size_t>(frame.width);
  const auto height = static_cast<size_t>(frame.height);
  const auto stride = static_cast<size_t>(frame.stride);
  const size_t row_bytes = frame.layout == PixelLayout::kYuyv ? 2 * width : width;
  if (frame.data == nullptr || frame.width <= 0 || frame.height <= 0 || frame.bytes == 0) {
    trouble_ = "an empty buffer";
    return false;
  }
  if (frame.layout == PixelLayout::kMjpeg) {
    pixels_.resize(width * height);
    if (!read_jpeg(frame)) return false;
    *view = {pixels_.data(), frame.width, frame.height, frame.width};
    return true;
  }
  if (frame.stride <= 0 || stride < row_bytes || frame.bytes < stride * (height - 1) + row_bytes) {
    trouble_ = "a buffer that is too short";
    return false;
  }
  if (frame.layout == PixelLayout::kGrey) {
    *view = {frame.data, frame.width, frame.height, frame.stride};
    return true;
  }
  pixels_.resize(width * height);
  uint8_t* out = pixels_.data();
  for (size_t y = 0; y < height; ++y) {
    const uint8_t* in = frame.data + y * stride;
    for (size_t x = 0; x < width; ++x) *out++ = in[2 * x];
  }
  *view = {pixels_.data(), frame.width, frame.height, frame.width};
  return true;
}

}  // namespace pptam::platform
