// Still images as grey pixels; decoding by GdkPixbuf (PNG, JPEG, PNM, BMP, TIFF).
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
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

// How an image or video says that it wants to be shown; the pixels are given as they are stored.
struct DisplayNote {
  int rotate_degrees = 0;  // clockwise: 0, 90, 180, 270
  bool mirrored = false;   // left and right exchanged, before the rotation
};

struct ImageNotes {
  DisplayNote display;  // Exif's orientation
  std::string dark;     // a warning: 16 bits per pixel of which only the lowest are used; empty: none
};

// Colours by the core's own weights (grey stays exactly grey). Only PNG, JPEG, PNM, TIFF and BMP, told by their first
// bytes, reach a decoder, out of memory. A truncated file is refused. Throws InputError naming the file. notes may be
// null.
GreyPixels read_image(const std::filesystem::path& file, ImageNotes* notes = nullptr);

// Throws InputError naming the file when it cannot be written.
void write_png(const std::filesystem::path& file, const GreyView& image);

}  // namespace pptam::platform
