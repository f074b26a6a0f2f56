// same_pictures A B [--but COUNT LEVELS] [--colour R G B COUNT]...: compares pictures of a display, each a PNG, a PPM
// (qemu's screendump) or a dump of a window (xwd). Says how many pixels differ, and by how much; exit code 0 when none
// does or, with --but, no more than COUNT by more than LEVELS. --colour: besides, A is to have at least COUNT pixels
// within 40 levels of that colour.
#include <cairo.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <sstream>
#include <string>
#include <vector>

namespace {

struct Pixels {
  int width = 0, height = 0;
  std::vector<std::array<int, 3>> rgb;
};

[[noreturn]] void give_up(const std::string& why) {
  std::fprintf(stderr, "same_pictures: %s\n", why.c_str());
  std::exit(2);
}

Pixels read_png(const std::string& file) {
  cairo_surface_t* surface = cairo_image_surface_create_from_png(file.c_str());
  if (cairo_surface_status(surface) != CAIRO_STATUS_SUCCESS) give_up(file + ": is no PNG");
  Pixels pixels = {cairo_image_surface_get_width(surface), cairo_image_surface_get_height(surface), {}};
  const unsigned char* data = cairo_image_surface_get_data(surface);
  for (int y = 0; y < pixels.height; ++y) {
    const auto* row = reinterpret_cast<const uint32_t*>(data + y * cairo_image_surface_get_stride(surface));
    for (int x = 0; x < pixels.width; ++x)
      pixels.rgb.push_back(
          {static_cast<int>(row[x] >> 16 & 255), static_cast<int>(row[x] >> 8 & 255), static_cast<int>(row[x] & 255)});
  }
  cairo_surface_destroy(surface);
  return pixels;
}

Pixels read_ppm(const std::string& file, const std::string& content) {
  std::istringstream text(content);
  std::string magic;
  int most = 0;
  Pixels pixels;
  text >> magic >> pixels.width >> pixels.height >> most;
  text.get();
  const auto first = static_cast<size_t>(text.tellg());
  const size_t count = static_cast<size_t>(pixels.width) * static_cast<size_t>(pixels.height);
  if (most != 255 || content.size() < first + 3 * count) give_up(file + ": is no whole PPM");
  for (size_t i = 0; i < count; ++i) {
    const auto* p = reinterpret_cast<const uint8_t*>(content.data()) + first + 3 * i;
    pixels.rgb.push_back({p[0], p[1], p[2]});
  }
  return pixels;
}

// XWDFile.h: big-endian words; 32 bits a pixel, the lowest byte first, as of a screen of 24 bits.
Pixels read_xwd(const std::string& file, const std::string& content) {
  const auto word = [&](size_t i) {
    uint32_t value = 0;
    for (size_t byte = 0; byte < 4; ++byte) value = value << 8 | static_cast<uint8_t>(content[4 * i + byte]);
    return value;
  };
  if (content.size() < 100 || word(1) != 7 || word(11) != 32 || word(7) != 0)
    give_up(file + ": is no dump that is known");
  Pixels pixels = {static_cast<int>(word(4)), static_cast<int>(word(5)), {}};
  const size_t first = word(0) + 12 * static_cast<size_t>(word(19));
  for (int y = 0; y < pixels.height; ++y) {
    for (int x = 0; x < pixels.width; ++x) {
      const size_t i = first + static_cast<size_t>(y) * word(12) + 4 * static_cast<size_t>(x);
      if (i + 3 > content.size()) give_up(file + ": is cut off");
      const auto* p = reinterpret_cast<const uint8_t*>(content.data()) + i;
      pixels.rgb.push_back({p[2], p[1], p[0]});
    }
  }
  return pixels;
}

Pixels read_picture(const std::string& file) {
  std::ifstream stream(file, std::ios::binary);
  const std::string content{std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
  if (content.rfind("\x89PNG", 0) == 0) return read_png(file);
  if (content.rfind("P6", 0) == 0) return read_ppm(file, content);
  return read_xwd(file, content);
}

}  // namespace

int main(int argc, char** argv) {
  const std::vector<std::string> words(argv + 1, argv + argc);
  if (words.size() < 2) give_up("which two?");
  const Pixels a = read_picture(words[0]);
  const Pixels b = read_picture(words[1]);
  if (a.width != b.width || a.height != b.height) {
    std::printf("%dx%d and %dx%d\n", a.width, a.height, b.width, b.height);
    return 1;
  }
  int allowed = 0;
  int levels = 0;
  bool seen = true;
  for (size_t i = 2; i < words.size();) {
    const std::string option = words[i++];
    const size_t count = option == "--but" ? 2 : option == "--colour" ? 4 : 0;
    if (count == 0 || i + count > words.size()) give_up(option + "?");
    std::array<int, 4> values = {};
    for (size_t k = 0; k < count; ++k) values[k] = std::atoi(words[i++].c_str());
    if (count == 2) {
      allowed = values[0];
      levels = values[1];
      continue;
    }
    const auto found = std::count_if(a.rgb.begin(), a.rgb.end(), [&](const std::array<int, 3>& p) {
      return std::abs(p[0] - values[0]) <= 40 && std::abs(p[1] - values[1]) <= 40 && std::abs(p[2] - values[2]) <= 40;
    });
    std::printf("%d pixels of the colour %d %d %d\n", static_cast<int>(found), values[0], values[1], values[2]);
    seen = seen && found >= values[3];
  }
  int differing = 0;
  int most = 0;
  for (size_t i = 0; i < a.rgb.size(); ++i) {
    int worst = 0;
    for (size_t k = 0; k < 3; ++k) worst = std::max(worst, std::abs(a.rgb[i][k] - b.rgb[i][k]));
    differing += worst > levels ? 1 : 0;
    most = std::max(most, worst);
  }
  std::printf("%d of %zu pixels differ by more than %d, at most by %d\n", differing, a.rgb.size(), levels, most);
  return differing <= allowed && seen ? 0 : 1;
}
