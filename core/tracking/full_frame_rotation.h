// The visual gyroscope: rotation between successive frames from the 15x20 level [phone 4].
//
// Direct 3-DOF efficient second-order minimisation with gain and offset, Huber weights. Needs no map and does not
// allocate, so it serves every state. At a narrow field of view what it measures without a map is *apparent* rotation:
// 0.1 m/s sideways at 1 m looks like 5.7 degrees/s. With a map, give the motion model's translation over the scene's
// depth; then only the residual rotation is estimated.
#pragma once

#include "geometry/camera_model.h"
#include "image/pyramid.h"

namespace pptam {

// Level 4 of the pyramid with a 3x3 binomial blur [1 2 1]; edge pixels repeat. small has level 4's size.
void make_small_image(const Pyramid& pyramid, const GreyImage& small);

struct RotationEstimate {
  Matrix3f R_cp = Matrix3f::Identity();        // previous camera to current camera
  Matrix3f covariance = Matrix3f::Identity();  // of omega in R_cp <- exp(omega) R_cp, rad^2
  float residual = 0;                          // rms after gain and offset, grey levels
  int iterations = 0;
  bool ok = false;  // enough overlap and texture, converged
};

// t_over_depth: translation of T_cp divided by the scene's mean depth (zero without a map). Small images as made by
// make_small_image; camera: of level 0.
RotationEstimate estimate_rotation(const GreyView& previous, const GreyView& current, const CameraModel& camera,
                                   const Matrix3f& R_start, const Vector3f& t_over_depth);

}  // namespace pptam
