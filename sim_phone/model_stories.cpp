#include "sim_phone/model_stories.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <functional>
#include <memory>
#include <numbers>
#include <utility>

#include "platform/text.h"
#include "sim_phone/hand.h"
#include "sim_phone/paint.h"
#include "sim_phone/random.h"

namespace pptam::sim {
namespace {

using Eigen::Isometry3d;
using platform::format;

constexpr double kModelTexel_m = 0.0005;
constexpr double kTurn = 2 * std::numbers::pi;
constexpr uint64_t kModelScenes = 30, kModelStories = 40;  // random streams, one for each story from here on

// A .cao model that is written as the scene is built.
struct CaoText {
  std::string points, lines, faces, cylinders, circles;
  int point_count = 0, line_count = 0, face_count = 0, cylinder_count = 0, circle_count = 0;

  int point(const Vector3d& p) {
    points += format("%.6f %.6f %.6f\n", p.x(), p.y(), p.z());
    return point_count++;
  }
  void line(const Vector3d& a, const Vector3d& b) {
    const int first = point(a), second = point(b);
    lines += format("%d %d\n", first, second);
    ++line_count;
  }
  // Corners run counter-clockwise, seen from outside.
  void face(const std::vector<Vector3d>& corners) {
    faces += format("%zu", corners.size());
    for (const Vector3d& corner : corners) faces += format(" %d", point(corner));
    faces += "\n";
    ++face_count;
  }
  void cylinder(const Vector3d& a, const Vector3d& b, double radius) {
    const int first = point(a), second = point(b);
    cylinders += format("%d %d %.6f\n", first, second, radius);
    ++cylinder_count;
  }
  // Seen from the side that u x v points to.
  void circle(const Vector3d& centre, const Vector3d& u, const Vector3d& v, double radius) {
    const int middle = point(centre), first = point(centre + radius * u), second = point(centre + radius * v);
    circles += format("%.6f %d %d %d\n", radius, middle, first, second);
    ++circle_count;
  }
  std::string text() const {
    return format("V1\n%d\n", point_count) + points + format("%d\n", line_count) + lines + "0\n" +
           format("%d\n", face_count) + faces + format("%d\n", cylinder_count) + cylinders +
           format("%d\n", circle_count) + circles;
  }
};

// The rectangle with corner (0, 0) of its canvas at `origin`.
std::vector<Vector3d> corners_of(const Surface& s) {
  const Vector3d u = s.width_m * s.u_axis, v = s.height_m * s.v_axis;
  return {s.origin, s.origin + v, s.origin + v + u, s.origin + u};
}

Surface plain(double width_m, double height_m, const Vector3d& origin, const Vector3d& u, const Vector3d& v,
              double grey, double light = 1) {
  Canvas canvas(width_m, height_m, std::max(kModelTexel_m, std::min(width_m, height_m) / 8));
  canvas.rectangle(Place(0, 0, 0), -1, -1, width_m + 1, height_m + 1, grey);
  Surface surface = surface_of(canvas, origin, u, v, light);
  surface.width_m = width_m;  // exactly, whatever the texels
  surface.height_m = height_m;
  return surface;
}

// A wooden table with pages and small things, z = 0, its middle bare.
Surface littered_table(double size_m, double bare_m, Random& random) {
  Canvas canvas(size_m, size_m, 0.001);
  wood(canvas, random);
  for (int i = 0; i < 40; ++i) {
    const double away = random.uniform(bare_m, 0.5 * size_m), angle = random.uniform(0, kTurn);
    const Place place(0.5 * size_m + away * std::cos(angle), 0.5 * size_m + away * std::sin(angle),
                      random.uniform(0, kTurn));
    if (random.chance(0.3)) {
      page(canvas, place, 0.148, 0.21, random);
    } else {
      small_thing(canvas, place, random);
    }
  }
  uneven_light(canvas, random);
  return surface_of(canvas, {-0.5 * size_m, 0.5 * size_m, 0}, Vector3d::UnitX(), -Vector3d::UnitY(), 1);
}

// A round post from foot to foot + height z, as 64 flat pieces, whose light is that of a lamp at one side. With a lid
// (its grey; 0: none) of strips through its middle: each is as long as the post is wide, together they are the polygon
// of its sides. Pieces touch the round from outside: their corners are 1.2 per mille of the radius too far out.
void add_post(const Vector3d& foot, double radius, double height, double grey, double lid, Scene* scene) {
  constexpr int kPieces = 64;
  const double half = radius * std::tan(0.5 * kTurn / kPieces);
  for (int i = 0; i < kPieces; ++i) {
    const double angle = kTurn * i / kPieces;
    const Vector3d out(std::cos(angle), std::sin(angle), 0), along(-std::sin(angle), std::cos(angle), 0);
    const Vector3d origin = foot + radius * out - half * along + height * Vector3d::UnitZ();
    scene->surfaces.push_back(
        plain(2 * half, height, origin, along, -Vector3d::UnitZ(), grey, 0.75 + 0.25 * std::cos(angle - 1)));
  }
  if (lid <= 0) return;
  for (int i = 0; i < kPieces / 2; ++i) {
    const double angle = kTurn * i / kPieces;
    const Vector3d u(std::cos(angle), std::sin(angle), 0), v(std::sin(angle), -std::cos(angle), 0);
    const Vector3d top = foot + height * Vector3d::UnitZ();
    scene->surfaces.push_back(plain(2 * radius, 2 * half, top - radius * u - half * v, u, v, lid));
  }
}

// A box on the table with plain sides, a face each in the model. Paint is given for its top.
void add_plain_box(const Vector3d& low, const Vector3d& size, double grey, Canvas* top, Scene* scene, CaoText* model) {
  const Vector3d x = Vector3d::UnitX(), y = Vector3d::UnitY(), z = Vector3d::UnitZ(), high = low + size;
  const size_t first = scene->surfaces.size();
  scene->surfaces.push_back(surface_of(*top, {low.x(), high.y(), high.z()}, x, -y, 1));
  scene->surfaces.push_back(plain(size.x(), size.z(), {low.x(), low.y(), high.z()}, x, -z, grey, 0.7));
  scene->surfaces.push_back(plain(size.x(), size.z(), {high.x(), high.y(), high.z()}, -x, -z, grey, 0.5));
  scene->surfaces.push_back(plain(size.y(), size.z(), {high.x(), low.y(), high.z()}, y, -z, grey, 0.85));
  scene->surfaces.push_back(plain(size.y(), size.z(), {low.x(), high.y(), high.z()}, -y, -z, grey, 0.6));
  for (size_t i = first; i < scene->surfaces.size(); ++i) model->face(corners_of(scene->surfaces[i]));
}

// ---- scenes ----

constexpr double kCircleX = 0.08, kCircleY = 0.06, kCircleRadius = 0.024;

Scene four_circles(Random& random) {
  Scene scene;
  CaoText model;
  scene.surfaces.push_back(littered_table(1.4, 0.24, random));
  constexpr double kWidth = 0.28, kHeight = 0.22, kThick = 0.002;
  Canvas board(kWidth, kHeight, kModelTexel_m);
  board.rectangle(Place(0, 0, 0), -1, -1, 1, 1, 0.75);
  for (const double x : {-kCircleX, kCircleX})
    for (const double y : {-kCircleY, kCircleY}) {
      board.ellipse(Place(0.5 * kWidth + x, 0.5 * kHeight - y, 0), kCircleRadius, kCircleRadius, 0.06);
      model.circle({x, y, kThick}, Vector3d::UnitX(), Vector3d::UnitY(), kCircleRadius);
    }
  scene.surfaces.push_back(
      surface_of(board, {-0.5 * kWidth, 0.5 * kHeight, kThick}, Vector3d::UnitX(), -Vector3d::UnitY(), 1));
  scene.model = model.text();
  return scene;
}

Scene can_on_a_mat(Random& random) {
  Scene scene;
  CaoText model;
  scene.surfaces.push_back(littered_table(1.4, 0.2, random));
  constexpr double kWidth = 0.22, kHeight = 0.16, kThick = 0.002, kRadius = 0.033, kTall = 0.11;
  const Vector3d x = Vector3d::UnitX(), y = Vector3d::UnitY();
  scene.surfaces.push_back(plain(kWidth, kHeight, {-0.5 * kWidth, 0.5 * kHeight, kThick}, x, -y, 0.1));
  add_post({-0.03, 0, 0}, kRadius, kTall, 0.45, 0.8, &scene);
  model.cylinder({-0.03, 0, kThick}, {-0.03, 0, kTall}, kRadius);
  model.circle({-0.03, 0, kTall}, x, y, kRadius);
  for (const double at : {-0.5 * kHeight, 0.5 * kHeight})
    model.line({-0.5 * kWidth, at, kThick}, {0.5 * kWidth, at, kThick});
  scene.model = model.text();
  return scene;
}

// What stands behind and moves is the story's.
Scene post_outdoors(Random& random) {
  Scene scene;
  CaoText model;
  constexpr double kRadius = 0.07, kTall = 1.0, kWide = 0.35, kHigh = 0.6;
  add_post({0, -0.15, -0.5 * kTall}, kRadius, kTall, 0.5, 0, &scene);
  model.cylinder({0, -0.15, -0.5 * kTall}, {0, -0.15, 0.5 * kTall}, kRadius);
  Canvas sign(kWide, kHigh, 0.001);
  sign.rectangle(Place(0, 0, 0), -1, -1, 1, 1, 0.7);
  text_block(sign, Place(0.06, 0.1, 0), kWide - 0.12, kHigh - 0.2, 0.03, 0.1, random);
  const Vector3d y = Vector3d::UnitY(), z = Vector3d::UnitZ(), top(0, 0.08, 0.5 * kHigh);
  scene.surfaces.push_back(surface_of(sign, top, y, -z, 1));
  for (const double down : {0.0, kHigh}) model.line(top - down * z, top - down * z + kWide * y);
  scene.model = model.text();
  return scene;
}

Scene machine(Random& random) {
  Scene scene;
  CaoText model;
  scene.surfaces.push_back(littered_table(2.0, 0.5, random));
  constexpr double kWidth = 0.5, kHeight = 0.36, kTall = 0.12;
  const Vector3d x = Vector3d::UnitX(), y = Vector3d::UnitY();
  Canvas top(kWidth, kHeight, kModelTexel_m);
  const Place whole(0, 0, 0);
  top.rectangle(whole, -1, -1, 1, 1, 0.55);
  const auto at = [&](double u, double v) { return Vector3d(u - 0.5 * kWidth, 0.5 * kHeight - v, kTall); };
  for (const double u : {0.1, 0.26}) {
    top.ellipse(Place(u, 0.11, 0), 0.06, 0.06, 0.08);
    top.ellipse(Place(u, 0.11, 0), 0.02, 0.02, 0.5);  // a hub that the model does not know
    model.circle(at(u, 0.11), x, y, 0.06);
  }
  // Panels of different contrast, and grilles.
  const auto panel = [&](double u, double v, double w, double h, double ink) {
    top.rectangle(whole, u, v, u + w, v + h, ink);
    model.face({at(u, v), at(u, v + h), at(u + w, v + h), at(u + w, v)});
  };
  panel(0.36, 0.04, 0.11, 0.15, 0.7);
  panel(0.04, 0.21, 0.2, 0.12, 0.3);
  panel(0.28, 0.22, 0.19, 0.1, 0.47);
  for (int i = 0; i < 4; ++i) panel(0.3, 0.235 + 0.02 * i, 0.15, 0.008, 0.1);
  panel(0.37, 0.06, 0.06, 0.02, 0.2);
  text_block(top, Place(0.06, 0.23, 0), 0.16, 0.08, 0.008, 0.8, random);  // not in the model either
  add_plain_box({-0.5 * kWidth, -0.5 * kHeight, 0}, {kWidth, kHeight, kTall}, 0.5, &top, &scene, &model);
  scene.model = model.text();
  return scene;
}

Scene circuit_board(Random& random) {
  Scene scene;
  CaoText model;
  Canvas table(1.2, 1.2, kModelTexel_m);
  wood(table, random);
  for (int i = 0; i < 60; ++i) {
    const Place place(random.uniform(0, 1.2), random.uniform(0, 1.2), random.uniform(0, kTurn));
    if (random.chance(0.5)) {
      cover(table, place, 0.2, 0.27, random);
    } else {
      page(table, place, 0.21, 0.297, random);
    }
  }
  scene.surfaces.push_back(surface_of(table, {-0.6, 0.6, 0}, Vector3d::UnitX(), -Vector3d::UnitY(), 1));
  constexpr double kWidth = 0.16, kHeight = 0.1, kTall = 0.004;
  Canvas board(kWidth, kHeight, 0.00025);
  const Place whole(0, 0, 0);
  board.rectangle(whole, -1, -1, 1, 1, 0.16);
  for (int i = 0; i < 40; ++i) {  // traces
    const double u = random.uniform(0, kWidth), v = random.uniform(0, kHeight), length = random.uniform(0.01, 0.05);
    const bool across = random.chance(0.5);
    board.line(whole, u, v, across ? u + length : u, across ? v : v + length, 0.0007, 0.35);
  }
  const auto chip = [&](double u, double v, double w, double h, double ink) {
    for (double pin = 0.003; pin < w - 0.001; pin += 0.0025)
      for (const double row : {v - 0.002, v + h})
        board.rectangle(whole, u + pin, row, u + pin + 0.001, row + 0.002, 0.6);
    board.rectangle(whole, u, v, u + w, v + h, ink);
    const auto at = [&](double a, double b) { return Vector3d(a - 0.5 * kWidth, 0.5 * kHeight - b, kTall); };
    model.face({at(u, v), at(u, v + h), at(u + w, v + h), at(u + w, v)});
  };
  chip(0.05, 0.03, 0.05, 0.04, 0.03);
  chip(0.115, 0.02, 0.03, 0.015, 0.04);
  chip(0.115, 0.06, 0.025, 0.02, 0.4);
  chip(0.012, 0.02, 0.02, 0.05, 0.65);
  add_plain_box({-0.5 * kWidth, -0.5 * kHeight, 0}, {kWidth, kHeight, kTall}, 0.3, &board, &scene, &model);
  scene.model = model.text();
  return scene;
}

// ---- what moves ----

// Axes of a plate that faces `towards`, with its top up.
Eigen::Matrix3d facing(const Vector3d& towards) {
  Eigen::Matrix3d R;
  R.col(2) = towards.normalized();
  R.col(0) = Vector3d::UnitZ().cross(R.col(2)).normalized();
  R.col(1) = R.col(2).cross(R.col(0));
  return R;
}

using Path = std::function<Vector3d(double t_s)>;

// A painted plate, its middle on the path.
void add_plate(Canvas canvas, const Vector3d& towards, double roll, Path path, Story* story) {
  auto mover = std::make_shared<Mover>();
  const double w = canvas.width_m(), h = canvas.height_m();
  mover->surfaces.push_back(surface_of(canvas, {-0.5 * w, 0.5 * h, 0}, Vector3d::UnitX(), -Vector3d::UnitY(), 1));
  const Eigen::Matrix3d R = facing(towards) * Eigen::AngleAxisd(roll, Vector3d::UnitZ()).toRotationMatrix();
  mover->T_wm = [R, path = std::move(path)](double t_s) {
    Isometry3d T = Isometry3d::Identity();
    T.linear() = R;
    T.translation() = path(t_s);
    return T;
  };
  story->movers.push_back(std::move(mover));
}

// To and fro across `towards` over so much to either side, and a little up and down.
Path swinging(const Vector3d& middle, const Vector3d& towards, double reach_m, double period_s, double phase) {
  const Eigen::Matrix3d R = facing(towards);
  return [=](double t_s) -> Vector3d {
    const double turn = kTurn * t_s / period_s + phase;
    return middle + reach_m * std::sin(turn) * R.col(0) + 0.2 * reach_m * std::sin(1.7 * turn + 1) * R.col(1);
  };
}

// A forearm with a hand and fingers: a plate each, which move together.
void add_arm(const Vector3d& towards, const Path& path, Random& random, Story* story) {
  const Eigen::Matrix3d R = facing(towards);
  const auto piece = [&](double w, double h, double x, double y) {
    Canvas canvas(w, h, 0.001);
    skin(canvas, random);
    const Vector3d at = x * R.col(0) + y * R.col(1);
    add_plate(
        std::move(canvas), towards, 0, [path, at](double t_s) -> Vector3d { return path(t_s) + at; }, story);
  };
  piece(0.08, 0.09, 0, 0);
  piece(0.06, 0.3, 0, -0.19);
  for (int finger = 0; finger < 4; ++finger) piece(0.016, 0.07, -0.031 + 0.0207 * finger, 0.08);
}

// A screwdriver: a handle and a thin shaft.
void add_tool(const Vector3d& towards, double roll, const Path& path, Random& random, Story* story) {
  Canvas handle(0.03, 0.1, kModelTexel_m), shaft(0.007, 0.12, kModelTexel_m);
  handle.rectangle(Place(0, 0, 0), -1, -1, 1, 1, random.uniform(0.1, 0.7));
  for (int i = 0; i < 4; ++i) handle.rectangle(Place(0, 0, 0), 0.003 + 0.007 * i, 0, 0.006 + 0.007 * i, 1, 0.05);
  shaft.rectangle(Place(0, 0, 0), -1, -1, 1, 1, 0.7);
  const Vector3d along = facing(towards) * Vector3d(-std::sin(roll), std::cos(roll), 0);
  add_plate(std::move(handle), towards, roll, path, story);
  add_plate(
      std::move(shaft), towards, roll, [path, along](double t_s) -> Vector3d { return path(t_s) + 0.11 * along; },
      story);
}

Canvas leaves(double size_m, double texel_m, Random& random) {
  Canvas canvas(size_m, size_m, texel_m);
  canvas.rectangle(Place(0, 0, 0), -1, -1, size_m + 1, size_m + 1, 0.08);
  const int count = static_cast<int>(900 * size_m * size_m);
  for (int i = 0; i < count; ++i)
    canvas.ellipse(Place(random.uniform(0, size_m), random.uniform(0, size_m), random.uniform(0, kTurn)),
                   random.uniform(0.02, 0.05), random.uniform(0.008, 0.02), random.uniform(0.04, 0.6));
  return canvas;
}

// Round `target`: azimuth and slant against the vertical sway about their middles.
MotionCurve round_about(const Vector3d& target, double distance_m, double azimuth, double slant, double swing,
                        Random& random, uint64_t seed) {
  const double period_s = random.uniform(6, 8), phase = random.uniform(0, kTurn), tilt_s = random.uniform(7, 9);
  const Unrest unrest(seed, 1);
  return [=](double t_s) {
    const double turn = kTurn * t_s / period_s;
    const double a = azimuth + swing * std::sin(turn + phase), s = slant + 0.4 * swing * std::sin(kTurn * t_s / tilt_s);
    const double d = distance_m * (1 + 0.12 * std::sin(0.6 * turn));
    View view;
    view.target = target + 0.03 * distance_m * Vector3d(std::sin(0.8 * turn), std::cos(0.7 * turn), 0);
    view.position = target + d * Vector3d(std::sin(s) * std::cos(a), std::sin(s) * std::sin(a), std::cos(s));
    return unrest.applied(view.pose(), t_s);
  };
}

Vector3d direction(double azimuth, double slant) {
  return {std::sin(slant) * std::cos(azimuth), std::sin(slant) * std::sin(azimuth), std::cos(slant)};
}

// ---- stories ----

// An arm over the board hides one circle or two, now here, now there.
Story tell_circles(Random& random, uint64_t seed) {
  Story story;
  const double azimuth = random.uniform(0, kTurn), slant = 32 * kDegree;
  story.curve = round_about(Vector3d::Zero(), 0.55, azimuth, slant, 25 * kDegree, random, seed);
  const Vector3d towards = direction(azimuth, slant);
  add_arm(towards, swinging(0.1 * towards, towards, 0.2, random.uniform(4, 5), random.uniform(0, kTurn)), random,
          &story);
  return story;
}

Story tell_cylinder(Random& random, uint64_t seed) {
  Story story;
  const double azimuth = random.uniform(-0.6, 0.6) - 0.25 * kTurn, slant = 52 * kDegree;
  story.curve = round_about({0, 0, 0.04}, 0.55, azimuth, slant, 25 * kDegree, random, seed);
  // From below: its fingers reach the can, and its top stays in sight.
  const Vector3d towards = direction(azimuth, slant);
  const Vector3d middle = Vector3d(0, 0, 0.05) + 0.14 * towards - 0.08 * facing(towards).col(1);
  add_arm(towards, swinging(middle, towards, 0.2, random.uniform(4, 5), random.uniform(0, kTurn)), random, &story);
  return story;
}

// Wind moves leaves behind the post, and some before it.
Story tell_outdoors(Random& random, uint64_t seed) {
  Story story;
  story.curve = round_about(Vector3d::Zero(), 1.7, 0, 84 * kDegree, 14 * kDegree, random, seed);
  const Vector3d towards = Vector3d::UnitX();
  for (const double y : {-1.1, -0.37, 0.37, 1.1})
    for (const double z : {-0.75, 0.0, 0.75})
      add_plate(leaves(0.9, 0.003, random), towards, random.uniform(-0.1, 0.1),
                swinging({-0.5 - random.uniform(0, 0.3), y, z}, towards, random.uniform(0.03, 0.08),
                         random.uniform(1.2, 2.5), random.uniform(0, kTurn)),
                &story);
  for (int i = 0; i < 5; ++i)
    add_plate(leaves(random.uniform(0.06, 0.14), 0.002, random), towards, random.uniform(0, kTurn),
              swinging({random.uniform(0.15, 0.4), random.uniform(-0.3, 0.4), random.uniform(-0.3, 0.3)}, towards,
                       random.uniform(0.05, 0.12), random.uniform(1.5, 3), random.uniform(0, kTurn)),
              &story);
  return story;
}

// A large board and an arm hide up to half of the machine.
Story tell_machine(Random& random, uint64_t seed) {
  Story story;
  const double azimuth = random.uniform(-0.4, 0.4) - 0.25 * kTurn, slant = 38 * kDegree;
  story.curve = round_about({0, 0, 0.1}, 1.05, azimuth, slant, 20 * kDegree, random, seed);
  const Vector3d towards = direction(azimuth, slant);
  Canvas board(0.22, 0.5, 0.001);
  board.rectangle(Place(0, 0, 0), -1, -1, 1, 1, 0.4);
  text_block(board, Place(0.02, 0.05, 0), 0.18, 0.4, 0.012, 0.05, random);
  const double period_s = random.uniform(5, 6), phase = random.uniform(0, kTurn);
  add_plate(std::move(board), towards, 0.1, swinging(0.35 * towards, towards, 0.3, period_s, phase), &story);
  add_arm(towards, swinging(0.3 * towards, towards, 0.25, 0.7 * period_s, phase + 2), random, &story);
  return story;
}

// A hand and two tools over the board; the lamp is turned down and up.
Story tell_board(Random& random, uint64_t seed) {
  Story story;
  const double azimuth = random.uniform(-0.4, 0.4) - 0.25 * kTurn, slant = 35 * kDegree;
  story.curve = round_about(Vector3d::Zero(), 0.34, azimuth, slant, 22 * kDegree, random, seed);
  const Vector3d towards = direction(azimuth, slant);
  const Vector3d middle = 0.06 * towards - 0.06 * facing(towards).col(1);
  add_arm(towards, swinging(middle, towards, 0.15, random.uniform(4, 5), random.uniform(0, kTurn)), random, &story);
  for (int i = 0; i < 2; ++i)
    add_tool(towards, random.uniform(-0.8, 0.8),
             swinging(0.04 * towards, towards, 0.08, random.uniform(3, 4), random.uniform(0, kTurn)), random, &story);
  const double down_s = random.uniform(2, 3), up_s = down_s + random.uniform(1.5, 2.5);
  story.light = [=](double t_s) { return 1 - 0.6 * (blend((t_s - down_s) / 0.1) - blend((t_s - up_s) / 0.1)); };
  return story;
}

struct Teller {
  Scene (*scene)(Random&);
  Story (*story)(Random&, uint64_t seed);
};
constexpr Teller kTellers[] = {{four_circles, tell_circles},
                               {can_on_a_mat, tell_cylinder},
                               {post_outdoors, tell_outdoors},
                               {machine, tell_machine},
                               {circuit_board, tell_board}};

size_t index_of(const std::string& name) {
  size_t i = 0;
  while (i + 1 < model_stories().size() && name != model_stories()[i].name) ++i;
  return i;
}

}  // namespace

const std::vector<ModelStory>& model_stories() {
  static const std::vector<ModelStory> all = {
      {"model-circles", "four circles, of which an arm hides some at times", 384, 288, 12},
      {"model-cylinder", "a cylinder, a circle and two lines, and an arm before them at times", 384, 288, 12},
      {"model-outdoors", "a cylinder and two lines before leaves in the wind, some of them before it", 384, 288, 10},
      {"model-machine", "many lines and two circles in large images, half hidden at times", 768, 576, 8},
      {"model-board", "a circuit board before texture, with a hand, tools, and light that changes", 384, 288, 10}};
  return all;
}

bool is_model_story(const std::string& name) {
  return std::any_of(model_stories().begin(), model_stories().end(),
                     [&](const ModelStory& story) { return name == story.name; });
}

Scene make_model_scene(const std::string& name, uint64_t seed) {
  const size_t which = index_of(name);
  Random random(seed, kModelScenes + which);
  return kTellers[which].scene(random);
}

Story make_model_story(const std::string& name, uint64_t seed) {
  const size_t which = index_of(name);
  Random random(seed, kModelStories + which);
  return kTellers[which].story(random, seed);
}

PhoneOptions phone_for_model_story(const std::string& name, uint64_t seed) {
  const ModelStory& story = model_stories()[index_of(name)];
  PhoneOptions options;
  options.story = name;
  options.seed = seed;
  options.duration_s = story.duration_s;
  options.width = story.width;
  options.height = story.height;
  options.horizontal_fov_degrees = 40;
  options.frames_per_s = 25;
  options.readout_axis = RollingShutter::Axis::kRows;
  options.readout_s = 0.015;
  options.exposure_s = 0.008;
  return options;
}

}  // namespace pptam::sim
