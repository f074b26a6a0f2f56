// The camera's state from frame to frame: the last believed pose, a decaying constant velocity [ptam 5.1], and what the
// full-frame rotation adds to both [phone 4].
//
//   begin_frame() ─▶ full-frame rotation, from expected_motion() ─▶ turn(): pose_predicted(), prior()
//     ─▶ the pose is measured: believe(), or not: miss()
//
// Frames: T_cw takes world to camera. Velocities are (translation, rotation) in the camera's frame, world units/s and
// radians/s.
#pragma once

#include "camera/full_frame_rotation.h"
#include "camera/pose_update.h"

namespace pptam {

class MotionModel {
 public:
  // dt_s: since the last frame. with_map: there is a map and the last pose is known.
  void begin_frame(float dt_s, bool with_map);
  // Previous camera to present camera, by the velocity alone; the identity without a map.
  const SE3& expected_motion() const { return expected_; }
  // Its translation in mean depths: what the full-frame rotation is not to take for turning.
  Vector3f expected_shift() const { return with_map_ ? Vector3f(expected_.t / mean_depth_) : Vector3f::Zero(); }
  // rotation: null when there is no previous frame.
  void turn(const RotationEstimate* rotation);

  // Of the present frame.
  const SE3& T_predicted() const { return T_predicted_; }
  const Matrix3f& R_cp() const { return R_cp_; }       // previous camera to present camera
  bool rotation_seen() const { return rotation_ok_; }  // by the full frame
  float dt_s() const { return dt_s_; }
  // What the last pose says of the velocity at this frame's timestamp, if the pose is T_cw: the mean since then.
  // Without a believed last pose the rotation seen by the full frame.
  VelocityPrior prior(const SE3& T_cw) const;
  const VelocityPrior& prior() const { return prior_; }  // at the predicted pose
  // Of the image's middle, radians/s.
  float image_speed() const;

  // The frame's pose has been measured; mean_depth: of the points that were.
  void believe(const PoseUpdate& pose, float dt_s, float mean_depth);
  // It has not: the prediction is all there is.
  void miss();
  // Begins at a pose that something else knows.
  void start(const SE3& T_cw, const Vector6f& velocity, float mean_depth);
  // Begins at a guess, at rest.
  void start_guess(float mean_depth);
  void stop() { velocity_.setZero(); }
  void lose() { believed_ = 0; }    // the last pose is not believed any more
  void forget();                    // nor is any motion
  void apply(const Similarity& S);  // the world's coordinates have changed

  const SE3& T_cw() const { return T_cw_; }  // last believed or predicted pose
  // During the readout of the last measured frame, at its timestamp.
  const Vector6f& readout_velocity() const { return readout_velocity_; }
  // Mean between the last two believed poses.
  const Vector6f& last_motion() const { return last_motion_; }
  // At the frame before the last believed one, by the motion on both sides of it: central difference.
  bool central_velocity_known() const { return central_known_; }
  const Vector6f& central_velocity() const { return central_velocity_; }
  float mean_depth() const { return mean_depth_; }
  int believed() const { return believed_; }  // frames in a row
  int missed() const { return missed_; }      // frames in a row

 private:
  SE3 T_cw_;
  Vector6f velocity_ = Vector6f::Zero();  // motion model's
  Vector6f readout_velocity_ = Vector6f::Zero();
  Vector6f last_motion_ = Vector6f::Zero();
  float last_interval_s_ = 0;  // between the last two believed poses
  Vector6f central_velocity_ = Vector6f::Zero();
  bool central_known_ = false;
  float mean_depth_ = 1;
  int believed_ = 0, missed_ = 0;

  Vector3f last_turn_ = Vector3f::Zero();  // rotation rate that the full frame showed, radians/s
  float turn_change_sq_ = 0;               // running mean square of its change from frame to frame, of each component

  // The present frame's.
  float dt_s_ = 0;
  bool with_map_ = false;
  SE3 expected_;
  Matrix3f R_cp_ = Matrix3f::Identity();
  bool rotation_ok_ = false;
  SE3 T_predicted_;
  VelocityPrior prior_;
};

}  // namespace pptam
