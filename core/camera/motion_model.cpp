#include "camera/motion_model.h"

#include <algorithm>
#include <cmath>

#include "base/deterministic_math.h"

namespace pptam {

namespace {

// The decaying velocity model [ptam 5.1]. None of these was swept.
constexpr float kVelocityBlend = 0.7f;      // share of the newest measured velocity in the velocity, ratio
constexpr float kVelocityDecayRate = 1.6f;  // 1/s, at measured frames: a velocity keeps 0.90 of itself at 15 Hz
constexpr float kMissedDecayRate = 3.0f;    // 1/s, at frames whose pose is not measured: keeps 0.80 of itself at 15 Hz

// Prior sigma of the rotation rate during a readout, about the mean since the last frame: kTurnChangeShare times the
// rms change of the rotation rate from frame to frame, within kVelocitySigmaRotation (a calm hand) and
// kMaxSigmaRotation. None of these was swept.
constexpr float kTurnChangeShare = 0.5f;   // ratio
constexpr float kTurnChangeBlend = 0.1f;   // share of the newest change in the running mean: about ten frames
constexpr float kMaxSigmaRotation = 0.3f;  // radians/s

// 1-sigma of the full-frame rotation about both axes across the optical one, radians, from which on the motion so far
// predicts better: a third of a search's reach. Before a pattern about as fine as the small image's pixels the rotation
// is noise, or off by a period. Emulated desks and dim rooms have 0.004; of 20 starts on tiles all alike, seen from 0.5
// to 1.5 m, 11 are right where any rotation is used, 15 with 0.01 and 19 with 0.007.
constexpr float kMaxTurnSigma = 0.007f;

// Between the full-frame rotation and the expected one, the angle in level-0 px at the focal length: the reach of a
// search in level 1. Not swept.
constexpr float kSurprise_px = 8.0f;

}  // namespace

void MotionModel::begin_frame(float dt_s, bool with_map) {
  dt_s_ = dt_s;
  with_map_ = with_map;
  expected_ = with_map ? SE3::exp(velocity_ * dt_s) : SE3();
}

void MotionModel::turn(const RotationEstimate* rotation) {
  rotation_ok_ = rotation && rotation->ok;
  turn_before_ = last_turn_;
  change_before_sq_ = turn_change_sq_;
  const auto sure = [](const Matrix3f& covariance) {
    return covariance(0, 0) + covariance(1, 1) < kMaxTurnSigma * kMaxTurnSigma;
  };
  const bool used = rotation_ok_ && sure(rotation->covariance);
  predict(used ? rotation->R_cp : rotation ? expected_.R : Matrix3f(Matrix3f::Identity()));
}

void MotionModel::predict(const Matrix3f& R_cp) {
  R_cp_ = R_cp;
  last_turn_ = so3_log(R_cp) / dt_s_;
  turn_change_sq_ =
      change_before_sq_ + kTurnChangeBlend * ((last_turn_ - turn_before_).squaredNorm() / 3 - change_before_sq_);
  T_predicted_ = SE3(R_cp_, expected_.t) * T_cw_;
  T_predicted_.R = orthonormalised(T_predicted_.R);
  prior_ = prior(T_predicted_);
}

bool MotionModel::rotation_surprises(const Config& config) const {
  if (!with_map_ || !rotation_ok_) return false;
  return so3_log(R_cp_ * expected_.R.transpose()).norm() * config.camera.model.fx > kSurprise_px * config.px_scale();
}

void MotionModel::disregard_rotation() {
  rotation_ok_ = false;
  predict(expected_.R);
}

VelocityPrior MotionModel::prior(const SE3& T_cw) const {
  VelocityPrior prior;
  prior.sigma_rotation =
      std::clamp(kTurnChangeShare * std::sqrt(turn_change_sq_), kVelocitySigmaRotation, kMaxSigmaRotation);
  prior.sigma_translation = prior.sigma_rotation * (kVelocitySigmaTranslation / kVelocitySigmaRotation) * mean_depth_;
  if (believed_ < 1) {
    prior.mean.head<3>() = velocity_.head<3>();
    prior.mean.tail<3>() = so3_log(R_cp_) / dt_s_;
    return prior;
  }
  prior.mean = (T_cw * T_cw_.inverse()).log() / dt_s_;
  prior.rate_per_s = 1 / dt_s_;
  return prior;
}

float MotionModel::image_speed() const {
  const Vector3f omega = prior_.mean.tail<3>();
  const Vector3f v = with_map_ ? Vector3f(velocity_.head<3>() / mean_depth_) : Vector3f::Zero();
  return std::sqrt((omega.y() + v.x()) * (omega.y() + v.x()) + (v.y() - omega.x()) * (v.y() - omega.x()));
}

void MotionModel::believe(const PoseUpdate& pose, float dt_s, float mean_depth) {
  Vector6f measured = (pose.T_cw * T_cw_.inverse()).log() / dt_s;
  if (missed_ > 0 || believed_ == 0) measured.head<3>().setZero();  // the last pose was not measured
  central_known_ = believed_ >= 2;
  if (central_known_)  // mean of the velocities before and after, weighted by the other one's interval
    central_velocity_ = (dt_s * last_motion_ + last_interval_s_ * measured) / (dt_s + last_interval_s_);
  last_motion_ = measured;
  last_interval_s_ = dt_s;
  const float decay = det_exp(-kVelocityDecayRate * dt_s);
  velocity_ = decay * (kVelocityBlend * measured + (1 - kVelocityBlend) * velocity_);
  T_cw_ = pose.T_cw;
  readout_velocity_ = pose.velocity;
  mean_depth_ = mean_depth;
  missed_ = 0;
  ++believed_;
}

void MotionModel::miss() {
  T_cw_ = T_predicted_;
  velocity_ *= std::max(0.0f, 1.0f - kMissedDecayRate * dt_s_);
  believed_ = 0;
  ++missed_;
}

void MotionModel::start(const SE3& T_cw, const Vector6f& velocity, float mean_depth) {
  T_cw_ = T_cw;
  velocity_ = velocity;
  mean_depth_ = mean_depth;
  missed_ = 0;
  believed_ = 1;
}

void MotionModel::start_guess(float mean_depth) {
  velocity_.setZero();
  mean_depth_ = mean_depth;
  believed_ = 0;
}

void MotionModel::forget() {
  velocity_.setZero();
  missed_ = believed_ = 0;
}

void MotionModel::apply(const Similarity& S) {
  T_cw_ = S.moved(T_cw_);
  for (Vector6f* velocity : {&velocity_, &last_motion_, &readout_velocity_, &central_velocity_})
    velocity->head<3>() *= S.scale;
  mean_depth_ *= S.scale;
}

}  // namespace pptam
