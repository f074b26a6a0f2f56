#include "sim_phone/scene.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "platform/text.h"
#include "sim_phone/paint.h"
#include "sim_phone/random.h"

namespace pptam::sim {
namespace {

constexpr double kRadPerDegree = std::numbers::pi / 180;
// A pixel of the phone covers 0.8 mm at 0.3 m and 2.2 mm at 0.8 m: texels of half that look smooth.
constexpr double kTableTexel_m = 0.0005;
constexpr double kWallTexel_m = 0.001;
constexpr double kFloorTexel_m = 0.004;

Surface make_floor(double size_m, double z, double light, Random& random) {
  Canvas canvas(size_m, size_m, kFloorTexel_m);
  const uint32_t seed = static_cast<uint32_t>(random.bits());
  ValueNoise coarse(seed), fine(seed + 1);
  const double tile = random.uniform(0.2, 0.35);
  const Place place(0, 0, 0);
  for (int r = 0; r * tile < size_m; ++r) {
    for (int c = 0; c * tile < size_m; ++c) {
      const double shade = random.uniform(0.15, 0.45);
      canvas.paint(place, c * tile + 0.004, r * tile + 0.004, (c + 1) * tile - 0.004, (r + 1) * tile - 0.004, 0,
                   [&](double x, double y) {
                     const float n = coarse(static_cast<float>(20 * x), static_cast<float>(20 * y)) +
                                     fine(static_cast<float>(70 * x), static_cast<float>(70 * y));
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

// Painted evenly, but for a little unevenness.
void plain_paint(Canvas& canvas, Random& random) {
  const double base = random.uniform(0.3, 0.5);
  ValueNoise uneven(static_cast<uint32_t>(random.bits()));
  canvas.paint(Place(0, 0, 0), 0, 0, canvas.width_m(), canvas.height_m(), 0, [&](double x, double y) {
    const float n = uneven(static_cast<float>(6 * x), static_cast<float>(6 * y));
    return Ink{base * (0.97 + 0.06 * static_cast<double>(n)), 1};
  });
}

// Five shapes in the middle of the square of size pitch at (x, y); seed says which.
void motif(Canvas& canvas, double x, double y, double pitch, double ink, double alpha, uint64_t seed) {
  Random same(seed, 0);
  for (int i = 0; i < 5; ++i) {
    const double size = pitch * same.uniform(0.06, 0.16);
    const double at_x = pitch * same.uniform(0.25, 0.75);
    const double at_y = pitch * same.uniform(0.25, 0.75);
    const Place place(x + at_x, y + at_y, same.uniform(0, std::numbers::pi));
    const double aspect = same.uniform(0.4, 1);
    if (same.chance(0.5)) {
      canvas.ellipse(place, size, aspect * size, ink, alpha);
    } else {
      canvas.rectangle(place, -size, -aspect * size, size, aspect * size, ink, alpha);
    }
  }
}

// A motif over and over, alike to the texel: a tablecloth, a wallpaper.
void printed_pattern(Canvas& canvas, double contrast, Random& random) {
  const double pitch = canvas.texel_m() * std::round(random.uniform(0.04, 0.07) / canvas.texel_m());
  const double ink = random.chance(0.5) ? random.uniform(0.03, 0.1) : random.uniform(0.6, 0.8);
  const uint64_t which = random.bits();
  for (double y = 0; y < canvas.height_m(); y += pitch) {
    for (double x = 0; x < canvas.width_m(); x += pitch) motif(canvas, x, y, pitch, ink, contrast, which);
  }
}

// The table top with everything that lies flat on it, and the boxes' contact shadows.
Surface make_table(const std::vector<Footprint>& boxes, double light, Random& random, const Harshness& harsh,
                   double size_m = kTableSize_m, double texel_m = kTableTexel_m) {
  Canvas canvas(size_m, size_m, texel_m);
  const double share = 1 - harsh.bare;  // of the things that are there
  if (harsh.bare > 0) {
    plain_paint(canvas, random);
  } else {
    wood(canvas, random);
  }
  if (harsh.repeats > 0) printed_pattern(canvas, harsh.repeats, random);
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
  for (const Spot& spot : lattice(0.2, 0.92 * share)) {
    const double turn = 0.5 * std::numbers::pi * random.integer(0, 3);
    const double skew = random.uniform(-25, 25) * kRadPerDegree;
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
  for (const Spot& spot : lattice(0.085, 0.42 * share)) {
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
Scene make_plane(uint64_t seed, const Harshness& harsh) {
  Random random(seed, 4);
  Scene scene;
  scene.stage.azimuth_rad = random.uniform(0, 2 * std::numbers::pi);
  const double light = random.uniform(0.6, 1.1);
  scene.surfaces.push_back(make_table({}, light, random, harsh, kPlaneSize_m, kPlaneTexel_m));
  return scene;
}

Scene make_clutter(uint64_t seed, const Harshness& harsh) {
  Random random(seed, 5);
  Scene scene;
  scene.stage.azimuth_rad = random.uniform(0, 2 * std::numbers::pi);
  scene.stage.min_height_m = 0.4;
  scene.stage.cluttered = true;
  const double light = random.uniform(0.6, 1.1);
  const std::vector<Footprint> boxes = place_clutter(random);
  scene.surfaces.push_back(make_table(boxes, light, random, harsh));
  for (const Footprint& b : boxes) add_box(b, light, random, &scene.surfaces);
  scene.surfaces.push_back(make_floor(8, -0.74, 0.7 * light, random));
  return scene;
}

Scene make_desk(bool with_boxes, uint64_t seed, const Harshness& harsh) {
  Random random(seed, 1);
  Scene scene;
  scene.stage.azimuth_rad = random.uniform(0, 2 * std::numbers::pi);
  const double light = random.uniform(0.6, 1.1);
  std::vector<Footprint> boxes;
  if (with_boxes) {
    boxes = place_boxes(scene.stage.azimuth_rad, random);
    scene.stage.min_height_m = 0.36;  // stays above the highest box
  }
  scene.surfaces.push_back(make_table(boxes, light, random, harsh));
  for (const Footprint& b : boxes) add_box(b, light, random, &scene.surfaces);
  scene.surfaces.push_back(make_floor(8, -0.74, 0.7 * light, random));
  return scene;
}

// A wallpaper's ornament: a lattice of small marks, no two quite alike; bare: the share of them that is missing.
void paper_ornament(Canvas& canvas, double base, double bare, Random& random) {
  const Place place(0, 0, 0);
  const double w = canvas.width_m(), h = canvas.height_m();
  const double pitch = random.uniform(0.07, 0.1);
  const double mark = base * random.uniform(0.25, 0.45);
  for (double y = 0.5 * pitch; y < h; y += pitch) {
    for (double x = 0.5 * pitch; x < w; x += pitch) {
      if (bare > 0 && random.chance(bare)) continue;
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
}

// A papered wall with posters, w x h metres, texture rows downwards.
Canvas make_wall(double w, double h, Random& random, const Harshness& harsh) {
  Canvas canvas(w, h, kWallTexel_m);
  const Place place(0, 0, 0);
  const double base = random.uniform(0.3, 0.55);
  const uint32_t seed = static_cast<uint32_t>(random.bits());
  ValueNoise coarse(seed), fine(seed + 1), finest(seed + 2);
  canvas.paint(place, 0, 0, w, h, 0, [&](double x, double y) {
    const float n = coarse(static_cast<float>(9 * x), static_cast<float>(9 * y)) +
                    fine(static_cast<float>(55 * x), static_cast<float>(55 * y)) +
                    finest(static_cast<float>(190 * x), static_cast<float>(190 * y));
    return Ink{base * (0.85 + 0.1 * (1 - harsh.bare) * static_cast<double>(n)), 1};
  });
  if (harsh.repeats > 0) {
    printed_pattern(canvas, harsh.repeats, random);
  } else {
    paper_ornament(canvas, base, harsh.bare, random);
  }
  // Posters and sheets where the camera looks, columns from 0.15 m, heights 0.8 to 1.9 m above the floor.
  for (double x = 0.2; x < w - 0.2; x += random.uniform(0.27, 0.36)) {
    double y = h - random.uniform(1.7, 1.9);
    while (y < h - 0.85) {
      const double width = random.uniform(0.2, 0.32);
      const double height = width * random.uniform(0.9, 1.45);
      const double tilt = random.uniform(-4, 4) * kRadPerDegree;
      const Place centre(x + random.uniform(-0.03, 0.03), y + 0.5 * height, tilt);
      const bool missing = harsh.bare > 0 && random.chance(harsh.bare);
      const int kind = missing ? 7 : random.integer(0, 7);
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
Scene make_walls(uint64_t seed, const Harshness& harsh) {
  Random random(seed, 2);
  Scene scene;
  scene.stage.kind = Stage::Kind::kCorner;
  scene.stage.mirrored = random.chance(0.5);
  scene.stage.cluttered = true;
  const double light = random.uniform(0.6, 1.1);
  constexpr double kLength_m = 3;
  constexpr double kHeight_m = 2.4;
  Canvas first = make_wall(kLength_m, kHeight_m, random, harsh);
  Canvas second = make_wall(kLength_m, kHeight_m, random, harsh);
  const Vector3d down = -Vector3d::UnitZ();
  scene.surfaces.push_back(surface_of(first, {kLength_m, 0, kHeight_m}, -Vector3d::UnitX(), down, light));
  scene.surfaces.push_back(
      surface_of(second, {0, 0, kHeight_m}, Vector3d::UnitY(), down, light * random.uniform(0.55, 0.8)));
  scene.surfaces.push_back(make_floor(8, 0, light, random));
  return scene;
}

// Small things spread over a canvas, one on each place of a jittered lattice with the given probability.
void scatter_things(Canvas& canvas, double pitch, double probability, Random& random) {
  for (double y = 0.5 * pitch; y < canvas.height_m(); y += pitch) {
    for (double x = 0.5 * pitch; x < canvas.width_m(); x += pitch) {
      const double dx = pitch * random.uniform(-0.35, 0.35);
      const double dy = pitch * random.uniform(-0.35, 0.35);
      const double turn = random.uniform(0, 2 * std::numbers::pi);
      if (random.chance(probability)) small_thing(canvas, Place(x + dx, y + dy, turn), random);
    }
  }
}

// A plain painted table with one sheet of paper in the middle and a few small things: most of nearly every view is
// bare.
Scene make_sparse(uint64_t seed) {
  Random random(seed, 6);
  Scene scene;
  scene.stage.azimuth_rad = random.uniform(0, 2 * std::numbers::pi);
  const double light = random.uniform(0.7, 1.1);
  Canvas canvas(kTableSize_m, kTableSize_m, kTableTexel_m);
  plain_paint(canvas, random);
  page(canvas, Place(0.5 * kTableSize_m, 0.5 * kTableSize_m, random.uniform(0, 2 * std::numbers::pi)), 0.148, 0.21,
       random);
  scatter_things(canvas, random.uniform(0.12, 0.14), 0.8, random);
  uneven_light(canvas, random);
  const double half = 0.5 * kTableSize_m;
  scene.surfaces.push_back(surface_of(canvas, {-half, half, 0}, Vector3d::UnitX(), -Vector3d::UnitY(), light));
  scene.surfaces.push_back(make_floor(8, -0.74, 0.7 * light, random));
  return scene;
}

// A plain table with two postcards in the middle: nothing else in any view.
Scene make_postcards(uint64_t seed) {
  constexpr double kWidth_m = 0.148, kHeight_m = 0.105;
  Random random(seed, 8);
  Scene scene;
  scene.stage.azimuth_rad = random.uniform(0, 2 * std::numbers::pi);
  const double light = random.uniform(0.7, 1.1);
  Canvas canvas(kTableSize_m, kTableSize_m, kTableTexel_m);
  plain_paint(canvas, random);
  const double half = 0.5 * kTableSize_m;
  const double to = random.uniform(0, 2 * std::numbers::pi), apart = random.uniform(0.09, 0.11);
  for (const double way : {-1.0, 1.0}) {
    const double x = half + way * apart * std::cos(to), y = half + way * apart * std::sin(to);
    const Place card = Place(x, y, random.uniform(0, 2 * std::numbers::pi)).inner(-0.5 * kWidth_m, -0.5 * kHeight_m, 0);
    canvas.rectangle(card, 0.001, 0.001, kWidth_m + 0.002, kHeight_m + 0.002, 0.05, 0.5, 0.004);  // its shadow
    canvas.rectangle(card, 0, 0, kWidth_m, kHeight_m, 0.8);
    picture(canvas, card.inner(0.005, 0.005, 0), kWidth_m - 0.01, kHeight_m - 0.01, random);
  }
  uneven_light(canvas, random);
  scene.surfaces.push_back(surface_of(canvas, {-half, half, 0}, Vector3d::UnitX(), -Vector3d::UnitY(), light));
  scene.surfaces.push_back(make_floor(8, -0.74, 0.7 * light, random));
  return scene;
}

// A table of tiles that are alike to the texel, with a few unique things on it or without any.
Scene make_tiles(uint64_t seed, bool unique_things) {
  Random random(seed, 7);
  Scene scene;
  scene.stage.azimuth_rad = random.uniform(0, 2 * std::numbers::pi);
  const double light = random.uniform(0.7, 1.1);
  Canvas canvas(kTableSize_m, kTableSize_m, kTableTexel_m);
  const double pitch = kTableTexel_m * random.integer(110, 170);  // 55 to 85 mm
  const double tile = random.uniform(0.4, 0.6);
  const double ink = tile * random.uniform(0.2, 0.45);
  const double joint = 0.003;
  canvas.rectangle(Place(0, 0, 0), -1, -1, kTableSize_m + 1, kTableSize_m + 1, random.uniform(0.1, 0.2));
  const uint64_t which = random.bits();
  for (double y = 0; y < kTableSize_m; y += pitch) {
    for (double x = 0; x < kTableSize_m; x += pitch) {
      canvas.rectangle(Place(x, y, 0), 0.5 * joint, 0.5 * joint, pitch - 0.5 * joint, pitch - 0.5 * joint, tile);
      motif(canvas, x, y, pitch, ink, 1, which);
    }
  }
  if (unique_things) scatter_things(canvas, random.uniform(0.2, 0.24), 0.6, random);
  uneven_light(canvas, random);
  const double half = 0.5 * kTableSize_m;
  scene.surfaces.push_back(surface_of(canvas, {-half, half, 0}, Vector3d::UnitX(), -Vector3d::UnitY(), light));
  scene.surfaces.push_back(make_floor(8, -0.74, 0.7 * light, random));
  return scene;
}

// A print of black and white squares with a white margin, its middle at the scene's.
Surface checkered(int columns, int rows, double margin_m, double z, double light) {
  Canvas canvas(columns * kCheckerSquare_m + 2 * margin_m, rows * kCheckerSquare_m + 2 * margin_m, kTableTexel_m);
  canvas.rectangle(Place(0, 0, 0), -1, -1, 2, 2, 0.8);
  const Place first(margin_m, margin_m, 0);
  for (int j = 0; j < rows; ++j) {
    for (int i = j % 2; i < columns; i += 2) {
      canvas.rectangle(first, i * kCheckerSquare_m, j * kCheckerSquare_m, (i + 1) * kCheckerSquare_m,
                       (j + 1) * kCheckerSquare_m, 0.05);
    }
  }
  return surface_of(canvas, {-canvas.width_m() / 2, canvas.height_m() / 2, z}, Vector3d::UnitX(), -Vector3d::UnitY(),
                    light);
}

Scene make_checkerboard(uint64_t seed) {
  Random random(seed, 3);
  Scene scene;
  scene.stage.azimuth_rad = random.uniform(0, 2 * std::numbers::pi);
  const double light = random.uniform(0.9, 1.1);
  scene.surfaces.push_back(checkered(kCheckerColumns, kCheckerRows, 0, 0, light));
  scene.surfaces.push_back(make_floor(8, -0.74, 0.7 * light, random));
  return scene;
}

// A desk with a checkerboard for calibration on it, which fills most of the first view.
Scene make_board(uint64_t seed) {
  constexpr int kColumns = 13, kRows = 12;
  constexpr double kMargin_m = 0.02, kThick_m = 0.001;
  Scene scene = make_desk(false, seed, {});
  scene.surfaces.push_back(
      checkered(kColumns, kRows, kMargin_m, kThick_m, static_cast<double>(scene.surfaces.front().light)));
  return scene;
}

// The desk with an upright board on it, papered and with pictures, that faces the person and fills half of the view.
Scene make_front(uint64_t seed) {
  Random random(seed, 12);
  Scene scene = make_desk(false, seed, {});
  const double width = random.uniform(0.35, 0.6), height = random.uniform(0.22, 0.32);
  Canvas canvas(width, height, kTableTexel_m);
  const Place whole(0, 0, 0);
  canvas.rectangle(whole, 0, 0, width, height, random.uniform(0.3, 0.7));
  paper_ornament(canvas, 0.5, 0, random);
  for (int i = 0; i < 6; ++i) {
    const Place centre(random.uniform(0.1, width - 0.1), random.uniform(0.08, height - 0.08),
                       random.uniform(-0.1, 0.1));
    const double side = random.uniform(0.08, 0.14);
    if (random.chance(0.5)) {
      cover(canvas, centre, side, 1.2 * side, random);
    } else {
      page(canvas, centre, side, 1.2 * side, random);
    }
  }
  const double facing = scene.stage.azimuth_rad + random.uniform(-0.4, 0.4);
  const Vector3d normal(std::cos(facing), std::sin(facing), 0), right = Vector3d::UnitZ().cross(normal);
  const Vector3d foot = -random.uniform(0.02, 0.1) * normal;
  scene.surfaces.push_back(surface_of(canvas, foot - 0.5 * width * right + height * Vector3d::UnitZ(), right,
                                      -Vector3d::UnitZ(), random.uniform(0.6, 1.1)));
  return scene;
}

}  // namespace

bool ground_plane_known(const std::string& scene) {
  return scene == "desk" || scene == "boxes" || scene == "plane" || scene == "sparse" || scene == "tiles" ||
         scene == "board" || scene == "postcards" || scene == "same_tiles" || scene == "front";
}

std::vector<std::string> scene_names() {
  return {"desk",   "boxes", "walls", "checkerboard", "plane",      "clutter",
          "sparse", "tiles", "board", "postcards",    "same_tiles", "front"};
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

// Rounded to a micrometre, so that corners in which surfaces meet are the same.
std::string model_text(const Scene& scene) {
  if (!scene.model.empty()) return scene.model;
  std::string points, faces;
  int count = 0;
  for (const Surface& s : scene.surfaces) {
    if (std::max(s.width_m, s.height_m) > kLargestThing_m) continue;
    const Vector3d u = s.width_m * s.u_axis, v = s.height_m * s.v_axis;
    for (const Vector3d& corner :
         {s.origin, Vector3d(s.origin + v), Vector3d(s.origin + v + u), Vector3d(s.origin + u)})
      points += platform::format("%.6f %.6f %.6f\n", corner.x(), corner.y(), corner.z());
    faces += platform::format("4 %d %d %d %d\n", 4 * count, 4 * count + 1, 4 * count + 2, 4 * count + 3);
    ++count;
  }
  if (count == 0) return "";
  return platform::format("V1\n%d\n", 4 * count) + points + "0\n0\n" + platform::format("%d\n", count) + faces +
         "0\n0\n";
}

Scene make_scene(const std::string& name, uint64_t seed, const Harshness& harsh) {
  if (name == "boxes") return make_desk(true, seed, harsh);
  if (name == "walls") return make_walls(seed, harsh);
  if (name == "checkerboard") return make_checkerboard(seed);
  if (name == "plane") return make_plane(seed, harsh);
  if (name == "clutter") return make_clutter(seed, harsh);
  if (name == "sparse") return make_sparse(seed);
  if (name == "tiles") return make_tiles(seed, true);
  if (name == "same_tiles") return make_tiles(seed, false);
  if (name == "postcards") return make_postcards(seed);
  if (name == "board") return make_board(seed);
  if (name == "front") return make_front(seed);
  return make_desk(false, seed, harsh);
}

}  // namespace pptam::sim
