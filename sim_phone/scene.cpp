#include "sim_phone/scene.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

#include "sim_phone/phone_camera.h"
#include "sim_phone/random.h"

namespace pptam::sim {
namespace {

constexpr double kDegree = std::numbers::pi / 180;
// A pixel of the phone covers 0.8 mm at 0.3 m and 2.2 mm at 0.8 m: texels of half that look smooth.
constexpr double kTableTexel_m = 0.0005;
constexpr double kWallTexel_m = 0.001;
constexpr double kFloorTexel_m = 0.004;

// Smooth noise in [0, 1] with one cell per unit.
float value_noise(float x, float y, uint32_t seed) {
  const float floor_x = std::floor(x);
  const float floor_y = std::floor(y);
  const int ix = static_cast<int>(floor_x);
  const int iy = static_cast<int>(floor_y);
  const auto at = [&](int cx, int cy) {
    uint32_t h = static_cast<uint32_t>(cx) * 0x8da6b343u ^ static_cast<uint32_t>(cy) * 0xd8163841u ^ seed;
    h = (h ^ (h >> 15)) * 0x2c1b3c6du;
    h = (h ^ (h >> 12)) * 0x297a2d39u;
    return static_cast<float>((h ^ (h >> 15)) >> 8) * 0x1.0p-24f;
  };
  float fx = x - floor_x;
  float fy = y - floor_y;
  fx = fx * fx * (3 - 2 * fx);
  fy = fy * fy * (3 - 2 * fy);
  const float top = at(ix, iy) + fx * (at(ix + 1, iy) - at(ix, iy));
  const float bottom = at(ix, iy + 1) + fx * (at(ix + 1, iy + 1) - at(ix, iy + 1));
  return top + fy * (bottom - top);
}

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

// ---- what is printed ----

// One made-up letter in the cell [0, w] x [0, h].
void letter(Canvas& canvas, const Place& place, double w, double h, double stroke, double ink, Random& random) {
  static constexpr std::array<std::array<double, 4>, 8> kStrokes = {{{0, 0, 0, 1},
                                                                     {1, 0, 1, 1},
                                                                     {0, 0, 1, 0},
                                                                     {0, 0.5, 1, 0.5},
                                                                     {0, 1, 1, 1},
                                                                     {0, 0, 1, 1},
                                                                     {0, 1, 1, 0},
                                                                     {0.5, 0, 0.5, 1}}};
  const int count = random.integer(2, 3);
  for (int i = 0; i < count; ++i) {
    const auto& s = kStrokes[static_cast<size_t>(random.integer(0, 7))];
    canvas.line(place, s[0] * w, s[1] * h, s[2] * w, s[3] * h, stroke, ink);
  }
}

// A line of words from (0, 0) to the right, letters of height h below y = 0.
void text_line(Canvas& canvas, const Place& place, double length, double h, double stroke, double ink, Random& random) {
  const double w = 0.6 * h;
  double x = 0;
  while (x < length) {
    const int letters = random.integer(2, 9);
    for (int i = 0; i < letters && x + w < length; ++i, x += w + 0.35 * h) {
      letter(canvas, place.inner(x, 0, 0), w, h, stroke, ink, random);
    }
    x += 0.6 * h;
  }
}

// Paragraphs in the rectangle [0, w] x [0, h].
void text_block(Canvas& canvas, const Place& place, double w, double h, double letter_h, double ink, Random& random) {
  const double pitch = 2.0 * letter_h;
  double y = 0;
  while (y + letter_h < h) {
    const int lines = random.integer(2, 7);
    if (random.chance(0.35) && y + 3 * letter_h < h) {  // a bold heading
      text_line(canvas, place.inner(0, y, 0), w * random.uniform(0.3, 0.8), 1.8 * letter_h, 0.5 * letter_h, ink * 0.6,
                random);
      y += 3.2 * letter_h;
    }
    for (int i = 0; i < lines && y + letter_h < h; ++i, y += pitch) {
      const double length = i + 1 == lines ? w * random.uniform(0.2, 0.9) : w * random.uniform(0.93, 1.0);
      text_line(canvas, place.inner(0, y, 0), length, letter_h, 0.2 * letter_h, ink, random);
    }
    y += 1.6 * letter_h;
  }
}

// A photograph: a soft background with shapes of many sizes, in [0, w] x [0, h].
void picture(Canvas& canvas, const Place& place, double w, double h, Random& random) {
  const double size = std::min(w, h);
  const double top = random.uniform(0.2, 0.6);
  const double bottom = random.uniform(0.1, 0.5);
  const uint32_t seed = static_cast<uint32_t>(random.bits());
  canvas.paint(place, 0, 0, w, h, 0, [&](double x, double y) {
    const float n = value_noise(static_cast<float>(5 * x / size), static_cast<float>(5 * y / size), seed) +
                    0.5f * value_noise(static_cast<float>(17 * x / size), static_cast<float>(17 * y / size), seed + 1);
    return Ink{(top + (bottom - top) * y / h) * (0.6 + 0.55 * static_cast<double>(n)), 1};
  });
  const int shapes = 8 + static_cast<int>(std::min(60.0, w * h / (0.028 * 0.028)));
  for (int i = 0; i < shapes; ++i) {
    // Large ones first, so that the small ones stay visible.
    const double fraction = static_cast<double>(i) / shapes;
    const double radius = size * (0.05 + 0.2 * (1 - fraction) * (1 - fraction)) * random.uniform(0.6, 1.3);
    const double aspect = random.uniform(0.4, 1.0);
    const double reach = std::min(radius, 0.49 * size);
    const double x = random.uniform(reach, w - reach);
    const double y = random.uniform(reach, h - reach);
    const double angle = random.uniform(0, std::numbers::pi);
    const double shade = random.chance(0.5) ? random.uniform(0.02, 0.15) : random.uniform(0.35, 0.85);
    const double alpha = random.uniform(0.7, 1.0);
    const int kind = random.integer(0, 3);
    const Place p = place.inner(x, y, angle);
    if (kind == 0) {
      canvas.ellipse(p, reach, reach * aspect, shade, alpha);
    } else if (kind == 1) {
      canvas.rectangle(p, -0.7 * reach, -0.7 * reach * aspect, 0.7 * reach, 0.7 * reach * aspect, shade, alpha);
    } else if (kind == 2) {  // triangle
      canvas.paint(p, -0.8 * reach, -0.6 * reach, 0.8 * reach, 0.6 * reach, 0, [&](double lx, double ly) {
        const double inside = 0.6 * reach - ly - 1.5 * std::abs(lx);
        return Ink{shade, alpha * std::clamp(0.5 + inside / canvas.texel_m(), 0.0, 1.0)};
      });
    } else {  // stripes
      const double period = reach * random.uniform(0.35, 0.7);
      canvas.paint(p, -0.7 * reach, -0.7 * reach * aspect, 0.7 * reach, 0.7 * reach * aspect, 0,
                   [&](double lx, double) {
                     const double phase = lx / period - std::floor(lx / period);
                     return Ink{shade, phase < 0.5 ? alpha : 0.0};
                   });
    }
  }
}

void bar_chart(Canvas& canvas, const Place& place, double w, double h, Random& random) {
  canvas.line(place, 0, 0, 0, h, 0.001, 0.1);
  canvas.line(place, 0, h, w, h, 0.001, 0.1);
  const int bars = random.integer(4, 8);
  const double pitch = w / bars;
  for (int i = 0; i < bars; ++i) {
    const double top = h * random.uniform(0.05, 0.8);
    const double shade = random.uniform(0.08, 0.45);
    canvas.rectangle(place, (i + 0.2) * pitch, top, (i + 0.85) * pitch, h, shade);
  }
}

void table_of_cells(Canvas& canvas, const Place& place, double w, double h, Random& random) {
  const int columns = random.integer(3, 5);
  const int rows = std::max(2, static_cast<int>(h / 0.012));
  canvas.rectangle(place, 0, 0, w, h / rows, 0.35);
  for (int i = 0; i <= rows; ++i) canvas.line(place, 0, i * h / rows, w, i * h / rows, 0.0008, 0.15);
  for (int i = 0; i <= columns; ++i) canvas.line(place, i * w / columns, 0, i * w / columns, h, 0.0008, 0.15);
  for (int r = 1; r < rows; ++r) {
    for (int c = 0; c < columns; ++c) {
      const double cell = w / columns;
      const double length = cell * random.uniform(0.2, 0.85);
      if (random.chance(0.15)) {
        canvas.rectangle(place, c * cell, r * h / rows, (c + 1) * cell, (r + 1) * h / rows, 0.2);
      } else {
        text_line(canvas, place.inner(c * cell + 0.003, (r + 0.3) * h / rows, 0), length, 0.004, 0.0009, 0.1, random);
      }
    }
  }
}

// A sheet of paper centred on the place, with text and figures.
void page(Canvas& canvas, const Place& centre, double w, double h, Random& random) {
  const Place place = centre.inner(-w / 2, -h / 2, 0);
  const double paper = random.uniform(0.6, 0.85);
  const double ink = random.uniform(0.02, 0.08);
  canvas.rectangle(place, 0.001, 0.001, w + 0.003, h + 0.003, 0.05, 0.5, 0.004);  // its shadow
  canvas.rectangle(place, 0, 0, w, h, paper);
  const double margin = 0.07 * w;
  double y = margin;
  if (random.chance(0.7)) {
    const double title = random.uniform(0.009, 0.016);
    text_line(canvas, place.inner(margin, y, 0), (w - 2 * margin) * random.uniform(0.5, 1.0), title, 0.25 * title, ink,
              random);
    y += 1.7 * title;
  }
  const int columns = random.integer(1, 2);
  const double gap = 0.008;
  const double column_w = (w - 2 * margin - (columns - 1) * gap) / columns;
  const double letter_h = random.uniform(0.0022, 0.0042);
  for (int c = 0; c < columns; ++c) {
    const double x = margin + c * (column_w + gap);
    double cy = y;
    while (cy < h - margin - 0.02) {
      const double left = h - margin - cy;
      const double part = std::min(left, random.uniform(0.03, 0.08));
      const int kind = random.integer(0, 9);
      const Place p = place.inner(x, cy, 0);
      if (kind < 5) {
        text_block(canvas, p, column_w, part, letter_h, ink, random);
      } else if (kind < 8) {
        picture(canvas, p, column_w, part, random);
      } else if (kind == 8) {
        bar_chart(canvas, p, column_w, part, random);
      } else {
        table_of_cells(canvas, p, column_w, part, random);
      }
      cy += part + 0.008;
    }
  }
}

// A magazine's or book's cover: a picture with a large title and a few words.
void cover(Canvas& canvas, const Place& centre, double w, double h, Random& random) {
  const Place place = centre.inner(-w / 2, -h / 2, 0);
  canvas.rectangle(place, 0.001, 0.001, w + 0.005, h + 0.005, 0.04, 0.6, 0.006);
  picture(canvas, place, w, h, random);
  const double title = 0.12 * h;
  const double ink = random.chance(0.5) ? 0.8 : 0.05;
  text_line(canvas, place.inner(0.06 * w, 0.05 * h, 0), 0.88 * w, title, 0.22 * title, ink, random);
  text_block(canvas, place.inner(0.06 * w, 0.75 * h, 0), 0.5 * w, 0.2 * h, 0.02 * h, ink, random);
}

// Pens, coins, notes, cards, rulers and other small flat things, centred on the place.
void small_thing(Canvas& canvas, const Place& place, Random& random) {
  const double shade = random.chance(0.6) ? random.uniform(0.03, 0.15) : random.uniform(0.4, 0.75);
  const double other = shade < 0.3 ? random.uniform(0.4, 0.75) : random.uniform(0.04, 0.12);
  switch (random.integer(0, 5)) {
    case 0: {  // pen
      const double half = random.uniform(0.055, 0.075);
      canvas.rectangle(place, -half, -0.002, half + 0.004, 0.008, 0.05, 0.5, 0.004);
      canvas.rectangle(place, -half, -0.0045, half, 0.0045, shade);
      canvas.rectangle(place, half - 0.045, -0.0045, half - 0.036, 0.0045, other);
      canvas.rectangle(place, -half, -0.002, -half + 0.03, 0.001, other);
      break;
    }
    case 1: {  // coin
      const double radius = random.uniform(0.009, 0.013);
      canvas.ellipse(place.inner(0.001, 0.001, 0), radius + 0.001, radius + 0.001, 0.05, 0.6);
      canvas.ellipse(place, radius, radius, 0.35);
      canvas.ellipse(place, 0.75 * radius, 0.75 * radius, other > 0.3 ? 0.6 : 0.2);
      letter(canvas, place.inner(-0.3 * radius, -0.4 * radius, 0), 0.6 * radius, 0.8 * radius, 0.0015, shade, random);
      break;
    }
    case 2: {  // sticky note
      const double half = random.uniform(0.025, 0.038);
      canvas.rectangle(place, -half, -half, half + 0.003, half + 0.003, 0.05, 0.5, 0.004);
      canvas.rectangle(place, -half, -half, half, half, random.uniform(0.4, 0.7));
      for (int i = 0; i < 4; ++i) {
        const double slope = random.uniform(-0.06, 0.06);
        const double length = 1.6 * half * random.uniform(0.4, 1.0);
        text_line(canvas, place.inner(-0.8 * half, (-0.7 + 0.4 * i) * half, slope), length, 0.2 * half, 0.0015, 0.08,
                  random);
      }
      break;
    }
    case 3: {  // card with a pattern
      canvas.rectangle(place, -0.03, -0.043, 0.033, 0.046, 0.05, 0.5, 0.004);
      canvas.rectangle(place, -0.031, -0.044, 0.031, 0.044, 0.7);
      const double pip = random.uniform(0.004, 0.0065);
      for (int i = 0; i < 8; ++i) {
        if (random.chance(0.35)) continue;
        const double x = i % 2 == 0 ? -0.013 : 0.013;
        const double y = -0.03 + 0.02 * (i / 2);
        canvas.rectangle(place.inner(x, y, std::numbers::pi / 4), -pip, -pip, pip, pip, shade < 0.3 ? shade : 0.1);
      }
      break;
    }
    case 4: {  // ruler
      const double half = random.uniform(0.08, 0.11);
      canvas.rectangle(place, -half, -0.013, half + 0.003, 0.017, 0.05, 0.5, 0.004);
      canvas.rectangle(place, -half, -0.014, half, 0.014, random.uniform(0.4, 0.7));
      for (int i = 0; i * 0.005 < 2 * half; ++i) {
        const double x = -half + 0.005 * i;
        canvas.line(place, x, -0.014, x, i % 2 == 0 ? -0.004 : -0.009, 0.001, 0.08);
      }
      break;
    }
    default: {  // box of something: a dark rectangle with a light label
      const double half_w = random.uniform(0.02, 0.04);
      const double half_h = random.uniform(0.012, 0.025);
      canvas.rectangle(place, -half_w, -half_h, half_w + 0.005, half_h + 0.005, 0.04, 0.5, 0.006);
      canvas.rectangle(place, -half_w, -half_h, half_w, half_h, shade);
      canvas.rectangle(place, -0.7 * half_w, -0.6 * half_h, 0.5 * half_w, 0.2 * half_h, other);
      text_line(canvas, place.inner(-0.6 * half_w, -0.4 * half_h, 0), half_w, 0.4 * half_h, 0.0015, shade, random);
      break;
    }
  }
}

// Boards with grain, seams and knots over the whole canvas, grain along x.
void wood(Canvas& canvas, Random& random) {
  const double base = random.uniform(0.22, 0.4);
  const double board = random.uniform(0.09, 0.15);
  const uint32_t seed = static_cast<uint32_t>(random.bits());
  const Place place(0, 0, 0);
  for (int b = 0; b * board < canvas.height_m(); ++b) {
    double x = -random.uniform(0, 0.5);
    while (x < canvas.width_m()) {
      const double end = x + random.uniform(0.4, 0.9);
      const double shade = base * random.uniform(0.8, 1.2);
      const uint32_t own = seed + static_cast<uint32_t>(random.bits());
      canvas.paint(place, x, b * board, end, (b + 1) * board, 0, [&](double lx, double ly) {
        const float fx = static_cast<float>(lx);
        const float fy = static_cast<float>(ly) + 0.02f * value_noise(3 * fx, 9 * static_cast<float>(ly), own);
        const float n = 0.6f * value_noise(7 * fx, 110 * fy, own + 1) + 0.4f * value_noise(25 * fx, 430 * fy, own + 2);
        return Ink{shade * (0.62 + 0.76 * static_cast<double>(n)), 1};
      });
      canvas.line(place, x, b * board, x, (b + 1) * board, 0.0015, 0.3 * base);
      x = end;
    }
    canvas.line(place, 0, b * board, canvas.width_m(), b * board, 0.0015, 0.3 * base);
  }
  const int knots = static_cast<int>(canvas.width_m() * canvas.height_m() * 60);
  for (int i = 0; i < knots; ++i) {
    const double x = random.uniform(0, canvas.width_m());
    const double y = random.uniform(0, canvas.height_m());
    const double radius = random.uniform(0.004, 0.012);
    const Place p = place.inner(x, y, random.uniform(-0.3, 0.3));
    canvas.ellipse(p, 2.0 * radius, 1.3 * radius, 0.6 * base, 0.6);
    canvas.ellipse(p, 1.2 * radius, 0.9 * radius, 0.3 * base, 0.8);
    canvas.ellipse(p, 0.5 * radius, 0.4 * radius, 0.7 * base, 0.7);
  }
}

// Light that falls a little unevenly on a canvas.
void uneven_light(Canvas& canvas, Random& random) {
  const double angle = random.uniform(0, 2 * std::numbers::pi);
  const double strength = random.uniform(0.1, 0.3);
  const double c = std::cos(angle);
  const double s = std::sin(angle);
  const double w = canvas.width_m();
  const double h = canvas.height_m();
  canvas.paint(Place(0, 0, 0), 0, 0, w, h, 0, [&](double x, double y) {
    return Ink{0, strength * std::clamp(0.5 + c * (x / w - 0.5) + s * (y / h - 0.5), 0.0, 1.0)};
  });
}

// ---- scenes ----

Surface surface_of(Canvas& canvas, const Vector3d& origin, const Vector3d& u_axis, const Vector3d& v_axis,
                   double light) {
  Surface surface;
  surface.origin = origin;
  surface.u_axis = u_axis;
  surface.v_axis = v_axis;
  surface.width_m = canvas.width_m();
  surface.height_m = canvas.height_m();
  surface.texel_m = canvas.texel_m();
  surface.light = static_cast<float>(light);
  surface.texture = canvas.finish();
  return surface;
}

Surface make_floor(double size_m, double z, double light, Random& random) {
  Canvas canvas(size_m, size_m, kFloorTexel_m);
  const uint32_t seed = static_cast<uint32_t>(random.bits());
  const double tile = random.uniform(0.2, 0.35);
  const Place place(0, 0, 0);
  for (int r = 0; r * tile < size_m; ++r) {
    for (int c = 0; c * tile < size_m; ++c) {
      const double shade = random.uniform(0.15, 0.45);
      canvas.paint(place, c * tile + 0.004, r * tile + 0.004, (c + 1) * tile - 0.004, (r + 1) * tile - 0.004, 0,
                   [&](double x, double y) {
                     const float n = value_noise(static_cast<float>(20 * x), static_cast<float>(20 * y), seed) +
                                     value_noise(static_cast<float>(70 * x), static_cast<float>(70 * y), seed + 1);
                     return Ink{shade * (0.6 + 0.4 * static_cast<double>(n)), 1};
                   });
    }
  }
  return surface_of(canvas, {-size_m / 2, size_m / 2, z}, Vector3d::UnitX(), -Vector3d::UnitY(), light);
}

constexpr double kTableSize_m = 2.0;
// The "plane" scene: large enough for a view from 1.5 m, with texels that still suit one from 0.3 m.
constexpr double kPlaneSize_m = 3.0;
constexpr double kPlaneTexel_m = 0.00075;

struct Footprint {
  double x, y, half_w, half_h, angle, height;  // scene metres, centre
  double radius() const { return std::hypot(half_w, half_h); }
};

// The table top with everything that lies flat on it, and the boxes' contact shadows.
Surface make_table(const std::vector<Footprint>& boxes, double light, Random& random, double size_m = kTableSize_m,
                   double texel_m = kTableTexel_m) {
  Canvas canvas(size_m, size_m, texel_m);
  wood(canvas, random);
  const double grain = random.uniform(-0.5, 0.5);

  // Sheets on a jittered lattice, in random order, so that they overlap as they do on a desk.
  struct Spot {
    double x, y;
    uint64_t order;
  };
  const auto lattice = [&](double pitch, double probability) {
    std::vector<Spot> spots;
    for (double y = 0.5 * pitch; y < size_m; y += pitch) {
      for (double x = 0.5 * pitch; x < size_m; x += pitch) {
        const double dx = pitch * random.uniform(-0.4, 0.4);
        const double dy = pitch * random.uniform(-0.4, 0.4);
        const uint64_t order = random.bits();
        if (random.chance(probability)) spots.push_back({x + dx, y + dy, order});
      }
    }
    std::sort(spots.begin(), spots.end(), [](const Spot& a, const Spot& b) { return a.order < b.order; });
    return spots;
  };
  for (const Spot& spot : lattice(0.2, 0.92)) {
    const double turn = 0.5 * std::numbers::pi * random.integer(0, 3);
    const double skew = random.uniform(-25, 25) * kDegree;
    const Place place(spot.x, spot.y, grain + turn + skew);
    const int kind = random.integer(0, 9);
    if (kind < 5) {
      page(canvas, place, 0.21, 0.297, random);
    } else if (kind < 7) {
      page(canvas, place, 0.148, 0.21, random);
    } else {
      const double w = random.uniform(0.12, 0.2);
      cover(canvas, place, w, 1.35 * w, random);
    }
  }
  for (const Spot& spot : lattice(0.085, 0.42)) {
    small_thing(canvas, Place(spot.x, spot.y, random.uniform(0, 2 * std::numbers::pi)), random);
  }
  for (const Footprint& b : boxes) {
    const double spread = 0.01 + 0.15 * b.height;
    canvas.rectangle(Place(0.5 * size_m + b.x, 0.5 * size_m - b.y, -b.angle), -b.half_w, -b.half_h,
                     b.half_w + 0.4 * spread, b.half_h + 0.3 * spread, 0.02, 0.5, 2 * spread);
  }
  uneven_light(canvas, random);
  const double half = 0.5 * size_m;
  return surface_of(canvas, {-half, half, 0}, Vector3d::UnitX(), -Vector3d::UnitY(), light);
}

// The printed side of a cardboard box.
Surface box_side(double w, double h, const Vector3d& origin, const Vector3d& u_axis, const Vector3d& v_axis,
                 double light, Random& random) {
  Canvas canvas(w, h, kTableTexel_m);
  const double board = random.uniform(0.25, 0.6);
  const Place place(0, 0, 0);
  canvas.rectangle(place, 0, 0, w, h, board);
  const double ink = board > 0.4 ? 0.08 : 0.75;
  const double size = std::min(w, h);
  if (random.chance(0.75)) {
    const double x = w * random.uniform(0.03, 0.2);
    const double y = h * random.uniform(0.03, 0.2);
    const double picture_w = w * random.uniform(0.6, 0.75);
    const double picture_h = h * random.uniform(0.5, 0.75);
    picture(canvas, place.inner(x, y, 0), picture_w, picture_h, random);
  } else {
    text_block(canvas, place.inner(0.08 * w, 0.3 * h, 0), 0.8 * w, 0.6 * h, std::max(0.004, 0.05 * size), ink, random);
  }
  const double title = std::max(0.008, 0.16 * size);
  text_line(canvas, place.inner(0.08 * w, random.chance(0.5) ? 0.05 * h : 0.95 * h - title, 0), 0.85 * w, title,
            0.22 * title, ink, random);
  canvas.rectangle(place, w * 0.85, 0, w * 0.93, h, ink, 0.6);  // a printed band
  return surface_of(canvas, origin, u_axis, v_axis, light);
}

void add_box(const Footprint& b, double light, Random& random, std::vector<Surface>* surfaces) {
  const Vector3d x(std::cos(b.angle), std::sin(b.angle), 0);
  const Vector3d y(-std::sin(b.angle), std::cos(b.angle), 0);
  const Vector3d z = Vector3d::UnitZ();
  const Vector3d middle(b.x, b.y, 0);
  const Vector3d sun = Vector3d(0.4, -0.5, 0.8).normalized();
  // The side with the given middle; texture columns run along u, rows along v, v x u points outwards.
  const auto side = [&](double width, double height, const Vector3d& u, const Vector3d& v, const Vector3d& centre) {
    const double shade = light * (0.6 + 0.4 * std::max(0.0, v.cross(u).dot(sun)));
    surfaces->push_back(box_side(width, height, centre - 0.5 * width * u - 0.5 * height * v, u, v, shade, random));
  };
  const double w = 2 * b.half_w;
  const double h = 2 * b.half_h;
  const Vector3d half_way = middle + 0.5 * b.height * z;
  side(w, h, x, -y, middle + b.height * z);
  side(w, b.height, x, -z, half_way - b.half_h * y);
  side(w, b.height, -x, -z, half_way + b.half_h * y);
  side(h, b.height, y, -z, half_way + b.half_w * x);
  side(h, b.height, -y, -z, half_way - b.half_w * x);
}

// Six to ten boxes that leave the middle free, and keep the high ones out of the way of the first view.
std::vector<Footprint> place_boxes(double azimuth, Random& random) {
  // Sides of whole texels meet without gaps.
  const auto whole_texels = [](double length_m) { return kTableTexel_m * std::round(length_m / kTableTexel_m); };
  std::vector<Footprint> boxes;
  const int wanted = random.integer(6, 10);
  for (int attempt = 0; attempt < 400 && static_cast<int>(boxes.size()) < wanted; ++attempt) {
    Footprint b{};
    b.half_w = whole_texels(random.uniform(0.03, 0.09));
    b.half_h = whole_texels(random.uniform(0.025, 0.07));
    b.angle = random.uniform(0, std::numbers::pi);
    b.height = whole_texels(random.uniform(0.03, 0.2));
    const double distance = random.uniform(0.1, 0.38) + b.radius();
    const double direction = random.uniform(0, 2 * std::numbers::pi);
    b.x = distance * std::cos(direction);
    b.y = distance * std::sin(direction);
    const bool before_the_person = std::cos(direction - azimuth) > 0.75;
    if (before_the_person && b.height > 0.07) continue;
    const bool free = std::all_of(boxes.begin(), boxes.end(), [&](const Footprint& o) {
      return std::hypot(o.x - b.x, o.y - b.y) > o.radius() + b.radius() + 0.02;
    });
    if (free) boxes.push_back(b);
  }
  return boxes;
}

// Boxes of all heights side by side: from nowhere does one plane fill the view.
std::vector<Footprint> place_clutter(Random& random) {
  const auto whole_texels = [](double length_m) { return kTableTexel_m * std::round(length_m / kTableTexel_m); };
  std::vector<Footprint> boxes;
  for (int attempt = 0; attempt < 3000 && boxes.size() < 40; ++attempt) {
    Footprint b{};
    b.half_w = whole_texels(random.uniform(0.035, 0.09));
    b.half_h = whole_texels(random.uniform(0.03, 0.07));
    b.angle = random.uniform(0, std::numbers::pi);
    b.height = whole_texels(random.uniform(0.04, 0.22));
    const double distance = 0.55 * std::sqrt(random.uniform(0, 1));
    const double direction = random.uniform(0, 2 * std::numbers::pi);
    b.x = distance * std::cos(direction);
    b.y = distance * std::sin(direction);
    // Circles of nine tenths of the radius: corners may nearly touch, sides hardly ever cross.
    const bool free = std::all_of(boxes.begin(), boxes.end(), [&](const Footprint& o) {
      return std::hypot(o.x - b.x, o.y - b.y) > 0.9 * (o.radius() + b.radius());
    });
    if (free) boxes.push_back(b);
  }
  return boxes;
}

// A table top without anything round it.
Scene make_plane(uint64_t seed) {
  Random random(seed, 4);
  Scene scene;
  scene.stage.azimuth_rad = random.uniform(0, 2 * std::numbers::pi);
  const double light = random.uniform(0.6, 1.1);
  scene.surfaces.push_back(make_table({}, light, random, kPlaneSize_m, kPlaneTexel_m));
  return scene;
}

Scene make_clutter(uint64_t seed) {
  Random random(seed, 5);
  Scene scene;
  scene.stage.azimuth_rad = random.uniform(0, 2 * std::numbers::pi);
  scene.stage.min_height_m = 0.4;
  scene.stage.cluttered = true;
  const double light = random.uniform(0.6, 1.1);
  const std::vector<Footprint> boxes = place_clutter(random);
  scene.surfaces.push_back(make_table(boxes, light, random));
  for (const Footprint& b : boxes) add_box(b, light, random, &scene.surfaces);
  scene.surfaces.push_back(make_floor(8, -0.74, 0.7 * light, random));
  return scene;
}

Scene make_desk(bool with_boxes, uint64_t seed) {
  Random random(seed, 1);
  Scene scene;
  scene.stage.azimuth_rad = random.uniform(0, 2 * std::numbers::pi);
  const double light = random.uniform(0.6, 1.1);
  std::vector<Footprint> boxes;
  if (with_boxes) {
    boxes = place_boxes(scene.stage.azimuth_rad, random);
    scene.stage.min_height_m = 0.36;  // stays above the highest box
  }
  scene.surfaces.push_back(make_table(boxes, light, random));
  for (const Footprint& b : boxes) add_box(b, light, random, &scene.surfaces);
  scene.surfaces.push_back(make_floor(8, -0.74, 0.7 * light, random));
  return scene;
}

// A papered wall with posters, w x h metres, texture rows downwards.
Canvas make_wall(double w, double h, Random& random) {
  Canvas canvas(w, h, kWallTexel_m);
  const Place place(0, 0, 0);
  const double base = random.uniform(0.3, 0.55);
  const uint32_t seed = static_cast<uint32_t>(random.bits());
  canvas.paint(place, 0, 0, w, h, 0, [&](double x, double y) {
    const float n = value_noise(static_cast<float>(9 * x), static_cast<float>(9 * y), seed) +
                    value_noise(static_cast<float>(55 * x), static_cast<float>(55 * y), seed + 1) +
                    value_noise(static_cast<float>(190 * x), static_cast<float>(190 * y), seed + 2);
    return Ink{base * (0.85 + 0.1 * static_cast<double>(n)), 1};
  });
  // The paper's ornament: a lattice of small marks, no two quite alike.
  const double pitch = random.uniform(0.07, 0.1);
  const double mark = base * random.uniform(0.25, 0.45);
  for (double y = 0.5 * pitch; y < h; y += pitch) {
    for (double x = 0.5 * pitch; x < w; x += pitch) {
      const double dx = pitch * random.uniform(-0.3, 0.3);
      const double dy = pitch * random.uniform(-0.3, 0.3);
      const double radius = pitch * random.uniform(0.12, 0.34);
      const Place p = place.inner(x + dx, y + dy, random.uniform(0, std::numbers::pi));
      if (random.chance(0.5)) {
        canvas.ellipse(p, radius, 0.6 * radius, mark);
      } else {
        canvas.rectangle(p, -radius, -0.6 * radius, radius, 0.6 * radius, mark);
      }
    }
  }
  // Posters and sheets where the camera looks, columns from 0.15 m, heights 0.8 to 1.9 m above the floor.
  for (double x = 0.2; x < w - 0.2; x += random.uniform(0.27, 0.36)) {
    double y = h - random.uniform(1.7, 1.9);
    while (y < h - 0.85) {
      const double width = random.uniform(0.2, 0.32);
      const double height = width * random.uniform(0.9, 1.45);
      const double tilt = random.uniform(-4, 4) * kDegree;
      const Place centre(x + random.uniform(-0.03, 0.03), y + 0.5 * height, tilt);
      const int kind = random.integer(0, 7);
      if (kind < 4) {
        cover(canvas, centre, width, height, random);
      } else if (kind < 7) {
        page(canvas, centre, width, height, random);
      }  // else: bare paper
      y += height + random.uniform(0.01, 0.05);
    }
  }
  // Less light reaches the corner and the skirting.
  for (const double edge : {0.0, w}) canvas.rectangle(place, edge - 0.12, 0, edge + 0.12, h, 0, 0.3, 0.2);
  canvas.rectangle(place, 0, h - 0.09, w, h, 0.7);
  uneven_light(canvas, random);
  return canvas;
}

// The walls y = 0 (seen from y > 0) and x = 0 (from x > 0), and the floor z = 0.
Scene make_walls(uint64_t seed) {
  Random random(seed, 2);
  Scene scene;
  scene.stage.kind = Stage::Kind::kCorner;
  scene.stage.mirrored = random.chance(0.5);
  scene.stage.cluttered = true;
  const double light = random.uniform(0.6, 1.1);
  constexpr double kLength_m = 3;
  constexpr double kHeight_m = 2.4;
  Canvas first = make_wall(kLength_m, kHeight_m, random);
  Canvas second = make_wall(kLength_m, kHeight_m, random);
  const Vector3d down = -Vector3d::UnitZ();
  scene.surfaces.push_back(surface_of(first, {kLength_m, 0, kHeight_m}, -Vector3d::UnitX(), down, light));
  scene.surfaces.push_back(
      surface_of(second, {0, 0, kHeight_m}, Vector3d::UnitY(), down, light * random.uniform(0.55, 0.8)));
  scene.surfaces.push_back(make_floor(8, 0, light, random));
  return scene;
}

Scene make_checkerboard(uint64_t seed) {
  Random random(seed, 3);
  Scene scene;
  scene.stage.azimuth_rad = random.uniform(0, 2 * std::numbers::pi);
  const double light = random.uniform(0.9, 1.1);
  const double w = kCheckerColumns * kCheckerSquare_m;
  const double h = kCheckerRows * kCheckerSquare_m;
  Canvas canvas(w, h, kTableTexel_m);
  canvas.rectangle(Place(0, 0, 0), -1, -1, 2, 2, 0.8);
  for (int j = 0; j < kCheckerRows; ++j) {
    for (int i = j % 2; i < kCheckerColumns; i += 2) {
      canvas.rectangle(Place(0, 0, 0), i * kCheckerSquare_m, j * kCheckerSquare_m, (i + 1) * kCheckerSquare_m,
                       (j + 1) * kCheckerSquare_m, 0.05);
    }
  }
  scene.surfaces.push_back(surface_of(canvas, {-w / 2, h / 2, 0}, Vector3d::UnitX(), -Vector3d::UnitY(), light));
  scene.surfaces.push_back(make_floor(8, -0.74, 0.7 * light, random));
  return scene;
}

}  // namespace

std::vector<std::string> scene_names() {
  return {"desk", "boxes", "walls", "checkerboard", "plane", "clutter"};
}

double first_hit(const Scene& scene, const Vector3d& origin, const Vector3d& direction) {
  double nearest = std::numeric_limits<double>::infinity();
  for (const Surface& s : scene.surfaces) {
    const Vector3d normal = s.v_axis.cross(s.u_axis);
    const double approach = normal.dot(direction);
    if (approach >= 0) continue;
    const double depth = normal.dot(s.origin - origin) / approach;
    if (!(depth > 0) || depth >= nearest) continue;
    const Vector3d on_surface = origin + depth * direction - s.origin;
    const double u = on_surface.dot(s.u_axis), v = on_surface.dot(s.v_axis);
    if (u >= 0 && v >= 0 && u <= s.width_m && v <= s.height_m) nearest = depth;
  }
  return nearest;
}

Scene make_scene(const std::string& name, uint64_t seed) {
  if (name == "boxes") return make_desk(true, seed);
  if (name == "walls") return make_walls(seed);
  if (name == "checkerboard") return make_checkerboard(seed);
  if (name == "plane") return make_plane(seed);
  if (name == "clutter") return make_clutter(seed);
  return make_desk(false, seed);
}

}  // namespace pptam::sim
