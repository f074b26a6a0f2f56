#include "sim_phone/desktop_stories.h"

#include <algorithm>
#include <cmath>
#include <memory>

#include "sim_phone/hand.h"
#include "sim_phone/paint.h"
#include "sim_phone/random.h"

namespace pptam::sim {
namespace {

using Eigen::Isometry3d;

constexpr double kFramesPerSecond = 30;

// ---- corner2007: along one wall and then the other, 3 m from both, without a return [ptam 7.3] ----

constexpr double kCornerDistance_m = 3;
constexpr double kCornerPath_m = 18.2;                                        // [ptam 7.3]
constexpr double kCornerBend_m = 1.5;                                         // radius of the path's bend
constexpr double kWallLength_m = 15, kWallBottom_m = -2.9, kWallTop_m = 2.9;  // the camera moves at height 0
// A pixel covers 5.8 mm of a wall.
constexpr double kCornerTexel_m = 0.003;

// Photographs side by side, in rows of different heights.
Canvas wall_of_photographs(Random& random) {
  Canvas canvas(kWallLength_m, kWallTop_m - kWallBottom_m, kCornerTexel_m);
  canvas.rectangle(Place(0, 0, 0), -1, -1, canvas.width_m() + 1, canvas.height_m() + 1, random.uniform(0.2, 0.5));
  for (double y = 0; y < canvas.height_m();) {
    const double height = random.uniform(0.45, 0.8);
    for (double x = random.uniform(-0.4, 0); x < canvas.width_m();) {
      const double width = height * random.uniform(0.8, 1.5);
      picture(canvas, Place(x, y, 0), width, height, random);
      x += width;
    }
    y += height;
  }
  return canvas;
}

Scene make_corner(uint64_t seed) {
  Random random(seed, 13);
  Scene scene;
  scene.stage.kind = Stage::Kind::kCorner;
  Canvas first = wall_of_photographs(random);
  Canvas second = wall_of_photographs(random);
  const Vector3d down = -Vector3d::UnitZ();
  scene.surfaces.push_back(surface_of(first, {kWallLength_m, 0, kWallTop_m}, -Vector3d::UnitX(), down, 1));
  scene.surfaces.push_back(surface_of(second, {0, 0, kWallTop_m}, Vector3d::UnitY(), down, 0.8));
  return scene;
}

// Rest, then an even speed that is reached within a second. After `duration_s` the whole path has been walked.
double walked(double t_s, double path_m, double duration_s) {
  constexpr double kRest_s = 0.5, kSpeedUp_s = 1;
  const double speed = path_m / (duration_s - kRest_s - 0.5 * kSpeedUp_s);
  const double u = (t_s - kRest_s) / kSpeedUp_s;
  if (u <= 0) return 0;
  if (u < 1) return speed * kSpeedUp_s * u * u * u * (1 - 0.5 * u);
  return std::min(path_m, speed * kSpeedUp_s * (u - 0.5));
}

View corner_view(double at_m) {
  constexpr double kBendLength_m = 0.5 * std::numbers::pi * kCornerBend_m;
  constexpr double kStraight_m = 0.5 * (kCornerPath_m - kBendLength_m);
  constexpr double kTurnReach_m = 1.2;  // the view begins to turn so far before the bend, and ends so far after it
  const double centre = kCornerDistance_m + kCornerBend_m;
  const double into = at_m - kStraight_m;  // the bend
  View view;
  if (into < 0) {
    view.position = {centre - into, kCornerDistance_m, 0};
  } else if (into < kBendLength_m) {
    const double angle = into / kCornerBend_m;
    view.position = {centre - kCornerBend_m * std::sin(angle), centre - kCornerBend_m * std::cos(angle), 0};
  } else {
    view.position = {kCornerDistance_m, centre + into - kBendLength_m, 0};
  }
  const double turned = blend((into + kTurnReach_m) / (kBendLength_m + 2 * kTurnReach_m));
  const double facing = 0.5 * std::numbers::pi * turned;
  view.target = view.position - Vector3d(std::sin(facing), std::cos(facing), 0);
  return view;
}

Story corner(double duration_s) {
  Story story;
  story.curve = [duration_s](double t_s) { return corner_view(walked(t_s, kCornerPath_m, duration_s)).pose(); };
  return story;
}

// ---- desk2007: an overview, closing in, quick moves, a shake, and what was known before [ptam 7.1] ----

Story desk(const Stage& stage, uint64_t seed) {
  Random random(seed, 91);
  const auto view = [&](double farthest_m, double nearest_m, double reach_m) {
    const double azimuth = random.uniform(-50, 50) * kDegree;
    const double slant = random.uniform(20, 45) * kDegree;
    const double distance = random.uniform(nearest_m, farthest_m);
    const double radius = reach_m * std::sqrt(random.uniform(0, 1));
    const double direction = random.uniform(0, 2 * std::numbers::pi);
    const double roll = random.uniform(-10, 10) * kDegree;
    return table_view(stage, azimuth, slant, distance, {radius * std::cos(direction), radius * std::sin(direction), 0},
                      roll);
  };
  const View first = view(0.9, 0.75, 0.05);
  const auto hand = std::make_shared<Hand>(first, seed, 1.0);
  Walk walk{stage, random, *hand, first};
  const auto go = [&](const View& to, double speed, double haste) {
    walk.move_to(to, comfortable_time(walk.view, to - walk.view, speed, haste));
    walk.t_s += random.uniform(0, 0.4);
  };
  walk.start_sideways();
  while (walk.t_s < 18) go(view(1.1, 0.7, 0.45), 0.35, 0.5);
  while (walk.t_s < 32) {
    const View near = view(0.45, 0.36, 0.35);
    go(near, 0.35, 0.5);
    View far = near;
    far.position = near.target + random.uniform(1.8, 2.4) * (near.position - near.target);
    go(far, 0.35, 0.5);
  }
  while (walk.t_s < 41) go(view(1.0, 0.5, 0.4), 0.6, 1.5);
  const double from_s = walk.t_s + 0.3, to_s = from_s + random.uniform(1.2, 1.5);
  const double omega = 2 * std::numbers::pi * random.uniform(2.2, 3);
  const double amplitude = random.uniform(208, 240) * kDegree / omega;
  const double about = random.uniform(0, 2 * std::numbers::pi);
  const Vector3d axis(std::cos(about), std::sin(about), 0);
  walk.t_s = to_s + 1.2;
  while (walk.t_s < 54) go(view(1.0, 0.5, 0.4), 0.35, 0.5);
  Story story;
  story.lost.push_back({from_s, to_s});
  story.curve = [=](double t_s) {
    Isometry3d T = hand->at(t_s);
    if (t_s <= from_s || t_s >= to_s) return T;
    constexpr double kSwell_s = 0.25;
    const double swell = blend((t_s - from_s) / kSwell_s) * blend((to_s - t_s) / kSwell_s);
    const double angle = amplitude * swell * std::sin(omega * (t_s - 0.5 * (from_s + to_s)));
    T.linear() = T.linear() * Eigen::AngleAxisd(angle, axis).toRotationMatrix();
    return T;
  };
  return story;
}

const DesktopStory* find(const std::string& name) {
  for (const DesktopStory& story : desktop_stories())
    if (name == story.name) return &story;
  return nullptr;
}

}  // namespace

const std::vector<DesktopStory>& desktop_stories() {
  static const std::vector<DesktopStory> all = {
      {"corner2007", "18.2 m along two walls of photographs, 3 m away, round their corner, no return", 600, 480, 60, 0,
       600},
      {"desk2007", "a desk with boxes: overview, closing in, quick moves, a shake, known views again", 640, 480, 70,
       0.010, 1600}};
  return all;
}

bool is_desktop_story(const std::string& name) {
  return find(name) != nullptr;
}

Scene make_desktop_scene(const std::string& name, uint64_t seed) {
  return name == "corner2007" ? make_corner(seed) : make_scene("boxes", seed);
}

Story make_desktop_story(const std::string& name, const Stage& stage, uint64_t seed) {
  const DesktopStory* kind = find(name);
  if (kind == nullptr) return {};
  Story story = name == "corner2007" ? corner((kind->frames - 1) / kFramesPerSecond) : desk(stage, seed);
  story.move_s = name == "corner2007" ? 0.5 : kHold_s;
  return story;
}

PhoneOptions phone_for_desktop_story(const std::string& name, uint64_t seed) {
  PhoneOptions options;
  options.story = name;
  options.seed = seed;
  const DesktopStory* kind = find(name);
  if (kind == nullptr) return options;
  options.width = kind->width;
  options.height = kind->height;
  options.horizontal_fov_degrees = kind->horizontal_fov_degrees;
  options.frames_per_s = kFramesPerSecond;
  options.duration_s = kind->frames / kFramesPerSecond;
  options.exposure_s = kind->exposure_s;
  options.readout_axis = RollingShutter::Axis::kRows;
  options.readout_s = 0;
  return options;
}

}  // namespace pptam::sim
