#include "sim_phone/motion.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <numbers>
#include <utility>
#include <vector>

#include "sim_phone/phone_camera.h"
#include "sim_phone/random.h"

namespace pptam::sim {
namespace {

using Eigen::Isometry3d;
using Eigen::Matrix3d;

constexpr double kDegree = std::numbers::pi / 180;
constexpr double kHold_s = 1.0;                // before the first move
constexpr double kLargestSpeed = 0.2;          // of a calm hand, m/s at a move's peak
constexpr double kLargestTurn = 24 * kDegree;  // rad/s at a move's peak; tremor and overlapping moves come on top
// Amplitudes of a calm hand's tremor at 8-12 Hz. Physiological tremor accelerates a hand by a few tenths of a m/s^2:
// 0.1 mm at 10 Hz is 0.4 m/s^2, and 0.04 degrees turn at up to 2.5 degrees/s.
constexpr double kTremor_m = 0.0001;
constexpr double kTremor_rad = 0.04 * kDegree;
constexpr double kShaky = 4;  // times as much in the "shaky" motion: cold, tired or walking
constexpr double kSway_m = 0.002;
constexpr double kSway_rad = 0.4 * kDegree;

// Where the camera is, what it looks at, and how it is turned about its optical axis.
struct View {
  Vector3d position = Vector3d::Zero();
  Vector3d target = Vector3d::Zero();
  double roll = 0;

  View operator+(const View& o) const { return {position + o.position, target + o.target, roll + o.roll}; }
  View operator-(const View& o) const { return {position - o.position, target - o.target, roll - o.roll}; }
  View operator*(double s) const { return {s * position, s * target, s * roll}; }

  // T_wc: z towards the target, x level before the roll. The target must not be straight below.
  Isometry3d pose() const {
    const Vector3d z = (target - position).normalized();
    const Vector3d x = z.cross(Vector3d::UnitZ()).normalized();
    Matrix3d rotation;
    rotation << x, z.cross(x), z;
    Isometry3d T = Isometry3d::Identity();
    T.linear() = rotation * Eigen::AngleAxisd(roll, Vector3d::UnitZ()).toRotationMatrix();
    T.translation() = position;
    return T;
  }
};

// Minimum-jerk blend: 0 for s <= 0, 1 for s >= 1, twice continuously differentiable, largest slope 15/8.
double blend(double s) {
  s = std::clamp(s, 0.0, 1.0);
  return s * s * s * (10 + s * (-15 + 6 * s));
}

struct Move {
  double start_s = 0;
  double length_s = 1;
  View step;
};

// Three sines of one axis; the sum stays within the amplitude.
struct Wobble {
  std::array<double, 3> amplitude{}, omega{}, phase{};
  Wobble(double size, double low_hz, double high_hz, Random& random) {
    for (size_t i = 0; i < 3; ++i) {
      amplitude[i] = size * random.uniform(0.2, 1.0 / 3);
      omega[i] = 2 * std::numbers::pi * random.uniform(low_hz, high_hz);
      phase[i] = random.uniform(0, 2 * std::numbers::pi);
    }
  }
  double at(double t) const {
    double sum = 0;
    for (size_t i = 0; i < 3; ++i) sum += amplitude[i] * std::sin(omega[i] * t + phase[i]);
    return sum;
  }
};

// Moves one after the other, and a hand's unrest.
class Hand {
 public:
  Hand(const View& start, uint64_t seed, double tremor) : start_(start) {
    Random random(seed, 20);
    for (int axis = 0; axis < 3; ++axis) {
      position_.emplace_back(kSway_m, 0.2, 0.7, random);
      position_.emplace_back(tremor * kTremor_m, 8.0, 12.0, random);
      rotation_.emplace_back(kSway_rad, 0.2, 0.7, random);
      rotation_.emplace_back(tremor * kTremor_rad, 8.0, 12.0, random);
    }
  }

  void add(const Move& move) { moves_.push_back(move); }
  void hold_position() { position_.clear(); }

  Isometry3d at(double t) const {
    View view = start_;
    for (const Move& move : moves_) {
      if (t > move.start_s) view = view + move.step * blend((t - move.start_s) / move.length_s);
    }
    Vector3d shift = Vector3d::Zero();
    Vector3d turn = Vector3d::Zero();
    for (size_t i = 0; i < position_.size(); ++i) shift[static_cast<Eigen::Index>(i / 2)] += position_[i].at(t);
    for (size_t i = 0; i < rotation_.size(); ++i) turn[static_cast<Eigen::Index>(i / 2)] += rotation_[i].at(t);
    Isometry3d T = view.pose();
    const double angle = turn.norm();
    if (angle > 0) T.linear() = T.linear() * Eigen::AngleAxisd(angle, turn / angle).toRotationMatrix();
    T.translation() += shift;
    return T;
  }

 private:
  View start_;
  std::vector<Move> moves_;
  std::vector<Wobble> position_, rotation_;  // two of each axis
};

// ---- views that suit a stage ----

View table_view(const Stage& stage, double azimuth, double slant, double distance, const Vector3d& target,
                double roll) {
  const double angle = stage.azimuth_rad + azimuth;
  const Vector3d away(std::sin(slant) * std::cos(angle), std::sin(slant) * std::sin(angle), std::cos(slant));
  return {target + std::max(distance, stage.min_height_m / std::cos(slant)) * away, target, roll};
}

// The two walls unfolded: place > 0 lies on the wall where the story starts, place < 0 on the other.
View wall_view(const Stage& stage, double place, double height, double distance, double offset, double rise,
               double roll) {
  Vector3d target(std::max(place, 0.0), std::max(-place, 0.0), height);
  // Faces the first wall from 0.9 m of the corner on, both at the corner, then the second.
  const double facing = 0.5 * std::numbers::pi * blend(0.5 * (1 - place / 0.9)) + offset;
  Vector3d position = target + distance * Vector3d(std::sin(facing), std::cos(facing), 0) + Vector3d(0, 0, rise);
  if (stage.mirrored) {
    std::swap(target.x(), target.y());
    std::swap(position.x(), position.y());
  }
  return {position, target, roll};
}

View first_view(const Stage& stage, Random& random) {
  const double roll = random.uniform(-6, 6) * kDegree;
  if (stage.kind == Stage::Kind::kCorner) {
    const double place = random.uniform(0.95, 1.15);
    const double height = random.uniform(1.25, 1.4);
    const double distance = random.uniform(0.8, 0.95);
    const double offset = random.uniform(-10, 5) * kDegree;
    const double rise = random.uniform(-0.12, 0.12);
    return wall_view(stage, place, height, distance, offset, rise, roll);
  }
  const double azimuth = random.uniform(-10, 10) * kDegree;
  const double slant = random.uniform(20, 42) * kDegree;
  const double distance = random.uniform(0.42, 0.62);
  const double x = random.uniform(-0.03, 0.03);
  const double y = random.uniform(-0.03, 0.03);
  return table_view(stage, azimuth, slant, distance, {x, y, 0}, roll);
}

// Somewhere else to look from; progress 0 to 1 leads along the walls.
View another_view(const Stage& stage, double progress, Random& random) {
  const double roll = random.uniform(-12, 12) * kDegree;
  if (stage.kind == Stage::Kind::kCorner) {
    const double place = 1.0 - 1.8 * progress + random.uniform(-0.12, 0.12);
    const double height = random.uniform(1.15, 1.5);
    const double distance = random.uniform(0.6, 0.95);
    const double offset = random.uniform(-12, 12) * kDegree;
    const double rise = random.uniform(-0.2, 0.2);
    return wall_view(stage, place, height, distance, offset, rise, roll);
  }
  const double azimuth = random.uniform(-90, 90) * kDegree;
  const double slant = random.uniform(18, 46) * kDegree;
  const double distance = random.uniform(0.38, 0.72);
  const double radius = 0.32 * std::sqrt(random.uniform(0, 1));
  const double direction = random.uniform(0, 2 * std::numbers::pi);
  return table_view(stage, azimuth, slant, distance, {radius * std::cos(direction), radius * std::sin(direction), 0},
                    roll);
}

double angle_between(const Isometry3d& a, const Isometry3d& b) {
  return Eigen::AngleAxisd(a.linear().transpose() * b.linear()).angle();
}

// The time that a calm hand takes for this step.
double comfortable_time(const View& from, const View& step, double speed) {
  constexpr int kParts = 24;
  double fastest_turn = 0;  // per unit of the blend's argument
  Isometry3d last = from.pose();
  for (int i = 1; i <= kParts; ++i) {
    const Isometry3d next = (from + step * blend(static_cast<double>(i) / kParts)).pose();
    fastest_turn = std::max(fastest_turn, kParts * angle_between(last, next));
    last = next;
  }
  return std::max({0.8, 15.0 / 8 * step.position.norm() / speed, fastest_turn / kLargestTurn});
}

Hand calm_story(const Stage& stage, uint64_t seed, double duration_s, double tremor, bool turn_only) {
  Random random(seed, turn_only ? 22 : 21);
  View view = first_view(stage, random);
  Hand hand(view, seed, tremor);
  if (turn_only) hand.hold_position();

  double t = kHold_s;
  if (!turn_only) {  // the sideways start: the look-at point follows half-way, so that the first view stays in sight
    const double length = random.uniform(0.11, 0.19);
    const double direction = (random.chance(0.5) ? 0 : 180) + random.uniform(-25, 25);
    const Vector3d side = view.pose().linear() * Vector3d(std::cos(direction * kDegree), 0, 0) * length +
                          Vector3d(0, 0, 0.5 * length * std::sin(direction * kDegree));
    Move move{t, random.uniform(2.0, 2.8), {}};
    move.step.position = side;
    move.step.target = 0.5 * Vector3d(side.x(), side.y(), stage.kind == Stage::Kind::kCorner ? side.z() : 0);
    hand.add(move);
    view = view + move.step;
    t += move.length_s + random.uniform(0.0, 0.4);
  }
  while (t < duration_s) {
    const double progress = t / std::max(duration_s, 12.0);
    View best = view;
    double best_fault = 1e9;
    for (int attempt = 0; attempt < 300 && best_fault > 0; ++attempt) {
      View next = another_view(stage, progress, random);
      if (turn_only) next.position = view.position;
      const double length = (next.position - view.position).norm();
      const double turn = angle_between(view.pose(), next.pose());
      // A step of 13 to 32 cm, turning at most 38 degrees (turning alone: 8 to 30 degrees).
      const double fault = turn_only ? std::max({0.0, 8 * kDegree - turn, turn - 30 * kDegree})
                                     : std::max({0.0, 0.13 - length, length - 0.32, 0.5 * (turn - 38 * kDegree)});
      if (fault < best_fault) {
        best_fault = fault;
        best = next;
      }
    }
    Move move{t, 1, best - view};
    move.length_s = comfortable_time(view, move.step, random.uniform(0.6, 1.0) * kLargestSpeed);
    hand.add(move);
    view = best;
    // Sometimes a pause, otherwise the next move begins as this one ends.
    t += move.length_s + (random.chance(0.35) ? random.uniform(0.3, 0.8) : -0.15 * move.length_s);
  }
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

}  // namespace

std::vector<std::string> start_names() {
  return {"start", "steep_start", "turn_start"};
}

Start make_start(const std::string& name, const Scene& scene, uint64_t seed) {
  constexpr double kStory_s = 20;
  constexpr double kMaxShare = 0.55;  // a view's corners are spread otherwise than its area: leave room below 60 %
  Random random(seed, 30);
  const bool turns = name == "turn_start";
  Start start;
  Isometry3d first = start_view(scene, name == "steep_start", random, &start.normal);
  start.plane_share = largest_plane_share(scene, first, random);
  for (int attempt = 0; scene.stage.cluttered && attempt < 40 && start.plane_share > kMaxShare; ++attempt) {
    Vector3d normal;
    const Isometry3d other = start_view(scene, false, random, &normal);
    const double share = largest_plane_share(scene, other, random);
    if (share >= start.plane_share) continue;
    first = other;
    start.normal = normal;
    start.plane_share = share;
  }
  start.distance_m = first_hit(scene, first.translation(), first.linear().col(2));
  if (!std::isfinite(start.distance_m)) start.distance_m = 1;
  start.slant_deg = slant_degrees(first, start.normal);
  const double depth = start.distance_m;

  const auto hand = std::make_shared<StartingHand>(first, seed);
  double t = random.uniform(0.5, 1.0);
  Offset now;
  const auto move_to = [&](const Offset& target, double length_s) {
    hand->add({t, length_s, {target.position - now.position, target.rotation - now.rotation}});
    now = target;
    t += length_s;
  };
  if (turns) {
    const double angle = random.uniform(8, 30);
    const double about = random.uniform(0, 2 * std::numbers::pi);
    const Vector3d axis(std::cos(about), std::sin(about), random.uniform(-0.5, 0.5));
    Offset turned;
    turned.rotation = angle * kDegree * axis.normalized();
    const double turn_s = std::max(0.8, 15.0 / 8 * angle * kDegree / (random.uniform(0.6, 1.2) * kLargestTurn));
    move_to(turned, turn_s);
    t += random.uniform(0, 0.5);
    if (random.chance(0.5)) {
      turned.rotation *= random.uniform(0, 0.3);
      move_to(turned, turn_s);
      t += random.uniform(0, 0.5);
    }
    start.turned_deg = angle;
    hand->hold_position_until(t);
  }

  // Sideways, the look-at point following in part; the axis that turns the view after a shift along d is z x d.
  const Offset base = now;
  start.move_s = t;
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
  move_to(offset_at(shift, 3), std::max(0.8, 15.0 / 8 * start.length_m / speed));
  start.move_end_s = t;
  t += random.uniform(0.2, 0.6);
  while (t < kStory_s) {  // stays near by
    const double angle = random.uniform(0, 2 * std::numbers::pi);
    const double radius = start.length_m * random.uniform(0.5, 1.5);
    const Vector3d next(radius * std::cos(angle), radius * std::sin(angle), start.length_m * random.uniform(-0.3, 0.3));
    const Vector3d step = next - (now.position - base.position);
    move_to(offset_at(next, 5), std::max(0.8, 15.0 / 8 * step.norm() / (random.uniform(0.6, 1.0) * kLargestSpeed)));
    if (random.chance(0.35)) t += random.uniform(0.2, 0.6);
  }
  start.curve = [hand](double t_s) { return hand->at(t_s); };
  return start;
}

std::vector<std::string> motion_names() {
  return {"calm", "shaky", "still", "pure_rotation"};
}

MotionCurve make_motion(const std::string& name, const Stage& stage, uint64_t seed, double duration_s) {
  if (name == "still") {
    Random random(seed, 21);
    const Isometry3d T = first_view(stage, random).pose();
    return [T](double) { return T; };
  }
  const auto hand = std::make_shared<const Hand>(
      calm_story(stage, seed, duration_s, name == "shaky" ? kShaky : 1.0, name == "pure_rotation"));
  return [hand](double t_s) { return hand->at(t_s); };
}

}  // namespace pptam::sim
