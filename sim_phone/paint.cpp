#include "sim_phone/paint.h"

#include <array>
#include <numbers>

namespace pptam::sim {
namespace {

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

}  // namespace

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

void picture(Canvas& canvas, const Place& place, double w, double h, Random& random) {
  const double size = std::min(w, h);
  const double top = random.uniform(0.2, 0.6);
  const double bottom = random.uniform(0.1, 0.5);
  const uint32_t seed = static_cast<uint32_t>(random.bits());
  ValueNoise coarse(seed), fine(seed + 1);
  canvas.paint(place, 0, 0, w, h, 0, [&](double x, double y) {
    const float n = coarse(static_cast<float>(5 * x / size), static_cast<float>(5 * y / size)) +
                    0.5f * fine(static_cast<float>(17 * x / size), static_cast<float>(17 * y / size));
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

void cover(Canvas& canvas, const Place& centre, double w, double h, Random& random) {
  const Place place = centre.inner(-w / 2, -h / 2, 0);
  canvas.rectangle(place, 0.001, 0.001, w + 0.005, h + 0.005, 0.04, 0.6, 0.006);
  picture(canvas, place, w, h, random);
  const double title = 0.12 * h;
  const double ink = random.chance(0.5) ? 0.8 : 0.05;
  text_line(canvas, place.inner(0.06 * w, 0.05 * h, 0), 0.88 * w, title, 0.22 * title, ink, random);
  text_block(canvas, place.inner(0.06 * w, 0.75 * h, 0), 0.5 * w, 0.2 * h, 0.02 * h, ink, random);
}

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
        const int row = i / 2;
        const double y = -0.03 + 0.02 * row;
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

void skin(Canvas& canvas, Random& random) {
  const double width_m = canvas.width_m(), height_m = canvas.height_m();
  const double tone = random.uniform(0.25, 0.5);
  const uint32_t seed = static_cast<uint32_t>(random.bits());
  ValueNoise coarse(seed), fine(seed + 1);
  canvas.paint(Place(0, 0, 0), 0, 0, width_m, height_m, 0, [&](double x, double y) {
    const float n = 0.7f * coarse(static_cast<float>(60 * x), static_cast<float>(60 * y)) +
                    0.3f * fine(static_cast<float>(400 * x), static_cast<float>(400 * y));
    const double edge = std::min({x, width_m - x, y, height_m - y});  // rounder at its sides: darker
    return Ink{tone * (0.85 + 0.3 * static_cast<double>(n)) * (0.6 + 0.4 * std::clamp(edge / 0.006, 0.0, 1.0)), 1};
  });
  for (int i = 0; i < 4; ++i) {  // creases
    const double y = height_m * random.uniform(0.1, 0.9);
    canvas.line(Place(0, y, random.uniform(-0.4, 0.4)), 0.1 * width_m, 0, 0.8 * width_m, 0, 0.0012, 0.5 * tone, 0.7);
  }
}

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
      ValueNoise bend(own), grain(own + 1), fine_grain(own + 2);
      canvas.paint(place, x, b * board, end, (b + 1) * board, 0, [&](double lx, double ly) {
        const float fx = static_cast<float>(lx);
        const float fy = static_cast<float>(ly) + 0.02f * bend(3 * fx, 9 * static_cast<float>(ly));
        const float n = 0.6f * grain(7 * fx, 110 * fy) + 0.4f * fine_grain(25 * fx, 430 * fy);
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

}  // namespace pptam::sim
