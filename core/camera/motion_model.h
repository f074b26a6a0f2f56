// The motion model: last pose, a decaying constant velocity [ptam 5.1], and the full-frame rotation, which corrects the
// prediction of both [phone 4].
//
//   begin_frame() ─▶ full-frame rotation, from expected_motion() ─▶ turn(): T_predicted(), prior()
//     ─▶ believe() when the pose was measured, else miss()
//
// Frames: T_cw takes world to camera. Velocities are (translation, rotation) in the camera's frame, world units/s and
// radians/s. A *believed* pose is one that was measured in its frame.
#pragma once

#include <pocket_ptam/config.h>
#include "camera/full_frame_rotation.h"
#include "camera/pose_update.h"

namespace pptam {

class MotionModel {
 public:
  // dt_s: seconds since the last frame. with_map: there is a map and the last pose is known.
  void begin_frame(float dt_s, bool with_map);
  // Previous camera to present camera, predicted from the velocity alone; the identity without a map.
  const SE3& expected_motion() const { return expected_; }
  // Translation of expected_motion() in mean scene depths, for FullFrameRotation::estimate().
  Vector3f expected_shift() const { return with_map_ ? Vector3f(expected_.t / mean_depth_) : Vector3f::Zero(); }
  // Corrects the prediction by the full-frame rotation where that is well known. rotation: null: no frame before.
  void turn(const RotationEstimate* rotation);

  // Whether the full-frame rotation differs so much from the expected one that it may be that of a thing which moves
  // through the view.
  bool rotation_surprises(const Config& config) const;
  // Predicts anew without the full-frame rotation.
  void disregard_rotation();

  // Valid for the present frame after turn().
  const SE3& T_predicted() const { return T_predicted_; }
  const Matrix3f& R_cp() const { return R_cp_; }       // previous camera to present camera
  bool rotation_seen() const { return rotation_ok_; }  // whether the full-frame rotation succeeded
  float dt_s() const { return dt_s_; }                 // seconds since the last frame
  // Prior of the velocity during this frame's readout, given that its pose is T_cw: the mean velocity since the last
  // pose. Without a believed last pose the model's translation and the full-frame rotation.
  VelocityPrior prior(const SE3& T_cw) const;
  const VelocityPrior& prior() const { return prior_; }  // at the predicted pose
  // Predicted speed of the scene at the image's middle, radians/s.
  float image_speed() const;

  // The frame's pose was measured. dt_s: seconds since the last pose. mean_depth: of the measured points, world units.
  void believe(const PoseUpdate& pose, float dt_s, float mean_depth);
  // The frame's pose was not measured: the prediction becomes the last pose.
  void miss();
  // Starts at a pose that was found by other means (initialisation, relocalisation).
  void start(const SE3& T_cw, const Vector6f& velocity, float mean_depth);
  // Starts at rest, with a last pose that is not believed.
  void start_guess(float mean_depth);
  void stop() { velocity_.setZero(); }
  void lose() { believed_ = 0; }    // the last pose is no longer believed
  void forget();                    // discards the velocity too
  void apply(const Similarity& S);  // the world's coordinates have changed by S

  const SE3& T_cw() const { return T_cw_; }  // last believed or predicted pose
  // Velocity during the readout of the last measured frame.
  const Vector6f& readout_velocity() const { return readout_velocity_; }
  // Mean velocity between the last two believed poses.
  const Vector6f& last_motion() const { return last_motion_; }
  // Velocity at the frame before the last believed one, as the central difference of the poses before and after it.
  bool central_velocity_known() const { return central_known_; }
  const Vector6f& central_velocity() const { return central_velocity_; }
  float mean_depth() const { return mean_depth_; }  // of the scene, world units
  int believed() const { return believed_; }        // number of measured frames in a row
  int missed() const { return missed_; }            // number of frames in a row that were not measured

 private:
  void predict(const Matrix3f& R_cp);

  SE3 T_cw_;
  Vector6f velocity_ = Vector6f::Zero();  // decaying, for the prediction
  Vector6f readout_velocity_ = Vector6f::Zero();
  Vector6f last_motion_ = Vector6f::Zero();
  float last_interval_s_ = 0;  // seconds between the last two believed poses
  Vector6f central_velocity_ = Vector6f::Zero();
  bool central_known_ = false;
  float mean_depth_ = 1;
  int believed_ = 0, missed_ = 0;

  Vector3f last_turn_ = Vector3f::Zero();    // rotation rate of the last frame by turn(), radians/s
  Vector3f turn_before_ = Vector3f::Zero();  // last_turn_ of the frame before
  // Running mean square of its change between frames, per component, (radians/s)^2, and that of the frame before.
  float turn_change_sq_ = 0, change_before_sq_ = 0;

  // State of the present frame.
  float dt_s_ = 0;
  bool with_map_ = false;
  SE3 expected_;
  Matrix3f R_cp_ = Matrix3f::Identity();
  bool rotation_ok_ = false;
  SE3 T_predicted_;
  VelocityPrior prior_;
};

}  // namespace pptam
