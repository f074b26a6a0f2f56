#include "platform/camera/image_files.h"

#include <gdk-pixbuf/gdk-pixbuf.h>

#include <algorithm>
#include <cstddef>
#include <cstdlib>
#include <memory>
#include <span>
#include <string>

#include <pocket_ptam/image.h>
#include "platform/files.h"
#include "platform/input_error.h"

namespace pptam::platform {
namespace {

constexpr int64_t kMaxPixels = int64_t{1} << 26;
constexpr size_t kMaxImageBytes = size_t{256} << 20;  // of a file: 64 million pixels of 4 bytes
constexpr uint8_t kDarkestWhite = 32;                 // an eighth of the range; 12 bits in 16 use a sixteenth

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

using Bytes = std::span<const std::byte>;

// Numbers in a file's bytes; 0 beyond its end.
uint32_t number_at(Bytes bytes, uint64_t at, size_t size, bool big_endian) {
  uint32_t value = 0;
  for (size_t i = 0; i < size; ++i) {
    const uint64_t k = at + (big_endian ? i : size - 1 - i);
    value = (value << 8) | (k < bytes.size() ? std::to_integer<uint32_t>(bytes[k]) : 0);
  }
  return value;
}

struct ImageHeader {
  const char* format = nullptr;  // as GdkPixbuf calls it; null: none that is read
  int64_t width = 0;
  int64_t height = 0;
  int bits = 8;              // per channel
  std::string refusal = {};  // why it cannot be read
};

constexpr const char* kCutShort = "the file is truncated";

// PNG: chunks of a length, a name, content and a checksum, up to one called IEND.
ImageHeader png_header(Bytes bytes) {
  ImageHeader header{"png", number_at(bytes, 16, 4, true), number_at(bytes, 20, 4, true)};
  header.bits = static_cast<int>(number_at(bytes, 24, 1, true));
  constexpr uint32_t kIend = 0x49454e44;
  for (uint64_t at = 8;; at += uint64_t{12} + number_at(bytes, at, 4, true)) {
    if (at + 12 > bytes.size()) header.refusal = kCutShort;
    if (at + 12 > bytes.size() || number_at(bytes, at + 4, 4, true) == kIend) return header;
  }
}

// JPEG: markers are 0xff and a code. All but a few are followed by their segment's length (big endian, itself
// included), which steps over thumbnails; entropy-coded data escapes 0xff as 0xff 0x00.
ImageHeader jpeg_header(Bytes bytes) {
  constexpr uint32_t kEscape = 0x00, kFill = 0xff, kTem = 0x01, kRst0 = 0xd0, kSoi = 0xd8, kEoi = 0xd9;
  ImageHeader header{"jpeg"};
  for (uint64_t i = 0; i + 1 < bytes.size();) {
    const uint32_t code = number_at(bytes, i + 1, 1, true);
    if (number_at(bytes, i, 1, true) != 0xff || code == kFill) {
      ++i;
    } else if (code == kEoi) {
      return header;
    } else if (code == kEscape || code == kTem || (code >= kRst0 && code <= kSoi)) {
      i += 2;
    } else {
      const bool frame = code >= 0xc0 && code <= 0xcf && code != 0xc4 && code != 0xc8 && code != 0xcc;
      if (frame && header.width == 0) {
        header.height = number_at(bytes, i + 5, 2, true);
        header.width = number_at(bytes, i + 7, 2, true);
        if (number_at(bytes, i + 9, 1, true) == 4) header.refusal = "CMYK colours are not read: convert it to RGB";
      }
      i += uint64_t{2} + number_at(bytes, i + 2, 2, true);
    }
  }
  header.refusal = kCutShort;
  return header;
}

ImageHeader bmp_header(Bytes bytes) {
  ImageHeader header{"bmp"};
  const bool old = number_at(bytes, 14, 4, false) == 12;  // OS/2's, with sides of two bytes
  const auto side = [&](size_t at) { return std::abs(int64_t{static_cast<int32_t>(number_at(bytes, at, 4, false))}); };
  header.width = old ? number_at(bytes, 18, 2, false) : side(18);  // a negative height: top row first
  header.height = old ? number_at(bytes, 20, 2, false) : side(22);
  const size_t promised = number_at(bytes, 2, 4, false);  // some writers leave it 0
  if (bytes.size() < 26 || bytes.size() < promised) header.refusal = kCutShort;
  return header;
}

// TIFF: a table of tags of 12 bytes each; only values of one number are needed here.
ImageHeader tiff_header(Bytes bytes) {
  ImageHeader header{"tiff"};
  const bool big_endian = number_at(bytes, 0, 1, true) == 'M';
  const uint64_t table = number_at(bytes, 4, 4, big_endian);
  const uint32_t entries = number_at(bytes, table, 2, big_endian);
  for (uint64_t i = 0; i < entries && table + 2 + 12 * (i + 1) <= bytes.size(); ++i) {
    const uint64_t at = table + 2 + 12 * i;
    const uint32_t tag = number_at(bytes, at, 2, big_endian);
    const uint32_t type = number_at(bytes, at + 2, 2, big_endian);
    const size_t size = type == 3 ? 2 : 4;  // of each value
    const uint32_t count = number_at(bytes, at + 4, 4, big_endian);
    const uint64_t value_at = count * uint64_t{size} <= 4 ? at + 8 : number_at(bytes, at + 8, 4, big_endian);
    const uint32_t value = number_at(bytes, value_at, size, big_endian);
    // Told twice or in another type, the decoder might see another size than is checked here.
    const bool told = (tag == 256 && header.width != 0) || (tag == 257 && header.height != 0);
    if ((tag == 256 || tag == 257) && (told || (type != 3 && type != 4))) {
      header.refusal = "its size is written in an unusual way: convert it to PNG";
      return header;
    }
    if (tag == 256) header.width = value;
    if (tag == 257) header.height = value;
    if (tag == 258) header.bits = static_cast<int>(std::min<uint32_t>(value, 64));
    if (tag == 339 && value == 3) header.refusal = "floating point pixels are not read: convert it to 8 or 16 bits";
  }
  if (header.width == 0) header.refusal = kCutShort;
  return header;
}

// PNM: "P5 640 480 255" with any blanks and comments between, and one blank after.
ImageHeader pnm_header(Bytes bytes) {
  ImageHeader header{"pnm"};
  const uint32_t kind = number_at(bytes, 1, 1, true) - '0';
  const bool bitmap = kind == 1 || kind == 4;
  int64_t numbers[3] = {0, 0, 1};
  size_t at = 2;
  for (int i = 0; i < (bitmap ? 2 : 3); ++i) {
    const auto c = [&] { return at < bytes.size() ? static_cast<char>(bytes[at]) : '\0'; };
    while (c() == ' ' || (c() >= '\t' && c() <= '\r') || c() == '#') {
      if (c() == '#') {
        while (at < bytes.size() && c() != '\n') ++at;
      } else {
        ++at;
      }
    }
    for (; c() >= '0' && c() <= '9'; ++at) {
      numbers[i] = std::min<int64_t>((numbers[i] == 1 && i == 2 ? 0 : numbers[i]) * 10 + (c() - '0'), INT32_MAX);
    }
  }
  header.width = numbers[0];
  header.height = numbers[1];
  header.bits = numbers[2] > 255 ? 16 : 8;
  const int64_t row = bitmap ? (header.width + 7) / 8 : header.width * (kind == 6 ? 3 : 1) * (header.bits / 8);
  if (kind >= 4 && static_cast<int64_t>(bytes.size() - at) < 1 + row * header.height) header.refusal = kCutShort;
  return header;
}

ImageHeader header_of(Bytes bytes) {
  const uint32_t first = number_at(bytes, 0, 4, true);
  const auto blank = [&](uint32_t c) { return c == ' ' || c == '#' || (c >= '\t' && c <= '\r'); };
  if (first == 0x89504e47 && number_at(bytes, 4, 4, true) == 0x0d0a1a0a) return png_header(bytes);
  if (first >> 8 == 0xffd8ff) return jpeg_header(bytes);
  if (first == 0x49492a00 || first == 0x4d4d002a) return tiff_header(bytes);
  if (first >> 16 == 0x424d) return bmp_header(bytes);
  const uint32_t digit = (first >> 16) & 0xff;
  if (first >> 24 == 'P' && digit >= '1' && digit <= '6' && blank((first >> 8) & 0xff)) return pnm_header(bytes);
  return {};
}

ImageHeader checked_header(const std::string& name, Bytes bytes) {
  ImageHeader header = header_of(bytes);
  if (bytes.empty()) throw InputError("cannot read image " + name + ": the file is empty");
  if (!header.format) {
    throw InputError("image " + name + " is not in a format that is read (PNG, JPEG, PNM, TIFF, BMP): convert it");
  }
  const std::string size = std::to_string(header.width) + "x" + std::to_string(header.height) + " pixels";
  if (header.width > kMaxSide || header.height > kMaxSide || header.width * header.height > kMaxPixels) {
    throw InputError("image " + name + " is " + size + ": too large to read");
  }
  if (!header.refusal.empty()) throw InputError("cannot read image " + name + ": " + header.refusal);
  return header;
}

struct SizeCheck {
  int64_t width, height;  // of the header, which has been checked
  bool differs = false;
};

// Called before a decoder takes memory for pixels: one that is then asked for none gives up.
void refuse_other_size(GdkPixbufLoader* loader, int width, int height, gpointer size_check) {
  auto& check = *static_cast<SizeCheck*>(size_check);
  check.differs = width != check.width || height != check.height;
  if (check.differs) gdk_pixbuf_loader_set_size(loader, 0, 0);
}

// Decoded by the format's own decoder: no other one looks at the bytes.
Pixbuf decode(const std::string& name, const ImageHeader& header, Bytes bytes) {
  GError* error = nullptr;
  GdkPixbufLoader* loader = gdk_pixbuf_loader_new_with_type(header.format, &error);
  if (!loader) throw InputError("cannot read image " + name + ": " + take_message(error));
  const std::unique_ptr<GdkPixbufLoader, void (*)(GdkPixbufLoader*)> owner(loader, [](auto* l) { g_object_unref(l); });
  SizeCheck check{header.width, header.height};
  g_signal_connect(loader, "size-prepared", G_CALLBACK(refuse_other_size), &check);
  const bool written =
      gdk_pixbuf_loader_write(loader, reinterpret_cast<const guchar*>(bytes.data()), bytes.size(), &error) != FALSE;
  const bool closed = gdk_pixbuf_loader_close(loader, written ? &error : nullptr) != FALSE;
  if (!written || !closed) {
    const std::string message = take_message(error);
    throw InputError("cannot read image " + name + ": " +
                     (check.differs ? "its header tells two sizes: convert it" : message));
  }
  GdkPixbuf* pixbuf = gdk_pixbuf_loader_get_pixbuf(loader);
  if (!pixbuf) throw InputError("cannot read image " + name + ": it holds no image");
  return {GDK_PIXBUF(g_object_ref(pixbuf)), unref};
}

// Exif's orientations 1 to 8.
DisplayNote display_note(GdkPixbuf* pixbuf) {
  const char* text = gdk_pixbuf_get_option(pixbuf, "orientation");
  const int orientation = text ? std::atoi(text) : 1;
  constexpr DisplayNote kNotes[] = {{},          {0, false},  {0, true},  {180, false}, {180, true},
                                    {270, true}, {90, false}, {90, true}, {270, false}};
  return orientation >= 1 && orientation <= 8 ? kNotes[orientation] : DisplayNote();
}

}  // namespace

GreyPixels read_image(const std::filesystem::path& file, ImageNotes* notes) {
  const std::string name = file.string();
  std::error_code error_code;
  if (!std::filesystem::exists(file, error_code)) throw InputError("image " + name + " is missing");
  if (!std::filesystem::is_regular_file(file, error_code)) throw InputError("image " + name + " is not a regular file");
  const std::vector<std::byte> bytes = read_file(file, kMaxImageBytes);
  const ImageHeader header = checked_header(name, bytes);
  const Pixbuf pixbuf = decode(name, header, bytes);

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
  if (notes) {
    notes->display = display_note(pixbuf.get());
    const uint8_t brightest = *std::max_element(grey.px.begin(), grey.px.end());
    if (header.bits == 16 && brightest < kDarkestWhite) {
      notes->dark = "image " + name + " has 16 bits per pixel, but uses only the darkest " +
                    std::to_string(brightest + 1) + " of 256 grey levels: scale it to the full range";
    }
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
