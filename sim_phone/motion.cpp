#include "sim_phone/motion.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>
#include <vector>

#include "sim_phone/hand.h"
#include "sim_phone/random.h"

namespace pptam::sim {
namespace {

using Eigen::Isometry3d;
using Eigen::Matrix3d;

constexpr double kShaky = 4;  // the "shaky" motion's tremor, times a calm hand's: cold, tired or walking

Hand calm_story(const Stage& stage, uint64_t seed, double duration_s, double tremor, bool turn_only, double haste) {
  Random random(seed, turn_only ? 22 : 21);
  const View view = first_view(stage, random);
  Hand hand(view, seed, tremor);
  if (turn_only) hand.hold_position();
  Walk walk{stage, random, hand, view};
  walk.haste = haste;
  if (!turn_only) walk.start_sideways();
  walk.explore(duration_s, std::max(duration_s, 12.0), turn_only);
  return hand;
}

// ---- starts ----

double slant_degrees(const Isometry3d& T_wc, const Vector3d& normal) {
  return std::acos(std::clamp(-T_wc.linear().col(2).dot(normal), -1.0, 1.0)) / kDegree;
}

// The largest share of the view's area on one plane, within 2 % of the depth: a grid of rays, planes through three
// hits.
double largest_plane_share(const Scene& scene, const Isometry3d& T_wc, Random& random) {
  constexpr int kColumns = 15, kRows = 20, kTrials = 150;
  constexpr double kHalfWidth = 0.33, kHalfHeight = 0.44;  // tangents of the phone's half view
  std::vector<Vector3d> points;
  for (int row = 0; row < kRows; ++row) {
    for (int column = 0; column < kColumns; ++column) {
      const Vector3d ray((2 * (column + 0.5) / kColumns - 1) * kHalfWidth, (2 * (row + 0.5) / kRows - 1) * kHalfHeight,
                         1);
      const double depth = first_hit(scene, T_wc.translation(), T_wc.linear() * ray);
      if (std::isfinite(depth)) points.push_back(depth * ray);
    }
  }
  if (points.size() < 3) return 1;
  int most = 0;
  const int last = static_cast<int>(points.size()) - 1;
  for (int trial = 0; trial < kTrials; ++trial) {
    const Vector3d& a = points[static_cast<size_t>(random.integer(0, last))];
    const Vector3d& b = points[static_cast<size_t>(random.integer(0, last))];
    const Vector3d& c = points[static_cast<size_t>(random.integer(0, last))];
    const Vector3d cross = (b - a).cross(c - a);
    if (cross.norm() < 1e-6) continue;
    const Vector3d n = cross.normalized();
    int on_plane = 0;
    for (const Vector3d& p : points) on_plane += std::abs(n.dot(p - a)) < 0.02 * p.z() ? 1 : 0;
    most = std::max(most, on_plane);
  }
  return static_cast<double>(most) / (kColumns * kRows);
}

// T_wc of a first view; the normal of what it looks at.
Isometry3d start_view(const Scene& scene, bool steep, Random& random, Vector3d* normal) {
  if (scene.stage.kind == Stage::Kind::kCorner) {
    // Both walls in sight, one more slanted than the other.
    const double place = random.uniform(-0.3, 0.3);
    const double height = random.uniform(1.2, 1.45);
    const double distance = random.uniform(0.6, 1.1);
    const double offset = random.uniform(-15, 15) * kDegree;
    const double rise = random.uniform(-0.3, 0.3);
    const View view =
        wall_view(scene.stage, place, height, distance, offset, rise, random.uniform(-100, 100) * kDegree);
    const bool along_x = view.target.x() > view.target.y();  // on the wall y = 0
    *normal = along_x ? Vector3d::UnitY() : Vector3d::UnitX();
    return view.pose();
  }
  *normal = Vector3d::UnitZ();
  const bool open = scene.stage.min_height_m < 0.3;  // nothing stands on the table
  const double slant = (steep ? random.uniform(60, 70) : random.uniform(0, open ? 60 : 50)) * kDegree;
  const double distance = std::max(random.uniform(0.5, 1.5), scene.stage.min_height_m / std::cos(slant));
  const double azimuth = random.uniform(0, 2 * std::numbers::pi);
  const double roll = random.uniform(-180, 180) * kDegree;
  const double reach = open ? 0.25 : 0.12;
  const double x = random.uniform(-reach, reach);
  const double y = random.uniform(-reach, reach);
  const Vector3d away(std::sin(slant) * std::cos(azimuth), std::sin(slant) * std::sin(azimuth), std::cos(slant));
  Isometry3d T = Isometry3d::Identity();
  T.linear() = Eigen::Quaterniond::FromTwoVectors(Vector3d::UnitZ(), -away).toRotationMatrix() *
               Eigen::AngleAxisd(roll, Vector3d::UnitZ()).toRotationMatrix();
  T.translation() = Vector3d(x, y, 0) + distance * away;
  return T;
}

// Moves relative to the first view: camera centre and rotation vector in its frame.
struct Offset {
  Vector3d position = Vector3d::Zero();
  Vector3d rotation = Vector3d::Zero();
};
struct OffsetMove {
  double start_s = 0;
  double length_s = 1;
  Offset step;
};

class StartingHand {
 public:
  StartingHand(const Isometry3d& first, uint64_t seed) : first_(first) {
    Random random(seed, 31);
    for (int axis = 0; axis < 3; ++axis) {
      position_.emplace_back(kSway_m, 0.2, 0.7, random);
      position_.emplace_back(kTremor_m, 8.0, 12.0, random);
      rotation_.emplace_back(kSway_rad, 0.2, 0.7, random);
      rotation_.emplace_back(kTremor_rad, 8.0, 12.0, random);
    }
  }
  void add(const OffsetMove& move) { moves_.push_back(move); }
  void hold_position_until(double t_s) { released_s_ = t_s; }

  Isometry3d at(double t) const {
    Offset sum;
    for (const OffsetMove& move : moves_) {
      if (t <= move.start_s) continue;
      const double share = blend((t - move.start_s) / move.length_s);
      sum.position += share * move.step.position;
      sum.rotation += share * move.step.rotation;
    }
    constexpr double kRelease_s = 0.5;
    const double freedom = released_s_ > 0 ? blend((t - released_s_) / kRelease_s) : 1;
    for (size_t i = 0; i < position_.size(); ++i) {
      sum.position[static_cast<Eigen::Index>(i / 2)] += freedom * position_[i].at(t);
      sum.rotation[static_cast<Eigen::Index>(i / 2)] += rotation_[i].at(t);
    }
    Isometry3d T = first_;
    T.translation() += first_.linear() * sum.position;
    const double angle = sum.rotation.norm();
    if (angle > 0) T.linear() = T.linear() * Eigen::AngleAxisd(angle, sum.rotation / angle).toRotationMatrix();
    return T;
  }

 private:
  Isometry3d first_;
  std::vector<OffsetMove> moves_;
  std::vector<Wobble> position_, rotation_;  // two of each axis
  double released_s_ = 0;
};

// The first view: of a cluttered scene one in which no plane dominates, if such a view is found. Fills in what start
// says of it.
Isometry3d choose_start_view(const Scene& scene, bool steep, Random& random, Start* start) {
  constexpr double kMaxShare = 0.55;  // a view's corners are spread otherwise than its area: leave room below 60 %
  Isometry3d first = start_view(scene, steep, random, &start->normal);
  start->plane_share = largest_plane_share(scene, first, random);
  for (int attempt = 0; scene.stage.cluttered && attempt < 40 && start->plane_share > kMaxShare; ++attempt) {
    Vector3d normal;
    const Isometry3d other = start_view(scene, false, random, &normal);
    const double share = largest_plane_share(scene, other, random);
    if (share >= start->plane_share) continue;
    first = other;
    start->normal = normal;
    start->plane_share = share;
  }
  start->distance_m = first_hit(scene, first.translation(), first.linear().col(2));
  if (!std::isfinite(start->distance_m)) start->distance_m = 1;
  start->slant_deg = slant_degrees(first, start->normal);
  return first;
}

// One move after the other, each told by where it leads.
struct StartingWalk {
  Random& random;
  StartingHand& hand;
  Offset now;
  double t_s = 0;

  void move_to(const Offset& target, double length_s) {
    hand.add({t_s, length_s, {target.position - now.position, target.rotation - now.rotation}});
    now = target;
    t_s += length_s;
  }

  // On the spot, and sometimes back; returns the angle in degrees.
  double turn() {
    const double angle = random.uniform(8, 30);
    const double about = random.uniform(0, 2 * std::numbers::pi);
    const Vector3d axis(std::cos(about), std::sin(about), random.uniform(-0.5, 0.5));
    Offset turned;
    turned.rotation = angle * kDegree * axis.normalized();
    const double turn_s = std::max(0.8, 15.0 / 8 * angle * kDegree / (random.uniform(0.6, 1.2) * kMaxTurn));
    move_to(turned, turn_s);
    t_s += random.uniform(0, 0.5);
    if (random.chance(0.5)) {
      turned.rotation *= random.uniform(0, 0.3);
      move_to(turned, turn_s);
      t_s += random.uniform(0, 0.5);
    }
    hand.hold_position_until(t_s);
    return angle;
  }
};

// Explores, and is back at the first view at the end, without unrest, so that it can be told again and again.
MotionCurve lap(const Stage& stage, uint64_t seed, double duration_s) {
  constexpr double kExploredShare = 0.7, kQuiet_s = 1;
  Random random(seed, 22);
  const View first = first_view(stage, random);
  const auto hand = std::make_shared<Hand>(first, seed, 1.0);
  Walk walk{stage, random, *hand, first};
  walk.start_sideways();
  walk.explore(kExploredShare * duration_s, kExploredShare * duration_s);
  walk.move_to(first, std::max(duration_s - walk.t_s, comfortable_time(walk.view, first - walk.view, kMaxSpeed)));
  return [hand, duration_s](double t_s) {
    const double amount = blend(t_s / kQuiet_s) * blend((duration_s - t_s) / kQuiet_s);
    return hand->unrest().applied(hand->view_at(t_s).pose(), t_s, amount);
  };
}

}  // namespace

std::vector<std::string> start_names() {
  return {"start", "steep_start", "turn_start"};
}

Start make_start(const std::string& name, const Scene& scene, uint64_t seed) {
  constexpr double kStory_s = 20;
  Random random(seed, 30);
  Start start;
  const Isometry3d first = choose_start_view(scene, name == "steep_start", random, &start);
  const double depth = start.distance_m;
  const auto hand = std::make_shared<StartingHand>(first, seed);
  StartingWalk walk{random, *hand, {}, random.uniform(0.5, 1.0)};
  if (name == "turn_start") start.turned_deg = walk.turn();

  // Sideways, the look-at point following in part; the axis that turns the view after a shift along d is z x d.
  const Offset base = walk.now;
  start.move_s = walk.t_s;
  start.length_m = random.uniform(0.08, 0.20);
  start.direction_deg = random.uniform(0, 360);
  const double follow = random.uniform(0.2, 1.0);
  const auto offset_at = [&](const Vector3d& shift, double wander_deg) {
    Offset offset = base;
    // In the turned camera's frame: its own sideways.
    const double angle = base.rotation.norm();
    const Eigen::Matrix3d R =
        angle > 0 ? Eigen::AngleAxisd(angle, base.rotation / angle).toRotationMatrix() : Matrix3d::Identity();
    offset.position += R * shift;
    const double back = follow / depth;
    offset.rotation += Vector3d(back * shift.y(), -back * shift.x(), 0);
    for (int axis = 0; axis < 3; ++axis) offset.rotation[axis] += random.uniform(-wander_deg, wander_deg) * kDegree;
    return offset;
  };
  const double direction = start.direction_deg * kDegree;
  Vector3d shift = start.length_m * Vector3d(std::cos(direction), std::sin(direction), 0);
  shift.z() = start.length_m * random.uniform(-0.2, 0.2);
  const double speed = random.uniform(0.08, 0.25);  // m/s at the peak
  walk.move_to(offset_at(shift, 3), std::max(0.8, 15.0 / 8 * start.length_m / speed));
  start.move_end_s = walk.t_s;
  walk.t_s += random.uniform(0.2, 0.6);
  while (walk.t_s < kStory_s) {  // stays near by
    const double angle = random.uniform(0, 2 * std::numbers::pi);
    const double radius = start.length_m * random.uniform(0.5, 1.5);
    const Vector3d next(radius * std::cos(angle), radius * std::sin(angle), start.length_m * random.uniform(-0.3, 0.3));
    const Vector3d step = next - (walk.now.position - base.position);
    walk.move_to(offset_at(next, 5), std::max(0.8, 15.0 / 8 * step.norm() / (random.uniform(0.6, 1.0) * kMaxSpeed)));
    if (random.chance(0.35)) walk.t_s += random.uniform(0.2, 0.6);
  }
  start.curve = [hand](double t_s) { return hand->at(t_s); };
  return start;
}

std::vector<std::string> motion_names() {
  return {"calm", "shaky", "still", "pure_rotation", "lap"};
}

MotionCurve make_motion(const std::string& name, const Stage& stage, uint64_t seed, double duration_s, double haste) {
  if (name == "still") {
    Random random(seed, 21);
    Isometry3d T = first_view(stage, random).pose();
    return [T](double) { return T; };
  }
  if (name == "lap") return lap(stage, seed, duration_s);
  const auto hand = std::make_shared<const Hand>(
      calm_story(stage, seed, duration_s, name == "shaky" ? kShaky : 1.0, name == "pure_rotation", haste));
  return [hand](double t_s) { return hand->at(t_s); };
}

}  // namespace pptam::sim
