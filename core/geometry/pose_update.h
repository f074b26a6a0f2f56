// Camera pose from measured map points, rolling shutter included [ptam 5.4; phone 4].
//
// Minimises the Tukey-weighted reprojection error over the pose T_cw at the frame's timestamp and, with a rolling
// shutter, over the camera's velocity during the readout, which has a prior from the motion model:
//   e_i = (m_i - project(exp(dt(m_i) velocity) T_cw p_i)) / sigma_i.
// At most eleven reweighted Gauss-Newton iterations; the scale is re-estimated in each from the median. Points are
// projected in three of them and followed by their Jacobians in the others.
#pragma once

#include <span>

#include "base/work_meter.h"
#include "geometry/camera_model.h"
#include "geometry/se3.h"

namespace pptam {

struct PosePoint {
  Vector3f p_w = Vector3f::Zero();
  Vector2f px = Vector2f::Zero();  // measured, level-0 pixels
  float sigma = 1;                 // level-0 pixels
  float weight = 0;                // result: final Tukey weight, 0 for outliers
  float error_sq = 0;              // result: squared error / sigma^2
};

// How far the velocity during a readout may be from what the motion to the neighbouring frames says, 1-sigma of each
// component for a calm hand: tremor of 0.04 degrees and 0.1 mm at 10 Hz turns at about 0.015 radians/s rms. Emulated,
// 0.02 of both, five runs each: error of the path 0.095 % on desks, 0.118 boxes, 0.287 walls; half of the rotation's
// 0.095, 0.137, 0.313; four times as much 0.120, 0.140, 0.366.
constexpr float kVelocitySigmaRotation = 0.02f;      // radians/s
constexpr float kVelocitySigmaTranslation = 0.015f;  // mean scene depths/s

// The velocity expected at the pose exp(mu) T_start is mean + rate_per_s * mu: who has moved further was faster.
struct VelocityPrior {
  Vector6f mean = Vector6f::Zero();  // translation (world units/s), rotation (radians/s)
  float rate_per_s = 0;              // 0: independent of the pose
  float sigma_translation = 0;       // 1-sigma of each component; 0: velocity is fixed to the mean
  float sigma_rotation = 0;
};

struct PoseUpdate {
  SE3 T_cw;
  Vector6f velocity = Vector6f::Zero();
  Matrix6f covariance = Matrix6f::Zero();  // of mu in T_cw <- exp(mu) T_cw, velocity marginalised
  float sigma = 0;                         // robust scale: 1-sigma of a coordinate, in units of the points' sigma
  float cost = 0;                          // sum of Tukey costs at that scale, floor as given
  int inliers = 0;                         // points of non-zero weight
  bool ok = false;  // at least 6 inliers and a well-conditioned system; otherwise T_cw is the start
};

// sigma_floor: smallest robust scale, in units of the points' sigma; keeps a handful of perfect points from rejecting
// all others. points' weight and error_sq are written.
PoseUpdate update_pose(const CameraModel& camera, const RollingShutter& shutter, const SE3& T_start,
                       const VelocityPrior& prior, std::span<PosePoint> points, float sigma_floor, WorkMeter& meter);

// The same in pieces, parts of an iteration, for background jobs that pause in between:
//
//   updater.start(...);
//   while (!updater.advance()) co_await slice();
//   use(updater.result());
//
// The points must stay where they are until then. 19 KB.
class PoseUpdater {
 public:
  void start(const CameraModel& camera, const RollingShutter& shutter, const SE3& T_start, const VelocityPrior& prior,
             std::span<PosePoint> points, float sigma_floor, WorkMeter& meter);
  bool advance();  // true at the end
  const PoseUpdate& result() const { return result_; }

 private:
  static constexpr int kMaxPoints = 256;    // more are left out
  static constexpr int kSummedAtOnce = 64;  // points
  // A point's error e = e_0 - J (mu + dt velocity step), both rows divided by sigma.
  struct Row {
    float J[2][6];
    float e_0[2];
    float e[2];
    float dt_s;
    bool valid;
  };
  // Sums over the points of w J^T J and w J^T e, upper triangles row by row, with the factors 1, dt and dt^2.
  struct Sums {
    float A[21], A_dt[21], A_dt2[21];
    float b[6], b_dt[6];
    void add(const Row& row, float weight);
  };
  enum class Piece : uint8_t { kErrors, kScale, kSums, kEnd };
  // Each returns what comes next.
  Piece project();
  Piece follow();
  Piece estimate_scale();
  Piece sum_up();
  Piece solve();

  const CameraModel* camera_ = nullptr;
  WorkMeter* meter_ = nullptr;
  SE3 T_start_;
  VelocityPrior prior_;
  std::span<PosePoint> points_;
  float sigma_floor_ = 0;
  bool velocity_free_ = false;

  Piece next_ = Piece::kEnd;
  int iteration_ = 0;
  bool full_ = false;     // this iteration's errors are exact
  bool confirm_ = false;  // the last step was small, but taken from errors that are not
  int valid_ = 0;         // points that project
  int summed_ = 0;        // points
  float mean_depth_ = 1;
  SE3 T_;              // of the last full projection
  Vector6f velocity_;  // the same
  Vector6f mu_;        // since then
  Vector6f faster_;    // the same, of the velocity
  Vector6f moved_;     // all steps since T_start, to first order
  Sums sums_;
  Row rows_[kMaxPoints];
  PoseUpdate result_;
};

// T_cw at dt_s after the frame's timestamp.
inline SE3 pose_at(const SE3& T_cw, const Vector6f& velocity, float dt_s) {
  return dt_s == 0 ? T_cw : SE3::exp(velocity * dt_s) * T_cw;
}

// exp(dt velocity) q, a point of the camera's frame dt_s later. To third order: 0.002 px are left at 200 degrees/s and
// 30 ms on the phone.
inline Vector3f moved_point(const Vector3f& q, const Vector6f& velocity, float dt_s) {
  if (dt_s == 0) return q;
  const Vector3f omega = velocity.tail<3>();
  const Vector3f first = dt_s * (velocity.head<3>() + omega.cross(q));
  const Vector3f second = 0.5f * dt_s * omega.cross(first);
  return q + first + second + (dt_s / 3.0f) * omega.cross(second);
}

// Projects p_w with the pose of the line on which it falls. Two fixed-point passes: the line is left wrong by about
// (image speed / readout speed)^2 of the first pass' shift, under 0.05 px up to 300 px/s on the phone.
bool project_rolling(const CameraModel& camera, const RollingShutter& shutter, const SE3& T_cw,
                     const Vector6f& velocity, const Vector3f& p_w, Vector2f* px, SE3* T_line);

}  // namespace pptam
