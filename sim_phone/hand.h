// What motions are made of: views of a stage, minimum-jerk moves between them, and a hand's sway and tremor.
//
// Everything is drawn from a seeded Random and twice continuously differentiable. motion.cpp makes the general motions
// of it, story.cpp those of the stories.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <numbers>
#include <vector>

#include "sim_phone/random.h"
#include "sim_phone/scene.h"

namespace pptam::sim {

constexpr double kDegree = std::numbers::pi / 180;
constexpr double kHold_s = 1.0;            // before the first move
constexpr double kMaxSpeed = 0.2;          // of a calm hand, m/s at a move's peak
constexpr double kMaxTurn = 24 * kDegree;  // rad/s at a move's peak; tremor and overlapping moves come on top
// Amplitudes of a calm hand's tremor at 8-12 Hz. Physiological tremor accelerates a hand by a few tenths of a m/s^2:
// 0.1 mm at 10 Hz is 0.4 m/s^2, and 0.04 degrees turn at up to 2.5 degrees/s.
constexpr double kTremor_m = 0.0001;
constexpr double kTremor_rad = 0.04 * kDegree;
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
  Eigen::Isometry3d pose() const;
};

// Minimum-jerk blend: 0 for s <= 0, 1 for s >= 1, twice continuously differentiable, largest slope 15/8.
double blend(double s);

struct Move {
  double start_s = 0;
  double length_s = 1;
  View step;
};

// Three sines of one axis; the sum stays within the amplitude.
struct Wobble {
  std::array<double, 3> amplitude{}, omega{}, phase{};
  Wobble(double size, double low_hz, double high_hz, Random& random);
  double at(double t) const;
};

// A hand's sway and tremor; tremor is a factor on that of a calm hand.
class Unrest {
 public:
  Unrest(uint64_t seed, double tremor);
  void hold_position() { position_.clear(); }
  // T_wc moved by amount times the unrest at t.
  Eigen::Isometry3d applied(const Eigen::Isometry3d& T, double t, double amount = 1) const;

 private:
  std::vector<Wobble> position_, rotation_;  // two of each axis
};

// Moves one after the other, and a hand's unrest.
class Hand {
 public:
  Hand(const View& start, uint64_t seed, double tremor) : start_(start), unrest_(seed, tremor) {}

  void add(const Move& move) { moves_.push_back(move); }
  void hold_position() { unrest_.hold_position(); }
  View view_at(double t) const;  // of the moves alone
  const Unrest& unrest() const { return unrest_; }
  Eigen::Isometry3d at(double t) const { return unrest_.applied(view_at(t).pose(), t); }

 private:
  View start_;
  std::vector<Move> moves_;
  Unrest unrest_;
};

// kTable: from the stage's azimuth turned by azimuth, slanted against the table's normal, distance along the axis but
// not lower than the stage allows.
View table_view(const Stage& stage, double azimuth, double slant, double distance, const Vector3d& target, double roll);
View first_view(const Stage& stage, Random& random);
// Somewhere else to look from; progress 0 to 1 leads along the walls.
View another_view(const Stage& stage, double progress, Random& random);
// kCorner: the two walls unfolded: place > 0 lies on the wall where the story starts, place < 0 on the other.
View wall_view(const Stage& stage, double place, double height, double distance, double offset, double rise,
               double roll);

double angle_between(const Eigen::Isometry3d& a, const Eigen::Isometry3d& b);
// The time that a calm hand takes for this step.
// haste: 0, or how much faster still it turns.
double comfortable_time(const View& from, const View& step, double speed, double haste = 0);

// A hand on its way: view is where the last move leads, t_s when the next may begin.
struct Walk {
  const Stage& stage;
  Random& random;
  Hand& hand;
  View view;
  double t_s = kHold_s;
  double haste = 0;  // Harshness::haste, of explore()

  void move_to(const View& next, double length_s);
  // The sideways start of 11 to 19 cm: the look-at point follows half-way, so that the first view stays in sight.
  void start_sideways();
  // Calm moves until until_s or a little longer. story_s: over which the walls are walked along. turn_only: on the
  // spot.
  void explore(double until_s, double story_s, bool turn_only = false);
  View somewhere_else(double progress, bool turn_only) const;
};

}  // namespace pptam::sim
