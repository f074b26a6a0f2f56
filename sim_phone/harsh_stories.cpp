#include "sim_phone/harsh_stories.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <utility>

#include "sim_phone/bystanders.h"
#include "sim_phone/hand.h"
#include "sim_phone/random.h"

namespace pptam::sim {
namespace {

using Eigen::Isometry3d;

// Of a sine's amplitude, what is left in the mean over an exposure.
double left_after(double exposure_s, double hz) {
  const double half = std::numbers::pi * exposure_s * hz;
  return std::sin(half) / half;
}

MotionCurve calm_curve(const View& first, const Stage& stage, Random& random, uint64_t seed) {
  const auto hand = std::make_shared<Hand>(first, seed, 1.0);
  Walk walk{stage, random, *hand, first};
  walk.start_sideways();
  walk.explore(20, 20);
  return [hand](double t_s) { return hand->at(t_s); };
}

// ---- a lamp on the mains is switched on when there is a map ----

void lamp_on(const Stage& stage, Random& random, uint64_t seed, Story* story) {
  story->curve = calm_curve(first_view(stage, random), stage, random, seed);
  const double on_s = random.uniform(5, 8), off_s = on_s + random.uniform(6, 8);
  const double daylight = random.uniform(0.5, 0.8), lamp = random.uniform(0.3, 0.6);
  const double depth = random.uniform(0.3, 0.9), hz = random.chance(0.5) ? 100 : 120;
  story->light = [=](double t_s) {
    constexpr double kWarm_s = 0.02;
    const double on = blend((t_s - on_s) / kWarm_s) - blend((t_s - off_s) / kWarm_s);
    return daylight + on * lamp * (1 + depth * std::sin(2 * std::numbers::pi * hz * t_s));
  };
}

// ---- round a small place: there is nothing to be seen elsewhere ----

void round_the_middle(const Stage& stage, Random& random, uint64_t seed, Story* story) {
  const auto view = [&] {
    const double azimuth = random.uniform(-35, 35) * kDegree;
    const double slant = random.uniform(15, 42) * kDegree;
    const double distance = random.uniform(0.45, 0.6);
    const double roll = random.uniform(-10, 10) * kDegree;
    const double x = random.uniform(-0.03, 0.03);
    const double y = random.uniform(-0.03, 0.03);
    return table_view(stage, azimuth, slant, distance, {x, y, 0}, roll);
  };
  const View first = view();
  const auto hand = std::make_shared<Hand>(first, seed, 1.0);
  Walk walk{stage, random, *hand, first};
  walk.start_sideways();
  while (walk.t_s < 20) {
    const View next = view();
    walk.move_to(next, comfortable_time(walk.view, next - walk.view, random.uniform(0.6, 1) * kMaxSpeed));
  }
  story->curve = [hand](double t_s) { return hand->at(t_s); };
}

void from_a_slanted_view(const Stage& stage, Random& random, uint64_t seed, Story* story) {
  const double azimuth = random.uniform(-20, 20) * kDegree;
  const double slant = random.uniform(48, 60) * kDegree;
  const double distance = random.uniform(0.55, 0.7);
  const double roll = random.uniform(-10, 10) * kDegree;
  story->curve = calm_curve(table_view(stage, azimuth, slant, distance, {0, 0, 0}, roll), stage, random, seed);
}

// ---- pans on the spot, 60 to 100 degrees/s at the peak, over what the map does not have, and back ----

void pan_on_the_spot(const Stage& stage, Random& random, uint64_t seed, Story* story) {
  const View first = first_view(stage, random);
  const auto hand = std::make_shared<Hand>(first, seed, 1.0);
  Walk walk{stage, random, *hand, first};
  walk.start_sideways();
  walk.explore(4.5, 20);
  // From here a turn about the vertical stays on the table, or leads from one wall to the other.
  const bool table = stage.kind == Stage::Kind::kTable;
  const double azimuth = random.uniform(-10, 10) * kDegree;
  const double slant = random.uniform(40, 48) * kDegree;
  const double distance = table ? random.uniform(0.5, 0.6) : random.uniform(0.7, 0.9);
  const View base = table ? table_view(stage, azimuth, slant, distance, {0, 0, 0}, 0)
                          : wall_view(stage, random.uniform(0.9, 1.1), 1.3, distance, azimuth, 0, 0);
  walk.move_to(base, comfortable_time(walk.view, base - walk.view, 0.9 * kMaxSpeed));
  story->pan_depth_m = (base.position - base.target).norm();
  struct Turn {
    double start_s, length_s, angle;
  };
  std::vector<Turn> turns;
  double t = walk.t_s + 0.5;
  // On walls towards the corner at the origin alone: there is nothing on the other side.
  const Vector3d ahead = base.target - base.position, corner = -base.position;
  const double to_corner = ahead.cross(corner).z() > 0 ? 1.0 : -1.0;
  double side = random.sign();
  for (int i = 0; i < 2; ++i, side = -side) {
    const double angle = (table ? side * random.uniform(60, 100) : to_corner * random.uniform(50, 80)) * kDegree;
    const double from_s = t;
    for (const double way : {1.0, -1.0}) {
      const double length_s = 15.0 / 8 * std::abs(angle) / (random.uniform(60, 100) * kDegree);
      turns.push_back({t, length_s, way * angle});
      t += length_s + random.uniform(0.2, 0.8);
    }
    story->pans.push_back({from_s, turns.back().start_s + turns.back().length_s});
    t += 0.8;
  }
  walk.t_s = t;
  walk.explore(27, 27);
  story->curve = [hand, turns](double t_s) {
    double angle = 0;
    for (const Turn& turn : turns) angle += turn.angle * blend((t_s - turn.start_s) / turn.length_s);
    Isometry3d T = hand->at(t_s);
    T.linear() = Eigen::AngleAxisd(angle, Vector3d::UnitZ()).toRotationMatrix() * T.linear();
    return T;
  };
}

// ---- a camera at rest before which a thing is carried about ----

void carried_thing(const Stage& stage, Random& random, uint64_t seed, Story* story) {
  Isometry3d T_wc = first_view(stage, random).pose();
  // To the table along the optical axis.
  const double depth_m = -T_wc.translation().z() / T_wc.linear()(2, 2);
  story->curve = [T_wc](double) { return T_wc; };
  story->movers.push_back(make_carried_thing(T_wc, depth_m, kHold_s, seed));
}

}  // namespace

Harshness harshness_of_story(const std::string& name, uint64_t seed) {
  Random random(seed, 55);
  Harshness harsh;
  // Of the bands in the picture.
  const auto bands = [&](double exposure_s) {
    harsh.flicker = random.uniform(0.05, 0.3) / left_after(exposure_s, harsh.mains_hz);
  };
  if (name == "reflections") harsh.gloss = random.uniform(0.04, 0.08);
  if (name == "people" || name == "passers_by") harsh.people = random.uniform(0.4, 0.6);
  if (name == "bands_120" || (name == "bands_30fps" && random.chance(0.5))) harsh.mains_hz = 120;
  if (name == "bands_100" || name == "bands_120" || name == "bands_30fps") bands(kBandsExposure_s);
  if (name == "compressed") harsh.compression = random.uniform(1, 3);
  if (name == "breathing") harsh.breathing = random.uniform(0.004, 0.01);
  if (name == "dim_room") harsh.dimness = random.uniform(0.7, 0.85);
  if (name == "brisk") harsh.haste = random.uniform(3, 4);
  if (name == "brisk_dim") {
    harsh.haste = random.uniform(2.5, 3.5);
    harsh.dimness = random.uniform(0.4, 0.6);
  }
  if (name == "uneven" || name == "bare_walls") harsh.bare = random.uniform(0.4, 0.6);
  if (name == "uneven") harsh.repeats = random.uniform(0.2, 0.5);
  if (name == "life") {  // a little of all
    harsh.bare = 0.3;
    harsh.gloss = 0.04;
    harsh.people = 0.3;
    harsh.flicker = 0.1;
    harsh.compression = 1;
    harsh.breathing = 0.004;
    harsh.dimness = 0.3;
    harsh.haste = 0.8;
  }
  return harsh;
}

bool tell_harsh_story(const std::string& name, const Stage& stage, Random& random, uint64_t seed, Story* story) {
  using Tell = void (*)(const Stage&, Random&, uint64_t seed, Story* story);
  static const std::map<std::string, Tell> tellers = {{"lamp_on", lamp_on},
                                                      {"postcards", round_the_middle},
                                                      {"all_alike", round_the_middle},
                                                      {"slanted_sparse", from_a_slanted_view},
                                                      {"slanted_tiles", from_a_slanted_view},
                                                      {"pan", pan_on_the_spot},
                                                      {"pan_corner", pan_on_the_spot},
                                                      {"carried_thing", carried_thing}};
  const auto teller = tellers.find(name);
  if (teller == tellers.end()) return false;
  teller->second(stage, random, seed, story);
  return true;
}

}  // namespace pptam::sim
