#include "sim_phone/story.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "sim_phone/bystanders.h"
#include "sim_phone/desktop_stories.h"
#include "sim_phone/hand.h"
#include "sim_phone/harsh_stories.h"
#include "sim_phone/lamp_and_focus.h"
#include "sim_phone/model_stories.h"
#include "sim_phone/paint.h"
#include "sim_phone/random.h"

namespace pptam::sim {
namespace {

using Eigen::Isometry3d;

constexpr double kExposure_s = 0.030;
constexpr bool kHarsh = true;

// Random streams: one for each story, so that no two begin alike.
constexpr uint64_t kFirstStream = 60;

std::shared_ptr<Hand> calm_hand(const View& first, uint64_t seed) {
  return std::make_shared<Hand>(first, seed, 1.0);
}

MotionCurve curve_of(std::shared_ptr<const Hand> hand) {
  return [hand = std::move(hand)](double t_s) { return hand->at(t_s); };
}

// ---- orbit: round the table's middle, to one side, far to the other, and back ----

Story orbit(const Stage& stage, Random& random, uint64_t seed) {
  const double roll = random.uniform(-6, 6) * kDegree;
  const double slant = random.uniform(38, 48) * kDegree;
  const double distance = random.uniform(0.5, 0.62);
  const double x = random.uniform(-0.05, 0.05);
  const double y = random.uniform(-0.05, 0.05);
  const Vector3d target(x, y, 0);
  struct Turn {
    double start_s, length_s, azimuth, slant;
  };
  std::vector<Turn> turns;
  double t = kHold_s;
  double azimuth = 0, tilt = 0;
  const double side = random.sign();
  const double goals[] = {side * random.uniform(22, 30), side * random.uniform(55, 75), -side * random.uniform(55, 75),
                          0.0};
  for (const double goal_deg : goals) {
    const double goal = goal_deg * kDegree;
    const double goal_tilt = random.uniform(-6, 6) * kDegree;
    // Round a circle of distance sin(slant) at up to 0.2 m/s and 24 degrees/s.
    const double rate = std::min(kMaxTurn, kMaxSpeed / (distance * std::sin(slant))) * random.uniform(0.75, 1);
    const double length = std::max(1.5, 15.0 / 8 * std::abs(goal - azimuth) / rate);
    turns.push_back({t, length, goal - azimuth, goal_tilt - tilt});
    azimuth = goal;
    tilt = goal_tilt;
    t += length + random.uniform(0, 0.4);
  }
  const Unrest unrest(seed, 1);
  Story story;
  story.move_s = kHold_s;
  story.curve = [=](double t_s) {
    double around = 0, over = slant;
    for (const Turn& turn : turns) {
      const double share = blend((t_s - turn.start_s) / turn.length_s);
      around += share * turn.azimuth;
      over += share * turn.slant;
    }
    return unrest.applied(table_view(stage, around, over, distance, target, roll).pose(), t_s);
  };
  return story;
}

// ---- explore and return: along the table to one side and back the same way ----

Story explore_and_return(const Stage& stage, Random& random, uint64_t seed) {
  const View first = first_view(stage, random);
  const std::shared_ptr<Hand> hand = calm_hand(first, seed);
  Walk walk{stage, random, *hand, first};
  walk.start_sideways();
  const double direction =
      stage.azimuth_rad + 0.5 * std::numbers::pi * random.sign() + random.uniform(-30, 30) * kDegree;
  const Vector3d along(std::cos(direction), std::sin(direction), 0);
  std::vector<View> way;
  constexpr int kSteps = 4;
  for (int i = 1; i <= kSteps; ++i) {
    const double azimuth = random.uniform(-18, 18) * kDegree;
    const double slant = random.uniform(22, 40) * kDegree;
    const double distance = random.uniform(0.44, 0.6);
    const double roll = random.uniform(-8, 8) * kDegree;
    way.push_back(table_view(stage, azimuth, slant, distance, 0.14 * i * along, roll));
  }
  const auto go = [&](const View& to) {
    View near = to;
    for (int axis = 0; axis < 3; ++axis) near.position[axis] += random.uniform(-0.015, 0.015);
    walk.move_to(near, comfortable_time(walk.view, near - walk.view, random.uniform(0.85, 1) * kMaxSpeed));
    walk.t_s += random.chance(0.3) ? random.uniform(0.2, 0.5) : -0.12;
  };
  for (const View& view : way) go(view);
  for (int i = kSteps - 2; i >= 0; --i) go(way[static_cast<size_t>(i)]);
  go(first);
  Story story;
  story.curve = curve_of(hand);
  return story;
}

// ---- zoom: towards and away along the optical axis ----

Story zoom(const Stage& stage, Random& random, uint64_t seed) {
  constexpr double kNearest_m = 0.3, kFarthest_m = 1.26;  // the unrest changes the distance by 2 % at most
  const double azimuth = random.uniform(-15, 15) * kDegree;
  const double slant = random.uniform(12, 24) * kDegree;
  const double roll = random.uniform(-6, 6) * kDegree;
  const double x = random.uniform(-0.08, 0.08);
  const double y = random.uniform(-0.08, 0.08);
  const double begin_m = random.uniform(0.5, 0.65);
  const View first = table_view(stage, azimuth, slant, begin_m, {x, y, 0}, roll);
  const std::shared_ptr<Hand> hand = calm_hand(first, seed);
  Walk walk{stage, random, *hand, first};
  walk.start_sideways();
  walk.t_s += random.uniform(0.3, 0.8);
  // log distance by blends; at most a factor of 1.5 a second
  struct Leg {
    double start_s, length_s, log_step;
  };
  std::vector<Leg> legs;
  const double after_start_m = (walk.view.position - walk.view.target).norm();
  double log_distance = std::log(after_start_m);
  double t = walk.t_s;
  const bool near_first = random.chance(0.5);
  for (int i = 0; i < 4; ++i) {
    const double goal = std::log((i % 2 == 0) == near_first ? kNearest_m : kFarthest_m);
    const double length = std::max(1.5, std::abs(goal - log_distance) / std::log(random.uniform(1.35, 1.5)));
    legs.push_back({t, length, goal - log_distance});
    log_distance = goal;
    t += length + random.uniform(0, 0.4);
  }
  Story story;
  story.curve = [hand, legs](double t_s) {
    double log_factor = 0;
    for (const Leg& leg : legs) log_factor += leg.log_step * blend((t_s - leg.start_s) / leg.length_s);
    View view = hand->view_at(t_s);
    view.position = view.target + std::exp(log_factor) * (view.position - view.target);
    return hand->unrest().applied(view.pose(), t_s);
  };
  return story;
}

// ---- shake: twice, at 200 degrees/s and more ----

Story shake(const Stage& stage, Random& random, uint64_t seed) {
  const View first = first_view(stage, random);
  const std::shared_ptr<Hand> hand = calm_hand(first, seed);
  Walk walk{stage, random, *hand, first};
  walk.start_sideways();
  struct Shaking {
    double from_s, to_s, amplitude, omega;
    Vector3d axis;
  };
  std::vector<Shaking> all;
  Story story;
  for (const double until_s : {7.0, 13.0}) {
    walk.explore(until_s, 20);
    walk.t_s += 0.3;
    Shaking s{};
    s.from_s = walk.t_s;
    s.to_s = s.from_s + random.uniform(1.2, 1.6);
    s.omega = 2 * std::numbers::pi * random.uniform(2.2, 3.2);
    s.amplitude = random.uniform(208, 240) * kDegree / s.omega;
    const double about = random.uniform(0, 2 * std::numbers::pi);
    s.axis = Vector3d(std::cos(about), std::sin(about), random.uniform(-0.5, 0.5)).normalized();
    all.push_back(s);
    story.lost.push_back({s.from_s, s.to_s});
    walk.t_s = s.to_s + random.uniform(1.2, 1.8);  // then holds the view for a while
  }
  walk.explore(22, 20);
  story.curve = [hand, all](double t_s) {
    Isometry3d T = hand->at(t_s);
    for (const Shaking& s : all) {
      if (t_s <= s.from_s || t_s >= s.to_s) continue;
      constexpr double kSwell_s = 0.25;
      const double swell = blend((t_s - s.from_s) / kSwell_s) * blend((s.to_s - t_s) / kSwell_s);
      // The phase is such that the middle of the shaking is at full speed.
      const double angle = s.amplitude * swell * std::sin(s.omega * (t_s - 0.5 * (s.from_s + s.to_s)));
      T.linear() = T.linear() * Eigen::AngleAxisd(angle, s.axis).toRotationMatrix();
    }
    return T;
  };
  return story;
}

// ---- cut: a covered lens, later a pause of the camera; each time the view is another known one afterwards ----

Story cut(const Stage& stage, Random& random, uint64_t seed) {
  const View first = first_view(stage, random);
  const std::shared_ptr<Hand> hand = calm_hand(first, seed);
  Walk walk{stage, random, *hand, first};
  walk.start_sideways();
  const double start_over_s = walk.t_s;
  walk.explore(24, 20);
  struct Piece {
    double from_s, source_s;  // shows the moves' view of source_s at from_s, and goes on
    View offset;
  };
  std::vector<Piece> pieces = {{0, 0, {}}};
  Story story;
  double known_until_s = 0;  // of the moves
  double t = random.uniform(7.5, 9);
  for (int i = 0; i < 2; ++i) {
    const double gap = i == 0 ? random.uniform(0.35, 0.9) : random.uniform(0.4, 1.2);
    const double now_source = pieces.back().source_s + t - pieces.back().from_s;
    known_until_s = std::max(known_until_s, now_source);
    // Among some known moments: the one that looks most unlike the present view.
    double best_source = start_over_s, best_change = -1;
    for (int attempt = 0; attempt < 12; ++attempt) {
      const double source = random.uniform(start_over_s, known_until_s - 1);
      const View a = hand->view_at(now_source), b = hand->view_at(source);
      const double change = (a.target - b.target).norm() + (a.position - b.position).norm();
      if (change > best_change) {
        best_change = change;
        best_source = source;
      }
    }
    View offset;
    for (int axis = 0; axis < 3; ++axis) {
      offset.position[axis] = random.uniform(-0.015, 0.015);
      if (axis < 2) offset.target[axis] = random.uniform(-0.015, 0.015);
    }
    offset.roll = random.uniform(-2, 2) * kDegree;
    story.lost.push_back({t, t + gap});
    if (i == 1) story.no_frames.push_back({t, t + gap});
    pieces.push_back({t + 0.5 * gap, best_source, offset});
    t += gap + random.uniform(4, 5);
  }
  const Interval covered = story.lost.front();
  story.light = [covered](double t_s) {
    constexpr double kSlide_s = 0.06;  // a finger slides over the lens
    return 1 - 0.999 * blend((t_s - covered.from_s) / kSlide_s) * blend((covered.to_s - t_s) / kSlide_s);
  };
  story.curve = [hand, pieces](double t_s) {
    const Piece* piece = &pieces.front();
    for (const Piece& next : pieces) {
      if (t_s >= next.from_s) piece = &next;
    }
    const View view = hand->view_at(piece->source_s + t_s - piece->from_s) + piece->offset;
    return hand->unrest().applied(view.pose(), t_s);
  };
  return story;
}

// ---- static: a start, some moves, then a tripod, and a step ----

Story standing_still(const Stage& stage, Random& random, uint64_t seed) {
  // The last view: 1 m from the plane along the optical axis, slanted by 30 to 45 degrees.
  const double azimuth = random.uniform(-10, 10) * kDegree;
  const double slant = random.uniform(30, 45) * kDegree;
  const double roll = random.uniform(-6, 6) * kDegree;
  const double x = random.uniform(-0.1, 0.1);
  const double y = random.uniform(-0.1, 0.1);
  const View last = table_view(stage, azimuth, slant, 1.0, {x, y, 0}, roll);
  const auto near = [&](double reach) {
    View view = last;
    for (int axis = 0; axis < 3; ++axis) {
      view.position[axis] += random.uniform(-reach, reach);
      if (axis < 2) view.target[axis] += random.uniform(-0.5, 0.5) * reach;
    }
    return view;
  };
  const View first = near(0.06);
  const std::shared_ptr<Hand> hand = calm_hand(first, seed);
  Walk walk{stage, random, *hand, first};
  walk.start_sideways();
  for (int i = 0; i < 2; ++i) {
    const View next = near(0.15);
    walk.move_to(next, comfortable_time(walk.view, next - walk.view, 0.9 * kMaxSpeed));
  }
  walk.move_to(last, comfortable_time(walk.view, last - walk.view, 0.8 * kMaxSpeed));
  Standstill still;
  still.from_s = walk.t_s + 0.5;  // the unrest dies away
  still.step_from_s = still.from_s + 6;
  still.step_to_s = still.step_from_s + 0.2;
  const double to = random.uniform(0, 2 * std::numbers::pi);
  const Vector3d step = 0.05 * Vector3d(std::cos(to), std::sin(to), 0);  // sideways, in the camera
  const double about = random.uniform(0, 2 * std::numbers::pi);
  const Vector3d axis(std::cos(about), std::sin(about), 0);
  Story story;
  story.standstill = still;
  story.curve = [hand, still, step, axis](double t_s) {
    const double rest = blend((t_s - (still.from_s - 0.5)) / 0.5);
    // After the rest has begun nothing depends on the time but the step.
    Isometry3d T = hand->unrest().applied(hand->view_at(std::min(t_s, still.from_s)).pose(),
                                          std::min(t_s, still.from_s), 1 - rest);
    const double share = blend((t_s - still.step_from_s) / (still.step_to_s - still.step_from_s));
    if (share > 0) {
      T.translation() += T.linear() * (share * step);
      T.linear() = T.linear() * Eigen::AngleAxisd(share * 5 * kDegree, axis).toRotationMatrix();
    }
    return T;
  };
  return story;
}

// ---- fast pans: on the spot, 45 to 75 degrees/s at the peak, there and back ----

Story fast_pans(const Stage& stage, Random& random, uint64_t seed) {
  const View first = first_view(stage, random);
  const std::shared_ptr<Hand> hand = calm_hand(first, seed);
  Walk walk{stage, random, *hand, first};
  walk.start_sideways();
  walk.explore(6, 20);
  struct Pan {
    double start_s, length_s, angle;
    Vector3d axis;
  };
  std::vector<Pan> pans;
  while (walk.t_s < 20) {
    double t = walk.t_s + random.uniform(0.7, 1.0);  // the last move has ended
    const double angle = random.uniform(12, 20) * kDegree;
    const double about = random.uniform(0, 2 * std::numbers::pi);
    const Vector3d axis(std::cos(about), std::sin(about), 0);
    for (const double way : {1.0, -1.0}) {
      const double rate = random.uniform(45, 75) * kDegree;
      pans.push_back({t, 15.0 / 8 * angle / rate, way * angle, axis});
      t += pans.back().length_s + random.uniform(0.05, 0.4);
    }
    walk.t_s = t;
    walk.explore(walk.t_s + 0.1, 20);  // one calm move to somewhere else
  }
  Story story;
  story.curve = [hand, pans](double t_s) {
    Isometry3d T = hand->at(t_s);
    for (const Pan& pan : pans) {
      const double angle = pan.angle * blend((t_s - pan.start_s) / pan.length_s);
      T.linear() = T.linear() * Eigen::AngleAxisd(angle, pan.axis).toRotationMatrix();
    }
    return T;
  };
  return story;
}

// A calm story that begins at the given view.
Story calm_from(const View& first, const Stage& stage, Random& random, uint64_t seed) {
  const std::shared_ptr<Hand> hand = calm_hand(first, seed);
  Walk walk{stage, random, *hand, first};
  walk.start_sideways();
  walk.explore(20, 20);
  Story story;
  story.curve = curve_of(hand);
  return story;
}

Story slanted_start(const Stage& stage, Random& random, uint64_t seed) {
  const double azimuth = random.uniform(-20, 20) * kDegree;
  const double slant = random.uniform(48, 60) * kDegree;
  const double distance = random.uniform(0.55, 0.7);
  const double roll = random.uniform(-10, 10) * kDegree;
  return calm_from(table_view(stage, azimuth, slant, distance, {0, 0, 0}, roll), stage, random, seed);
}

// ---- a hand ----

Surface piece_of_hand(double width_m, double height_m, const Vector3d& origin, const Vector3d& u, const Vector3d& v,
                      Random& random) {
  constexpr double kTexel_m = 0.0005;
  Canvas canvas(width_m, height_m, kTexel_m);
  skin(canvas, random);
  return surface_of(canvas, origin, u, v, 1);
}

Story hand_passing(const Stage& stage, Random& random, uint64_t seed) {
  Story story = calm_from(first_view(stage, random), stage, random, seed);
  const double turn = random.uniform(0, 2 * std::numbers::pi);  // of the arm in the image
  const Vector3d across(std::cos(turn), std::sin(turn), 0);
  const Vector3d along(-std::sin(turn), std::cos(turn), 0);  // from the fingertips to the elbow
  auto hand = std::make_shared<Occluder>();
  const auto add = [&](double width_m, double height_m, double middle, double top) {
    const Vector3d origin = (middle - 0.5 * width_m) * across + top * along;
    hand->surfaces.push_back(piece_of_hand(width_m, height_m, origin, across, along, random));
  };
  add(0.075, 0.085, 0, -0.04);
  for (int finger = 0; finger < 4; ++finger) {
    const double length = 0.06 + (finger == 1 || finger == 2 ? 0.015 : 0);
    add(0.015, length, -0.029 + 0.0193 * finger, -0.04 - length);
  }
  add(0.055, 0.35, 0, 0.045);
  struct Pass {
    double middle_s, speed, aside, depth;
  };
  std::vector<Pass> passes;
  double t = random.uniform(6, 7);
  double way = random.sign();
  for (int i = 0; i < 3; ++i, way = -way) {
    const double speed = random.uniform(0.18, 0.32);
    const double aside = random.uniform(-0.03, 0.03);
    passes.push_back({t, way * speed, aside, random.uniform(0.24, 0.3)});
    constexpr double kReach_m = 0.21;  // half of the view's diagonal at 0.3 m and half of a palm
    story.obstructed.push_back({t - kReach_m / speed, t + kReach_m / speed});
    t += random.uniform(3.5, 4.5);
  }
  hand->position = [passes, across, along](double t_s) -> Vector3d {
    const Pass* near = &passes.front();
    for (const Pass& pass : passes) {
      if (std::abs(t_s - pass.middle_s) < std::abs(t_s - near->middle_s)) near = &pass;
    }
    return near->speed * (t_s - near->middle_s) * across + near->aside * along + Vector3d(0, 0, near->depth);
  };
  story.occluder = hand;
  return story;
}

// ---- lamps: switched, flickering, and on the mains ----

Story lamps(const Stage& stage, Random& random, uint64_t seed) {
  Story story = calm_from(first_view(stage, random), stage, random, seed);
  struct Step {
    double at_s, light;
  };
  std::vector<Step> steps = {{0, random.uniform(0.8, 1.1)}};
  double t = random.uniform(4.5, 6);
  while (t < 18) {
    const double before = steps.back().light;
    const double next = before > 0.7 ? random.uniform(0.3, 0.55) : random.uniform(0.9, 1.4);
    steps.push_back({t, next});
    t += random.uniform(1.5, 3.5);
  }
  // A bad tube: for a second it goes on and off at random, eight times a second.
  const double burst_s = random.uniform(9, 12);
  const uint64_t tube = random.bits();
  const double ripple = random.uniform(0.05, 0.15);  // of mains at 50 Hz: 100 times a second
  story.light = [=](double t_s) {
    double light = steps.front().light;
    double from = light;
    for (const Step& step : steps) {
      if (t_s < step.at_s) break;
      constexpr double kWarm_s = 0.02;
      light = from + (step.light - from) * blend((t_s - step.at_s) / kWarm_s);
      from = step.light;
    }
    if (t_s > burst_s && t_s < burst_s + 1) {
      const uint64_t slot = static_cast<uint64_t>(8 * (t_s - burst_s));
      if (mixed(tube + slot) % 2 == 0) light *= 0.6;
    }
    return light * (1 + ripple * std::sin(2 * std::numbers::pi * 100 * t_s));
  };
  return story;
}

Story dim(const Stage& stage, Random& random, uint64_t seed) {
  Story story = calm_from(first_view(stage, random), stage, random, seed);
  // What the doubled exposure collects, of the usual: the gain rises to about three times, the noise likewise.
  const double light = random.uniform(0.3, 0.4);
  story.light = [light](double) { return light; };
  return story;
}

Story story_of_motion(const PhoneOptions& options, const Scene& scene) {
  Story story;
  const std::vector<std::string> starts = start_names();
  if (std::find(starts.begin(), starts.end(), options.motion) != starts.end()) {
    const Start start = make_start(options.motion, scene, options.seed);
    story.curve = start.curve;
    story.move_s = start.move_s;
  } else {
    story.curve = make_motion(options.motion, scene.stage, options.seed, options.duration_s, options.harsh.haste);
    story.move_s = kHold_s;
  }
  return story;
}

}  // namespace

const std::vector<StoryKind>& stories() {
  static const std::vector<StoryKind> all = {
      // name, what, scene, seconds, exposure, drops, explores, loses
      {"desk_calm", "a desk, explored calmly", "desk", 20, kExposure_s, 0, true, false},
      {"orbit", "round boxes on a table, 110 to 150 degrees and back", "boxes", 20, kExposure_s, 0, true, false},
      {"explore_return", "0.55 m along a table with boxes, and back to the first view", "boxes", 26, kExposure_s, 0,
       true, false},
      {"two_walls", "along two papered walls, round their corner", "walls", 20, kExposure_s, 0, true, false},
      {"zoom", "towards the desk and away, distances 4 to 1", "desk", 20, kExposure_s, 0, false, false},
      {"shake", "shaken twice at over 200 degrees/s, then held still", "desk", 20, kExposure_s, 0, false, true},
      {"rotation_start", "turns on the spot first, then moves sideways", "boxes", 20, kExposure_s, 0, false, false},
      {"cut", "the lens is covered, later the camera pauses; then another known view", "desk", 20, kExposure_s, 0,
       false, true},
      {"static", "moves, then a tripod 1 m from a plane at 30 to 45 degrees, then a quick small step", "plane", 21,
       kExposure_s, 0, false, false},
      {"fast_pans", "pans at 45 to 75 degrees/s, there and back", "desk", 20, kExposure_s, 0, false, false},
      {"slanted_start", "the first view is slanted by 48 to 60 degrees", "desk", 20, kExposure_s, 0, false, false},
      {"sparse", "a plain table with one sheet of paper and few things", "sparse", 20, kExposure_s, 0, false, false},
      {"repeated", "tiles all alike, with a few unique things", "tiles", 20, kExposure_s, 0, false, false},
      {"hand", "a hand passes in front three times and covers up to half of the view", "desk", 20, kExposure_s, 0,
       false, false},
      {"lamps", "lamps are switched and flicker", "desk", 20, kExposure_s, 0, false, false},
      {"dim", "a third of the light, 60 ms exposure, a tenth of the frames dropped", "desk", 20, 0.060, 0.1, false,
       false},
      // A harsher life. The order is kept: a story's place chooses its random numbers.
      {"reflections", "glossy things mirror lamps and a window", "desk", 20, kExposure_s, 0, true, false, kHarsh},
      {"people", "arms reach over the desk, half of the time", "desk", 20, kExposure_s, 0, true, false, kHarsh},
      {"passers_by", "people pass before papered walls", "walls", 20, kExposure_s, 0, true, false, kHarsh},
      {"bands_100", "a lamp at 100 Hz makes bands of 5 to 30 %", "desk", 20, kBandsExposure_s, 0, true, false, kHarsh},
      {"bands_120", "a lamp at 120 Hz makes bands of 5 to 30 %", "desk", 20, kBandsExposure_s, 0, true, false, kHarsh},
      {"bands_30fps", "either lamp, seen at 30 frames/s, read out in 30 ms", "desk", 20, kBandsExposure_s, 0, true,
       false, kHarsh, WantedMap::kRight, Hint::kNone, 98, 30, -0.030},
      {"lamp_on", "a lamp with bands is switched on after the start, and off", "desk", 20, kBandsExposure_s, 0, true,
       false, kHarsh},
      {"compressed", "compressed in blocks, quality 17 to 50", "desk", 20, kExposure_s, 0, true, false, kHarsh},
      {"breathing", "the focus hunts and breathes", "desk", 20, kExposure_s, 0, true, false, kHarsh},
      {"dim_room", "15 to 30 % of the light, much noise", "desk", 20, kExposure_s, 0, true, false, kHarsh,
       WantedMap::kRight, Hint::kNone, 95},
      {"brisk", "explores so fast that a second replaces the view", "desk", 20, 0.010, 0, true, false, kHarsh},
      {"brisk_dim", "fast in half of the light, with an exposure of 20 ms", "desk", 20, 0.020, 0, true, false, kHarsh,
       WantedMap::kRight, Hint::kNone, 95},
      {"uneven", "half of the pages are missing, on a tablecloth whose pattern repeats", "desk", 20, kExposure_s, 0,
       true, false, kHarsh},
      {"bare_walls", "half of the posters and the ornament are missing", "walls", 20, kExposure_s, 0, true, false,
       kHarsh},
      {"postcards", "a bare table with two postcards", "postcards", 20, kExposure_s, 0, false, false, kHarsh,
       WantedMap::kRightOrRefused, Hint::kTooLittleTexture},
      {"all_alike", "tiles all alike and nothing else", "same_tiles", 20, kExposure_s, 0, false, false, kHarsh,
       WantedMap::kRightOrRefused, Hint::kTooLittleTexture},
      {"slanted_sparse", "a plain table with few things, first seen slanted by 48 to 60 degrees", "sparse", 20,
       kExposure_s, 0, false, false, kHarsh, WantedMap::kRightOrRefused, Hint::kTooLittleTexture},
      {"slanted_tiles", "tiles all alike with a few things, first seen slanted likewise", "tiles", 20, kExposure_s, 0,
       false, false, kHarsh, WantedMap::kRightOrRefused, Hint::kTooLittleTexture},
      {"pan", "pans on the spot at 60 to 100 degrees/s over what is new, and back", "desk", 27, 0.010, 0, false, false,
       kHarsh},
      {"pan_corner", "likewise from one wall to the other and back", "walls", 27, 0.010, 0, false, false, kHarsh},
      {"carried_thing", "a camera at rest before which a printed thing is carried: no map", "desk", 15, kExposure_s, 0,
       false, false, kHarsh, WantedMap::kNone},
      {"life", "a little of all that is harsh", "boxes", 20, 0.020, 0, true, false, kHarsh},
  };
  return all;
}

const StoryKind* find_story(const std::string& name) {
  for (const StoryKind& kind : stories()) {
    if (name == kind.name) return &kind;
  }
  return nullptr;
}

Story make_story(const std::string& name, const Scene& scene, uint64_t seed, const Harshness& harsh) {
  const StoryKind* kind = find_story(name);
  if (kind == nullptr) return {};
  const Stage& stage = scene.stage;
  Random random(seed, kFirstStream + static_cast<uint64_t>(kind - stories().data()));
  Story story;
  if (name == "rotation_start") {
    const Start start = make_start("turn_start", scene, seed);
    story.curve = start.curve;
    story.move_s = start.move_s;
    return story;
  }
  using Tell = Story (*)(const Stage&, Random&, uint64_t seed);
  static const std::map<std::string, Tell> tellers = {{"orbit", orbit},
                                                      {"explore_return", explore_and_return},
                                                      {"zoom", zoom},
                                                      {"shake", shake},
                                                      {"cut", cut},
                                                      {"static", standing_still},
                                                      {"fast_pans", fast_pans},
                                                      {"slanted_start", slanted_start},
                                                      {"hand", hand_passing},
                                                      {"lamps", lamps},
                                                      {"dim", dim}};
  const auto teller = tellers.find(name);
  if (teller != tellers.end()) {
    story = teller->second(stage, random, seed);
  } else if (!tell_harsh_story(name, stage, random, seed, &story)) {
    story.curve = make_motion("calm", stage, seed, kind->duration_s, harsh.haste);
  }
  story.move_s = kHold_s;
  return story;
}

Story story_of(const PhoneOptions& options, const Scene& scene) {
  const Harshness& harsh = options.harsh;
  Story story = options.story.empty()             ? story_of_motion(options, scene)
                : is_model_story(options.story)   ? make_model_story(options.story, options.seed)
                : is_desktop_story(options.story) ? make_desktop_story(options.story, scene.stage, options.seed)
                                                  : make_story(options.story, scene, options.seed, harsh);
  for (auto& mover : make_bystanders(scene.stage, harsh.people, options.seed)) story.movers.push_back(std::move(mover));
  if (const std::function<double(double)> lamp = lamp_light(harsh, options.seed)) {
    story.light =
        story.light == nullptr ? lamp : [lamp, light = story.light](double t_s) { return lamp(t_s) * light(t_s); };
  }
  return story;
}

PhoneOptions phone_for_story(const std::string& name, uint64_t seed) {
  if (is_model_story(name)) return phone_for_model_story(name, seed);
  if (is_desktop_story(name)) return phone_for_desktop_story(name, seed);
  PhoneOptions options;
  options.story = name;
  options.seed = seed;
  if (const StoryKind* kind = find_story(name)) {
    options.scene = kind->scene;
    options.duration_s = kind->duration_s;
    options.exposure_s = kind->exposure_s;
    options.drop_probability = kind->drop_probability;
    options.frames_per_s = kind->frames_per_s;
    options.readout_s = kind->readout_s;
    options.harsh = harshness_of_story(name, seed);
  }
  return options;
}

}  // namespace pptam::sim
