#include "sim_phone/hand.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace pptam::sim {

using Eigen::Isometry3d;
using Eigen::Matrix3d;

Isometry3d View::pose() const {
  const Vector3d z = (target - position).normalized();
  const Vector3d x = z.cross(Vector3d::UnitZ()).normalized();
  Matrix3d rotation;
  rotation << x, z.cross(x), z;
  Isometry3d T = Isometry3d::Identity();
  T.linear() = rotation * Eigen::AngleAxisd(roll, Vector3d::UnitZ()).toRotationMatrix();
  T.translation() = position;
  return T;
}

double blend(double s) {
  s = std::clamp(s, 0.0, 1.0);
  return s * s * s * (10 + s * (-15 + 6 * s));
}

Wobble::Wobble(double size, double low_hz, double high_hz, Random& random) {
  for (size_t i = 0; i < 3; ++i) {
    amplitude[i] = size * random.uniform(0.2, 1.0 / 3);
    omega[i] = 2 * std::numbers::pi * random.uniform(low_hz, high_hz);
    phase[i] = random.uniform(0, 2 * std::numbers::pi);
  }
}

double Wobble::at(double t) const {
  double sum = 0;
  for (size_t i = 0; i < 3; ++i) sum += amplitude[i] * std::sin(omega[i] * t + phase[i]);
  return sum;
}

Unrest::Unrest(uint64_t seed, double tremor) {
  Random random(seed, 20);
  for (int axis = 0; axis < 3; ++axis) {
    position_.emplace_back(kSway_m, 0.2, 0.7, random);
    position_.emplace_back(tremor * kTremor_m, 8.0, 12.0, random);
    rotation_.emplace_back(kSway_rad, 0.2, 0.7, random);
    rotation_.emplace_back(tremor * kTremor_rad, 8.0, 12.0, random);
  }
}

Isometry3d Unrest::applied(const Isometry3d& T, double t, double amount) const {
  Vector3d shift = Vector3d::Zero();
  Vector3d turn = Vector3d::Zero();
  for (size_t i = 0; i < position_.size(); ++i) shift[static_cast<Eigen::Index>(i / 2)] += position_[i].at(t);
  for (size_t i = 0; i < rotation_.size(); ++i) turn[static_cast<Eigen::Index>(i / 2)] += rotation_[i].at(t);
  Isometry3d moved = T;
  const double angle = amount * turn.norm();
  if (angle > 0) moved.linear() = T.linear() * Eigen::AngleAxisd(angle, turn.normalized()).toRotationMatrix();
  moved.translation() += amount * shift;
  return moved;
}

View Hand::view_at(double t) const {
  View view = start_;
  for (const Move& move : moves_) {
    if (t > move.start_s) view = view + move.step * blend((t - move.start_s) / move.length_s);
  }
  return view;
}

View table_view(const Stage& stage, double azimuth, double slant, double distance, const Vector3d& target,
                double roll) {
  const double angle = stage.azimuth_rad + azimuth;
  const Vector3d away(std::sin(slant) * std::cos(angle), std::sin(slant) * std::sin(angle), std::cos(slant));
  return {target + std::max(distance, stage.min_height_m / std::cos(slant)) * away, target, roll};
}

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

double comfortable_time(const View& from, const View& step, double speed, double haste) {
  constexpr int kParts = 24;
  double fastest_turn = 0;  // per unit of the blend's argument
  Isometry3d last = from.pose();
  for (int i = 1; i <= kParts; ++i) {
    const Isometry3d next = (from + step * blend(static_cast<double>(i) / kParts)).pose();
    fastest_turn = std::max(fastest_turn, kParts * angle_between(last, next));
    last = next;
  }
  const double least_s = 0.8 / (1 + haste);
  return std::max({least_s, 15.0 / 8 * step.position.norm() / speed, fastest_turn / (kMaxTurn * (1 + haste))});
}

void Walk::move_to(const View& next, double length_s) {
  hand.add({t_s, length_s, next - view});
  view = next;
  t_s += length_s;
}

void Walk::start_sideways() {
  const double length = random.uniform(0.11, 0.19);
  const double direction = (random.chance(0.5) ? 0 : 180) + random.uniform(-25, 25);
  const Vector3d side = view.pose().linear() * Vector3d(std::cos(direction * kDegree), 0, 0) * length +
                        Vector3d(0, 0, 0.5 * length * std::sin(direction * kDegree));
  Move move{t_s, random.uniform(2.0, 2.8), {}};
  move.step.position = side;
  move.step.target = 0.5 * Vector3d(side.x(), side.y(), stage.kind == Stage::Kind::kCorner ? side.z() : 0);
  hand.add(move);
  view = view + move.step;
  t_s += move.length_s + random.uniform(0.0, 0.4);
}

View Walk::somewhere_else(double progress, bool turn_only) const {
  // In haste to and fro along walls, and farther over tables.
  if (haste > 0) progress = 1 - std::abs(1 - std::fmod((1 + haste) * progress, 2.0));
  View next = another_view(stage, progress, random);
  if (turn_only) {
    next.position = view.position;
  } else if (stage.kind == Stage::Kind::kTable) {
    const Vector3d farther = 0.3 * haste * next.target;
    next.position += farther;
    next.target += farther;
  }
  return next;
}

void Walk::explore(double until_s, double story_s, bool turn_only) {
  // A step of 13 to 32 cm, turning at most 38 degrees (turning alone: 8 to 30 degrees); in haste it is longer and leads
  // to another part of the scene.
  const double shortest = 0.13 + 0.08 * haste, longest = 0.32 + 0.12 * haste, elsewhere = 0.12 * haste;
  while (t_s < until_s) {
    const double progress = t_s / story_s;
    View best = view;
    double best_fault = 1e9;
    for (int attempt = 0; attempt < 300 && best_fault > 0; ++attempt) {
      const View next = somewhere_else(progress, turn_only);
      const double length = (next.position - view.position).norm();
      const double turn = angle_between(view.pose(), next.pose());
      const double fault = turn_only ? std::max({0.0, 8 * kDegree - turn, turn - 30 * kDegree})
                                     : std::max({0.0, shortest - length, length - longest, 0.5 * (turn - 38 * kDegree),
                                                 elsewhere - (next.target - view.target).norm()});
      if (fault < best_fault) {
        best_fault = fault;
        best = next;
      }
    }
    Move move{t_s, 1, best - view};
    const double speed = random.uniform(0.6, 1.0) * kMaxSpeed * (1 + haste);
    move.length_s = comfortable_time(view, move.step, speed, haste);
    hand.add(move);
    view = best;
    // Sometimes a pause, otherwise the next move begins as this one ends.
    t_s += move.length_s + (random.chance(0.35) ? random.uniform(0.3, 0.8) : -0.15 * move.length_s);
  }
}

}  // namespace pptam::sim
