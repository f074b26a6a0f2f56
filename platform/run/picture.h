// What drawing by cairo needs everywhere: surfaces and contexts that are freed, colours, PNG files.
#pragma once

#include <cairo.h>

#include <memory>
#include <string>

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

}  // namespace pptam::platform
