// A camera that stands still is shown still: the pose is damped while the full frame says that nothing turns
// (Config::steady_damping).
#pragma once

#include "camera/motion_model.h"

namespace pptam {

class StillCamera {
 public:
  // The pose to show for a measured one. `motion` has taken it over already.
  SE3 show(const PoseUpdate& pose, const MotionModel& motion, bool damping);
  void apply(const SE3& T_cw) {
    T_shown_ = T_cw;
  }  // the world's coordinates have changed: the last pose in the new ones

 private:
  SE3 T_shown_;                             // the last one
  int turning_frames_ = 2;                  // successive ones that seem to turn; 2 or more are 2
  Vector6f difference_ = Vector6f::Zero();  // mean of the measured poses' differences to it, while still
};

}  // namespace pptam
