// A camera: lens model and rolling shutter. Predicts where and when a world point appears in the image.
//
// A rolling shutter exposes each image line at its own time dt, relative to the frame's timestamp: a moving camera sees
// p_w at exp(dt velocity) T_cw p_w. All code that needs pixels of a moving camera uses these functions. The exception
// is bundle adjustment, whose objective has its own first-order model (mapping/bundle_engine.h).
//
// Frames: T_cw takes world to camera at the frame's timestamp. velocity = (translation, rotation), world units/s and
// radians/s: T_cw(t + dt) = exp(dt velocity) T_cw(t). Pixels are level 0. All functions are pure.
#pragma once

#include <pocket_ptam/camera_model.h>
#include <pocket_ptam/se3.h>

namespace pptam {

// A measured image position and the pyramid level at which it was searched.
struct ImagePoint {
  Vector2f px = Vector2f::Zero();  // level-0 pixels, as measured: the rolling shutter is not corrected
  uint8_t level = 1;               // pyramid level, 0 to 4; L1 is the level searched in [phone 4]

  // Expected standard deviation of a coordinate, level-0 pixels: one pixel of the level [ptam 5.4].
  float sigma() const { return static_cast<float>(1 << level); }
};

// Where a world point should appear.
struct PredictedPoint {
  Vector2f px = Vector2f::Zero();
  SE3 T_cw;                              // camera pose at the exposure time of the line through px
  Vector6f velocity = Vector6f::Zero();  // of the camera: translation (world units/s), rotation (radians/s)
};

struct Camera {
  CameraModel model;
  RollingShutter shutter;  // line_time_s = 0: global shutter

  // Time of a pixel's line relative to the frame's timestamp, seconds.
  float dt_s(const Vector2f& px) const { return shutter.dt_s(px, model.width, model.height); }
  // Readout time of the whole image (line time times number of lines), seconds, >= 0; 0 for a global shutter.
  float readout_s() const;

  // Projection without the rolling shutter (a camera at rest): see CameraModel.
  bool project(const Vector3f& p_c, Vector2f* px) const { return model.project(p_c, px); }
  bool project(const Vector3f& p_c, Vector2f* px, Matrix23f* J_px_p) const { return model.project(p_c, px, J_px_p); }
  Vector2f unproject(const Vector2f& px) const { return model.unproject(px); }
  bool in_image(const Vector2f& px, float border) const { return model.in_image(px, border); }

  // Projects p_w (world units) with the camera pose at the exposure time of the line on which it falls. False, *seen
  // unspecified, when CameraModel::project() refuses the point. The line is found by two fixed-point passes. What they
  // leave is about (image speed / readout speed)^2 of the first pass' shift: under 0.05 px up to 300 px/s on the phone.
  bool project_rolling(const SE3& T_cw, const Vector6f& velocity, const Vector3f& p_w, PredictedPoint* seen) const;

  // The pixel at which a global shutter would have seen a point that was measured at px: px - J velocity dt [phone 6].
  // p_c: the point in the camera's frame at the frame's timestamp. Returns px itself when p_c does not project.
  Vector2f global_shutter_px(const Vector6f& velocity, const Vector3f& p_c, const Vector2f& px) const;
};

// Camera pose at dt_s seconds after the frame's timestamp.
inline SE3 pose_at(const SE3& T_cw, const Vector6f& velocity, float dt_s) {
  return dt_s == 0 ? T_cw : SE3::exp(velocity * dt_s) * T_cw;
}

// exp(dt velocity) q: point q of the camera's frame, in the camera's frame dt_s seconds later. The series is cut after
// the third order: the error is 0.002 px at 200 degrees/s and 30 ms on the phone.
inline Vector3f moved_point(const Vector3f& q, const Vector6f& velocity, float dt_s) {
  if (dt_s == 0) return q;
  const Vector3f omega = velocity.tail<3>();
  const Vector3f first = dt_s * (velocity.head<3>() + omega.cross(q));
  const Vector3f second = 0.5f * dt_s * omega.cross(first);
  return q + first + second + (dt_s / 3.0f) * omega.cross(second);
}

}  // namespace pptam
