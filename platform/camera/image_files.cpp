#include "platform/camera/image_files.h"

#include <gdk-pixbuf/gdk-pixbuf.h>

#include <algorithm>
#include <fstream>
#include <iterator>
#include <memory>
#include <string>

#include <pocket_ptam/image.h>
#include "platform/input_error.h"

namespace pptam::platform {
namespace {

constexpr int64_t kMaxPixels = int64_t{1} << 26;

using Pixbuf = std::unique_ptr<GdkPixbuf, void (*)(GdkPixbuf*)>;
void unref(GdkPixbuf* pixbuf) {
  g_object_unref(pixbuf);
}

std::string take_message(GError* error) {
  std::string message = error ? error->message : "unknown error";
  if (error) g_error_free(error);
  std::replace(message.begin(), message.end(), '\n', ' ');
  return message;
}

std::string take_string(gchar* text) {
  std::string copy = text ? text : "";
  g_free(text);
  return copy;
}

// The decoders for PNG, PNM and TIFF refuse a truncated file; those for JPEG and BMP fill the missing part with grey or
// black, and so need a look at the file itself.
bool jpeg_is_complete(const std::vector<uint8_t>& bytes) {
  // Markers are 0xff and a code. All but a few are followed by their segment's length (big endian, itself included),
  // which steps over thumbnails; entropy-coded data escapes 0xff as 0xff 0x00.
  constexpr uint8_t kEscape = 0x00, kFill = 0xff, kTem = 0x01, kRst0 = 0xd0, kSoi = 0xd8, kEoi = 0xd9;
  for (size_t i = 0; i + 1 < bytes.size();) {
    const uint8_t code = bytes[i + 1];
    if (bytes[i] != 0xff || code == kFill) {
      ++i;
    } else if (code == kEoi) {
      return true;
    } else if (code == kEscape || code == kTem || (code >= kRst0 && code <= kSoi)) {
      i += 2;
    } else if (i + 3 < bytes.size()) {
      i += size_t{2} + (size_t{bytes[i + 2]} << 8) + bytes[i + 3];
    } else {
      return false;
    }
  }
  return false;
}

bool bmp_is_complete(const std::vector<uint8_t>& bytes) {
  if (bytes.size() < 6) return false;
  size_t promised = 0;  // little endian, at offset 2; some writers leave it 0
  for (size_t i = 0; i < 4; ++i) promised |= size_t{bytes[2 + i]} << (8 * i);
  return bytes.size() >= promised;
}

void check_format(const std::string& name, const std::string& format) {
  if (format == "png" || format == "pnm" || format == "tiff") return;
  if (format != "jpeg" && format != "bmp") {
    throw InputError("image " + name + " is in the format " + format + ", which is not read: convert it to PNG");
  }
  std::ifstream stream(name, std::ios::binary);
  const std::vector<uint8_t> bytes{std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
  if (!(format == "jpeg" ? jpeg_is_complete(bytes) : bmp_is_complete(bytes))) {
    throw InputError("cannot read image " + name + ": the file is truncated");
  }
}

}  // namespace

GreyPixels read_image(const std::filesystem::path& file) {
  const std::string name = file.string();
  std::error_code error_code;
  if (!std::filesystem::exists(file, error_code)) throw InputError("image " + name + " is missing");
  if (!std::filesystem::is_regular_file(file, error_code)) throw InputError("image " + name + " is not a regular file");

  int width = 0;
  int height = 0;
  if (GdkPixbufFormat* known = gdk_pixbuf_get_file_info(name.c_str(), &width, &height)) {
    check_format(name, take_string(gdk_pixbuf_format_get_name(known)));
    if (width > kMaxSide || height > kMaxSide || int64_t{width} * height > kMaxPixels) {
      throw InputError("image " + name + " is " + std::to_string(width) + "x" + std::to_string(height) +
                       " pixels: too large to read");
    }
  }
  GError* error = nullptr;
  const Pixbuf pixbuf(gdk_pixbuf_new_from_file(name.c_str(), &error), unref);
  if (!pixbuf) throw InputError("cannot read image " + name + ": " + take_message(error));

  GreyPixels grey;
  grey.width = gdk_pixbuf_get_width(pixbuf.get());
  grey.height = gdk_pixbuf_get_height(pixbuf.get());
  const int channels = gdk_pixbuf_get_n_channels(pixbuf.get());  // 3, or 4 with alpha, which is ignored
  const int stride = gdk_pixbuf_get_rowstride(pixbuf.get());
  const uint8_t* source = gdk_pixbuf_read_pixels(pixbuf.get());
  grey.px.resize(static_cast<size_t>(grey.width) * static_cast<size_t>(grey.height));
  std::vector<uint8_t> rgb(size_t{3} * static_cast<size_t>(grey.width));
  for (int y = 0; y < grey.height; ++y) {
    const uint8_t* in = source + static_cast<ptrdiff_t>(y) * stride;
    uint8_t* out = rgb.data();
    for (int x = 0; x < grey.width; ++x, in += channels, out += 3) std::copy(in, in + 3, out);
    const Frame row = {rgb.data(), grey.width, 1, 3 * grey.width, PixelFormat::kRgb24, 0};
    to_grey(row, GreyImage{grey.px.data() + static_cast<ptrdiff_t>(y) * grey.width, grey.width, 1, grey.width});
  }
  return grey;
}

void write_png(const std::filesystem::path& file, const GreyView& image) {
  const Pixbuf pixbuf(gdk_pixbuf_new(GDK_COLORSPACE_RGB, FALSE, 8, image.width, image.height), unref);
  if (!pixbuf) throw InputError("cannot write " + file.string() + ": not enough memory for the image");
  const int stride = gdk_pixbuf_get_rowstride(pixbuf.get());
  uint8_t* pixels = gdk_pixbuf_get_pixels(pixbuf.get());
  for (int y = 0; y < image.height; ++y) {
    uint8_t* out = pixels + static_cast<ptrdiff_t>(y) * stride;
    for (int x = 0; x < image.width; ++x, out += 3) std::fill(out, out + 3, image.at(x, y));
  }
  GError* error = nullptr;
  if (!gdk_pixbuf_save(pixbuf.get(), file.c_str(), "png", &error, nullptr)) {
    throw InputError("cannot write " + file.string() + ": " + take_message(error));
  }
}

}  // namespace pptam::platform
