// Damps the shown pose while the full-frame rotation is zero but for noise, so that a camera at rest is shown at rest
// (Config::steady_damping).
#pragma once

#include "camera/motion_model.h"

namespace pptam {

class StillCamera {
 public:
  // Returns the pose to show for the measured `pose`, which `motion` has taken over already.
  SE3 show(const PoseUpdate& pose, const MotionModel& motion, bool damping);
  // After a change of the world's coordinates. T_cw: the last pose in the new coordinates.
  void apply(const SE3& T_cw) { T_shown_ = T_cw; }

 private:
  SE3 T_shown_;                             // pose shown for the last frame
  int turning_frames_ = 2;                  // turning frames in a row, at most 2
  Vector6f difference_ = Vector6f::Zero();  // running mean of log(T_measured T_shown^-1), while still
};

}  // namespace pptam
