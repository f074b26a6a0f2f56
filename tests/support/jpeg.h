// Grey images as JPEGs of three components, such as cameras send them.
#pragma once

#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <vector>

// After cstdio, which it needs.
#include <jpeglib.h>

namespace pptam::test {

// quality: 1 to 100; of the latter nothing is lost but by rounding.
inline std::vector<uint8_t> encode_jpeg(int width, int height, const std::vector<uint8_t>& grey, int quality,
                                        bool progressive = false) {
  jpeg_compress_struct coder{};
  jpeg_error_mgr errors{};
  coder.err = jpeg_std_error(&errors);
  jpeg_create_compress(&coder);
  unsigned char* data = nullptr;
  unsigned long bytes = 0;
  jpeg_mem_dest(&coder, &data, &bytes);
  coder.image_width = static_cast<JDIMENSION>(width);
  coder.image_height = static_cast<JDIMENSION>(height);
  coder.input_components = 3;
  coder.in_color_space = JCS_YCbCr;
  jpeg_set_defaults(&coder);
  jpeg_set_quality(&coder, quality, TRUE);
  if (progressive) jpeg_simple_progression(&coder);
  jpeg_start_compress(&coder, TRUE);
  std::vector<uint8_t> row(3 * static_cast<size_t>(width), 128);
  for (size_t y = 0; y < static_cast<size_t>(height); ++y) {
    for (size_t x = 0; x < static_cast<size_t>(width); ++x) row[3 * x] = grey[y * static_cast<size_t>(width) + x];
    JSAMPROW line = row.data();
    jpeg_write_scanlines(&coder, &line, 1);
  }
  jpeg_finish_compress(&coder);
  std::vector<uint8_t> all(data, data + bytes);
  jpeg_destroy_compress(&coder);
  std::free(data);
  return all;
}

}  // namespace pptam::test
