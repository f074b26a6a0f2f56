// The visual gyroscope: rotation between successive frames from the 15x20 level [phone 4].
//
// Direct 3-DOF efficient second-order minimisation with gain and offset, Huber weights. Needs no map and does not
// allocate after start, so it serves every state. At a narrow field of view what it measures without a map is
// *apparent* rotation: 0.1 m/s sideways at 1 m looks like 5.7 degrees/s. With a map, give the motion model's
// translation over the scene's depth; then only the residual rotation is estimated.
#pragma once

#include <pocket_ptam/camera_model.h>
#include "base/containers.h"
#include "geometry/normal_equations.h"
#include "image/pyramid.h"

namespace pptam {

struct RotationEstimate {
  Matrix3f R_cp = Matrix3f::Identity();        // previous camera to current camera
  Matrix3f covariance = Matrix3f::Identity();  // of omega in R_cp <- R_cp exp(omega), rad^2
  float residual = 0;                          // rms after gain and offset, grey levels
  int iterations = 0;
  bool ok = false;    // enough overlap and texture, converged
  bool near = false;  // the same but for the last: a start for what searches coarsely
};

class FullFrameRotation {
 public:
  FullFrameRotation(Arena& arena, const CameraModel& camera);  // camera: of level 0, prepared

  // t_over_depth: translation of T_cp divided by the scene's mean depth (zero without a map). Small images as made by
  // make_small_image, of the camera's size.
  RotationEstimate estimate(const GreyView& previous, const GreyView& current, const Matrix3f& R_start,
                            const Vector3f& t_over_depth);

 private:
  friend class RobustFit<FullFrameRotation>;
  struct Pixel {       // of the small image
    Vector2f ray;      // (x/z, y/z)
    Matrix23f J_px_w;  // small-image pixels per radian of omega, p <- exp(omega) p
  };
  // I_c(project(R exp(omega) x + t/d)) = gain(x) I_p(x) + offset, over the interior pixels of the previous image. The
  // gain is a plane: when the camera turns, a point moves to where vignetting darkens it differently. (One gain for all
  // pixels: 0.46 degrees rms off in place of 0.10, at up to 60 degrees/s with natural vignetting.)
  struct Gain {
    float gain = 1, x = 0, y = 0, offset = 0;
  };
  static constexpr int kUnknowns = 7;  // omega, gain, offset, gain_x, gain_y

  // What RobustFit asks for. Its residuals are the image's rows.
  bool errors(int iteration);
  void scale();
  int residuals() const { return height_; }
  void sum(int from, int to);
  FitStep step(int iteration);

  void warp(const GreyView& current, const Matrix3f& R_cp, const Vector3f& t_over_depth);
  void sum_row(int y);

  CameraModel camera_;
  int width_, height_;
  FixedVector<Pixel> pixels_;
  FixedVector<int16_t> warped_;  // the current image as the previous camera would see it, 1/16 grey; kOutside elsewhere

  // Of the present estimate.
  GreyView previous_, current_;
  Vector3f t_over_depth_;
  Gain gain_;
  NormalEquations<kUnknowns> equations_;
  float cost_ = 0;
  int count_ = 0;  // pixels
  RotationEstimate result_;
};

}  // namespace pptam
