#include "tracking/still_camera.h"

#include <Eigen/Cholesky>
#include <algorithm>

namespace pptam {

namespace {

// Full-frame rotation between two frames up to which the camera counts as still: 0.09 degrees, not swept.
constexpr float kStillTurn_rad = 0.0015f;
constexpr int kTurningFrames = 2;  // turning frames in a row that end the damping: one alone may be noise; not swept
constexpr int kMinBelieved = 2;    // believed poses in a row that are shown undamped; not swept
// Share of the newest difference in the running mean, a ratio: a mean over about six frames. Not swept.
constexpr float kDifferenceBlend = 0.3f;
// Gain of the shown pose: at chi-squared 1 per degree of freedom, the mean of noise, it begins to grow, and 3 above
// that it is 1. Below, the least gain is kept, so that the shown pose still follows slowly. Ratios, not swept.
constexpr float kMinGain = 0.1f;
constexpr int kNoiseChiSq = 1, kChiSqToFollow = 3;
constexpr int kDegreesOfFreedom = 6;
// Noise of a measured patch from frame to frame, pixels of its level [tests/kernels: 0.024 at contrast 50].
constexpr float kPatchNoise = 0.03f;

}  // namespace

// The differences between measured and shown poses are averaged: noise averages out, a movement does not. The mean is
// compared with its expected noise by chi-squared per degree of freedom. At 1 or less the shown pose follows slowly, at
// 4 or more at once.
SE3 StillCamera::show(const PoseUpdate& pose, const MotionModel& motion, bool damping) {
  // A single turning frame is taken for noise; a real movement still shows in the difference of the poses.
  const bool turning = !motion.rotation_seen() || so3_log(motion.R_cp()).norm() > kStillTurn_rad;
  turning_frames_ = turning ? std::min(turning_frames_ + 1, kTurningFrames) : 0;
  if (!damping || motion.believed() <= kMinBelieved || turning_frames_ == kTurningFrames) {
    T_shown_ = pose.T_cw;
    difference_.setZero();
    return T_shown_;
  }
  const Vector6f difference = (pose.T_cw * T_shown_.inverse()).log();
  difference_ += kDifferenceBlend * (difference - difference_);
  // The pose's covariance includes errors of the map, which stay the same from frame to frame. Only the patches' noise
  // changes, so the covariance is scaled to it, and to a running mean's variance blend / (2 - blend).
  const float noise = kPatchNoise / pose.sigma;
  const Matrix6f covariance = pose.covariance * (noise * noise * kDifferenceBlend / (2 - kDifferenceBlend));
  // Scaled to a unit diagonal: float32 cannot factorise world units and radians of very different size together.
  const Vector6f unit = covariance.diagonal().cwiseSqrt().cwiseInverse();
  const Matrix6f scaled = unit.asDiagonal() * covariance * unit.asDiagonal();
  const Vector6f x = unit.cwiseProduct(difference_);
  const float chi_sq = x.dot(scaled.ldlt().solve(x)) / kDegreesOfFreedom;
  const float gain = chi_sq >= 0 ? std::clamp((chi_sq - kNoiseChiSq) / kChiSqToFollow, kMinGain, 1.0f) : 1.0f;
  T_shown_ = SE3::exp(gain * difference) * T_shown_;
  T_shown_.R = orthonormalised(T_shown_.R);
  return T_shown_;
}

}  // namespace pptam
