#include "platform/run/lettering.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstddef>

#include "platform/run/picture.h"

namespace pptam::platform {
namespace {

struct StyleOfText {
  double units;  // size
  cairo_font_weight_t weight;
};
constexpr StyleOfText kTextStyles[] = {
    {15, CAIRO_FONT_WEIGHT_BOLD}, {15, CAIRO_FONT_WEIGHT_NORMAL}, {13, CAIRO_FONT_WEIGHT_NORMAL}};

void choose(cairo_t* cr, const StyleOfText& style, double unit) {
  cairo_select_font_face(cr, "sans", CAIRO_FONT_SLANT_NORMAL, style.weight);
  cairo_set_font_size(cr, style.units * unit);
}

}  // namespace

// One row of letters below the other; a pixel's gap keeps a letter out of its neighbour's smooth edge.
Lettering::Lettering(float unit) {
  static std::atomic<uint64_t> last_revision = 0;
  image_.revision = ++last_revision;
  const Surface probe = make_surface(1, 1);
  const Context measuring(cairo_create(probe.get()));
  constexpr int kWidth = 1024;
  int x = 1, y = 1, row_height = 0;
  for (size_t style = 0; style < kStyles; ++style) {
    choose(measuring.get(), kTextStyles[style], static_cast<double>(unit));
    for (int i = 0; i < kLetters; ++i) {
      const char text[] = {static_cast<char>(kFirst + i), 0};
      cairo_text_extents_t extents;
      cairo_text_extents(measuring.get(), text, &extents);
      const int left = static_cast<int>(std::floor(extents.x_bearing)) - 1;
      const int top = static_cast<int>(std::floor(extents.y_bearing)) - 1;
      const int width = static_cast<int>(std::ceil(extents.x_bearing + extents.width)) + 1 - left;
      const int height = static_cast<int>(std::ceil(extents.y_bearing + extents.height)) + 1 - top;
      if (x + width + 1 > kWidth) {
        x = 1;
        y += row_height + 1;
        row_height = 0;
      }
      row_height = std::max(row_height, height);
      letters_[style][static_cast<size_t>(i)] = {
          {static_cast<float>(x), static_cast<float>(y), static_cast<float>(width), static_cast<float>(height)},
          static_cast<float>(left),
          static_cast<float>(top),
          static_cast<float>(extents.x_advance)};
      x += width + 1;
    }
  }
  image_.width = kWidth;
  image_.height = y + row_height + 1;
  const Surface surface = make_surface(image_.width, image_.height);
  const Context context(cairo_create(surface.get()));
  cairo_font_options_t* options = cairo_font_options_create();
  cairo_font_options_set_antialias(options, CAIRO_ANTIALIAS_GRAY);
  cairo_set_font_options(context.get(), options);
  cairo_font_options_destroy(options);
  cairo_set_source_rgb(context.get(), 1, 1, 1);
  for (size_t style = 0; style < kStyles; ++style) {
    choose(context.get(), kTextStyles[style], static_cast<double>(unit));
    for (int i = 0; i < kLetters; ++i) {
      const char text[] = {static_cast<char>(kFirst + i), 0};
      const Letter& of_text = letters_[style][static_cast<size_t>(i)];
      cairo_move_to(context.get(), static_cast<double>(of_text.from.x - of_text.x),
                    static_cast<double>(of_text.from.y - of_text.y));
      cairo_show_text(context.get(), text);
    }
  }
  cairo_surface_flush(surface.get());
  const unsigned char* pixels = cairo_image_surface_get_data(surface.get());
  const int stride = cairo_image_surface_get_stride(surface.get());
  image_.cover.reserve(static_cast<size_t>(image_.width) * static_cast<size_t>(image_.height));
  for (int row = 0; row < image_.height; ++row) {
    const auto* line = reinterpret_cast<const uint32_t*>(pixels + static_cast<ptrdiff_t>(row) * stride);
    for (int column = 0; column < image_.width; ++column)
      image_.cover.push_back(static_cast<uint8_t>(line[column] >> 24));
  }
}

const Lettering::Letter& Lettering::letter(TextStyle style, char character) const {
  const int i = character - kFirst;
  return letters_[static_cast<size_t>(style)][static_cast<size_t>(i >= 0 && i < kLetters ? i : '?' - kFirst)];
}

float Lettering::width(TextStyle style, const std::string& text) const {
  float sum = 0;
  for (const char character : text) sum += letter(style, character).advance;
  return sum;
}

// At whole pixels, so that letters are as sharp as they were drawn.
void Lettering::add(TextStyle style, float x, float y, const std::string& text, const Rgba& colour,
                    std::vector<Glyph>* glyphs) const {
  for (const char character : text) {
    const Letter& of_text = letter(style, character);
    if (character != ' ')
      glyphs->push_back(
          {{std::round(x) + of_text.x, std::round(y) + of_text.y, of_text.from.width, of_text.from.height},
           of_text.from,
           colour});
    x += of_text.advance;
  }
}

}  // namespace pptam::platform
