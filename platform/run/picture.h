// What drawing by cairo needs everywhere: surfaces and contexts that are freed, colours, PNG files.
#pragma once

#include <cairo.h>

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "platform/input_error.h"

namespace pptam::platform {

struct Colour {
  double r, g, b;
};

struct SurfaceDeleter {
  void operator()(cairo_surface_t* surface) const { cairo_surface_destroy(surface); }
};
using Surface = std::unique_ptr<cairo_surface_t, SurfaceDeleter>;
struct ContextDeleter {
  void operator()(cairo_t* context) const { cairo_destroy(context); }
};
using Context = std::unique_ptr<cairo_t, ContextDeleter>;

inline Surface make_surface(int width, int height) {
  Surface surface(cairo_image_surface_create(CAIRO_FORMAT_ARGB32, width, height));
  if (cairo_surface_status(surface.get()) != CAIRO_STATUS_SUCCESS) throw InputError("no memory for a picture");
  return surface;
}

inline void set_colour(cairo_t* cr, const Colour& c, double alpha = 1) {
  cairo_set_source_rgba(cr, c.r, c.g, c.b, alpha);
}

// As a PNG file; empty for none.
inline std::string png_of(const Surface& surface) {
  std::string png;
  if (!surface) return png;
  const auto append = [](void* text, const unsigned char* bytes, unsigned int count) {
    static_cast<std::string*>(text)->append(reinterpret_cast<const char*>(bytes), count);
    return CAIRO_STATUS_SUCCESS;
  };
  const cairo_status_t status = cairo_surface_write_to_png_stream(surface.get(), append, &png);
  if (status != CAIRO_STATUS_SUCCESS) throw InputError(std::string("a picture: ") + cairo_status_to_string(status));
  return png;
}

// Rows of red, green, blue and alpha from the top, width times 4 bytes each; alpha is not looked at.
inline Surface surface_of_rgba(const std::vector<uint8_t>& rgba, int width, int height) {
  Surface surface = make_surface(width, height);
  unsigned char* pixels = cairo_image_surface_get_data(surface.get());
  const int stride = cairo_image_surface_get_stride(surface.get());
  const uint8_t* from = rgba.data();
  for (int y = 0; y < height; ++y) {
    auto* row = reinterpret_cast<uint32_t*>(pixels + static_cast<ptrdiff_t>(y) * stride);
    for (int x = 0; x < width; ++x, from += 4) row[x] = 0xff000000u | from[0] << 16 | from[1] << 8 | from[2];
  }
  cairo_surface_mark_dirty(surface.get());
  return surface;
}
inline std::string png_of_rgba(const std::vector<uint8_t>& rgba, int width, int height) {
  return png_of(surface_of_rgba(rgba, width, height));
}

}  // namespace pptam::platform
