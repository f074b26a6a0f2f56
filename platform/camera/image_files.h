// Still images as grey pixels; decoding by GdkPixbuf (PNG, JPEG, PNM, BMP, TIFF).
#pragma once

#include <cstdint>
#include <filesystem>
#include <vector>

#include <pocket_ptam/image.h>

namespace pptam::platform {

constexpr int kMaxSide = 16384;  // pixels, of images and videos; a header may promise more than the memory holds

struct GreyPixels {
  int width = 0;
  int height = 0;
  std::vector<uint8_t> px;  // row major, width * height
  GreyView view() const { return {px.data(), width, height, width}; }
};

// Colours by the core's own weights (grey stays exactly grey). A truncated file is refused. Throws InputError
// naming the file.
GreyPixels read_image(const std::filesystem::path& file);

// Throws InputError naming the file when it cannot be written.
void write_png(const std::filesystem::path& file, const GreyView& image);

}  // namespace pptam::platform
