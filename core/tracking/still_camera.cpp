#include "tracking/still_camera.h"

#include <Eigen/Cholesky>
#include <algorithm>

namespace pptam {

namespace {

// Turn of the image between two frames that says so, 0.09 degrees: a starting point, not swept.
constexpr float kStillTurn_rad = 0.0015f;
// Share of the newest difference in the mean, and of a difference that is noise in the pose shown.
constexpr float kDifferenceBlend = 0.3f;
constexpr float kSlowestGain = 0.1f;
// Of a measured patch from frame to frame, in pixels of its level [tests/kernels: 0.024 at contrast 50].
constexpr float kPatchNoise = 0.03f;

}  // namespace

// The differences to what is shown are averaged; noise averages out, a movement adds up. Below the noise of such a mean
// (chi-squared over six degrees of freedom of one) the shown pose follows slowly, at a few times it at once.
SE3 StillCamera::show(const PoseUpdate& pose, const MotionModel& motion, bool damping) {
  // One frame that seems to turn is noise, unless the pose says so too.
  const bool turning = !motion.rotation_seen() || so3_log(motion.R_cp()).norm() > kStillTurn_rad;
  turning_frames_ = turning ? std::min(turning_frames_ + 1, 2) : 0;
  if (!damping || motion.believed() <= 2 || turning_frames_ == 2) {
    T_shown_ = pose.T_cw;
    difference_.setZero();
    return T_shown_;
  }
  const Vector6f difference = (pose.T_cw * T_shown_.inverse()).log();
  difference_ += kDifferenceBlend * (difference - difference_);
  // The covariance counts all that the map does not explain; from frame to frame only the patches' noise changes.
  const float noise = kPatchNoise / pose.sigma;
  const Matrix6f covariance = pose.covariance * (noise * noise * kDifferenceBlend / (2 - kDifferenceBlend));
  // Scaled to a unit diagonal: float32 would not bear metres beside radians.
  const Vector6f unit = covariance.diagonal().cwiseSqrt().cwiseInverse();
  const Matrix6f scaled = unit.asDiagonal() * covariance * unit.asDiagonal();
  const Vector6f x = unit.cwiseProduct(difference_);
  const float chi_sq = x.dot(scaled.ldlt().solve(x)) / 6;
  const float gain = chi_sq >= 0 ? std::clamp((chi_sq - 1) / 3, kSlowestGain, 1.0f) : 1.0f;
  T_shown_ = SE3::exp(gain * difference) * T_shown_;
  T_shown_.R = orthonormalised(T_shown_.R);
  return T_shown_;
}

}  // namespace pptam
