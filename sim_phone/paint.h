// What the emulated world's surfaces are painted with: a canvas in metres, and pages, pictures, covers and small things
// on it. Everything is drawn from a seeded Random, so that a scene is a function of its seed.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "sim_phone/random.h"
#include "sim_phone/surface.h"

namespace pptam::sim {

// Smooth noise in [0, 1] with one cell per unit. Remembers the cell of the last call: next to each other on a canvas
// most texels share one.
class ValueNoise {
 public:
  explicit ValueNoise(uint32_t seed) : seed_(seed) {}

  float operator()(float x, float y) {
    const int ix = floor_of(x), iy = floor_of(y);
    if (ix != ix_ || iy != iy_) enter(ix, iy);
    float fx = x - static_cast<float>(ix);
    float fy = y - static_cast<float>(iy);
    fx = fx * fx * (3 - 2 * fx);
    fy = fy * fy * (3 - 2 * fy);
    const float top = corner_[0] + fx * (corner_[1] - corner_[0]);
    const float bottom = corner_[2] + fx * (corner_[3] - corner_[2]);
    return top + fy * (bottom - top);
  }

 private:
  // For |x| < 2^24; a library call on processors without a rounding instruction.
  static int floor_of(float x) {
    const int whole = static_cast<int>(x);
    return whole - (x < static_cast<float>(whole) ? 1 : 0);
  }
  void enter(int ix, int iy) {
    const auto at = [this](int cx, int cy) {
      uint32_t h = static_cast<uint32_t>(cx) * 0x8da6b343u ^ static_cast<uint32_t>(cy) * 0xd8163841u ^ seed_;
      h = (h ^ (h >> 15)) * 0x2c1b3c6du;
      h = (h ^ (h >> 12)) * 0x297a2d39u;
      return static_cast<float>((h ^ (h >> 15)) >> 8) * 0x1.0p-24f;
    };
    ix_ = ix;
    iy_ = iy;
    corner_[0] = at(ix, iy);
    corner_[1] = at(ix + 1, iy);
    corner_[2] = at(ix, iy + 1);
    corner_[3] = at(ix + 1, iy + 1);
  }

  uint32_t seed_;
  int ix_ = INT32_MIN, iy_ = INT32_MIN;
  float corner_[4] = {};  // of the cell, row by row
};

// A local coordinate system on a canvas, metres: p = origin + rotation(angle) (x, y).
struct Place {
  double x = 0, y = 0, cos = 1, sin = 0;

  Place(double origin_x, double origin_y, double angle)
      : x(origin_x), y(origin_y), cos(std::cos(angle)), sin(std::sin(angle)) {}
  Place inner(double local_x, double local_y, double angle) const {
    Place p(x + cos * local_x - sin * local_y, y + sin * local_x + cos * local_y, 0);
    p.cos = cos * std::cos(angle) - sin * std::sin(angle);
    p.sin = sin * std::cos(angle) + cos * std::sin(angle);
    return p;
  }
};

struct Ink {
  double reflectance;
  double alpha;  // coverage, 0 to 1
};

// A reflectance image that is painted on, in metres.
class Canvas {
 public:
  Canvas(double width_m, double height_m, double texel_m)
      : texel_(texel_m),
        width_(std::max(2, static_cast<int>(std::lround(width_m / texel_m)))),
        height_(std::max(2, static_cast<int>(std::lround(height_m / texel_m)))),
        texels_(static_cast<size_t>(width_) * static_cast<size_t>(height_)) {}

  double width_m() const { return width_ * texel_; }
  double height_m() const { return height_ * texel_; }
  double texel_m() const { return texel_; }

  // Blends ink(x, y) over the local rectangle [x0, x1] x [y0, y1], with edges blurred by one texel or by softness.
  template <class Function>
  void paint(const Place& place, double x0, double y0, double x1, double y1, double softness, const Function& ink) {
    const double blur = std::max(softness, texel_);
    double low_x = 1e9, low_y = 1e9, high_x = -1e9, high_y = -1e9;
    for (const double cx : {x0 - blur, x1 + blur}) {
      for (const double cy : {y0 - blur, y1 + blur}) {
        const double px = place.x + place.cos * cx - place.sin * cy;
        const double py = place.y + place.sin * cx + place.cos * cy;
        low_x = std::min(low_x, px);
        high_x = std::max(high_x, px);
        low_y = std::min(low_y, py);
        high_y = std::max(high_y, py);
      }
    }
    const int first_x = std::max(0, static_cast<int>(std::floor(low_x / texel_ - 0.5)));
    const int last_x = std::min(width_ - 1, static_cast<int>(std::ceil(high_x / texel_ - 0.5)));
    const int first_y = std::max(0, static_cast<int>(std::floor(low_y / texel_ - 0.5)));
    const int last_y = std::min(height_ - 1, static_cast<int>(std::ceil(high_y / texel_ - 0.5)));
    const auto edge = [&](double inside) { return std::clamp(0.5 + inside / blur, 0.0, 1.0); };
    for (int iy = first_y; iy <= last_y; ++iy) {
      for (int ix = first_x; ix <= last_x; ++ix) {
        const double dx = (ix + 0.5) * texel_ - place.x;
        const double dy = (iy + 0.5) * texel_ - place.y;
        const double x = place.cos * dx + place.sin * dy;
        const double y = -place.sin * dx + place.cos * dy;
        const double cover = edge(std::min(x - x0, x1 - x)) * edge(std::min(y - y0, y1 - y));
        if (cover <= 0) continue;
        const Ink i = ink(x, y);
        uint16_t& texel = texels_[static_cast<size_t>(iy) * static_cast<size_t>(width_) + static_cast<size_t>(ix)];
        const double old = texel;
        const double alpha = cover * i.alpha;
        texel = static_cast<uint16_t>(std::clamp(old + alpha * (i.reflectance * 65535.0 - old) + 0.5, 0.0, 65535.0));
      }
    }
  }

  void rectangle(const Place& place, double x0, double y0, double x1, double y1, double reflectance, double alpha = 1,
                 double softness = 0) {
    paint(place, x0, y0, x1, y1, softness, [&](double, double) { return Ink{reflectance, alpha}; });
  }

  void ellipse(const Place& place, double radius_x, double radius_y, double reflectance, double alpha = 1) {
    const double radius = std::min(radius_x, radius_y);
    paint(place, -radius_x, -radius_y, radius_x, radius_y, 0, [&](double x, double y) {
      const double r = std::sqrt(x * x / (radius_x * radius_x) + y * y / (radius_y * radius_y));
      return Ink{reflectance, alpha * std::clamp(0.5 + (1 - r) * radius / texel_, 0.0, 1.0)};
    });
  }

  void line(const Place& place, double x0, double y0, double x1, double y1, double thickness, double reflectance,
            double alpha = 1) {
    const double length = std::hypot(x1 - x0, y1 - y0);
    rectangle(place.inner(x0, y0, std::atan2(y1 - y0, x1 - x0)), -thickness / 2, -thickness / 2, length + thickness / 2,
              thickness / 2, reflectance, alpha);
  }

  // Moves the texels out into a mip map.
  Texture finish() {
    Texture texture;
    texture.levels.push_back({width_, height_, std::move(texels_)});
    while (texture.levels.back().width > 4 && texture.levels.back().height > 4) {
      const Texture::Level& from = texture.levels.back();
      Texture::Level to;
      to.width = (from.width + 1) / 2;
      to.height = (from.height + 1) / 2;
      to.texels.resize(static_cast<size_t>(to.width) * static_cast<size_t>(to.height));
      for (int y = 0; y < to.height; ++y) {
        const uint16_t* top = from.texels.data() + static_cast<size_t>(2 * y) * static_cast<size_t>(from.width);
        const uint16_t* bottom = 2 * y + 1 < from.height ? top + from.width : top;
        for (int x = 0; x < to.width; ++x) {
          const int right = std::min(2 * x + 1, from.width - 1);
          to.texels[static_cast<size_t>(y) * static_cast<size_t>(to.width) + static_cast<size_t>(x)] =
              static_cast<uint16_t>((top[2 * x] + top[right] + bottom[2 * x] + bottom[right] + 2) / 4);
        }
      }
      texture.levels.push_back(std::move(to));
    }
    return texture;
  }

 private:
  double texel_;
  int width_;
  int height_;
  std::vector<uint16_t> texels_;
};

// A line of words from (0, 0) to the right, letters of height h below y = 0.
void text_line(Canvas& canvas, const Place& place, double length, double h, double stroke, double ink, Random& random);
// Paragraphs in the rectangle [0, w] x [0, h].
void text_block(Canvas& canvas, const Place& place, double w, double h, double letter_h, double ink, Random& random);
// A photograph: a soft background with shapes of many sizes, in [0, w] x [0, h].
void picture(Canvas& canvas, const Place& place, double w, double h, Random& random);
// A sheet of paper centred on the place, with text and figures.
void page(Canvas& canvas, const Place& centre, double w, double h, Random& random);
// A magazine's or book's cover: a picture with a large title and a few words.
void cover(Canvas& canvas, const Place& centre, double w, double h, Random& random);
// Pens, coins, notes, cards, rulers and other small flat things, centred on the place.
void small_thing(Canvas& canvas, const Place& place, Random& random);
// Skin with creases over the whole canvas, darker at the sides.
void skin(Canvas& canvas, Random& random);
// Boards with grain, seams and knots over the whole canvas, grain along x.
void wood(Canvas& canvas, Random& random);
// Light that falls a little unevenly on a canvas.
void uneven_light(Canvas& canvas, Random& random);

// The painted canvas as a surface: `origin` is where its corner (0, 0) lies, metres; light as Surface::light. The
// canvas is used up.
Surface surface_of(Canvas& canvas, const Vector3d& origin, const Vector3d& u_axis, const Vector3d& v_axis,
                   double light);

}  // namespace pptam::sim
