// Decides when initialisation begins: at a tap, or by itself after the camera was held still (Config::auto_start).
#pragma once

#include <pocket_ptam/config.h>
#include <pocket_ptam/track_result.h>
#include "camera/motion_model.h"
#include "tracking/frame_input.h"

namespace pptam {

class StartTrigger {
 public:
  explicit StartTrigger(const Config& config) : config_(config) {}

  void tap() { tapped_ = true; }
  void reset() {
    tapped_ = false;
    steady_s_ = 0;
  }
  // Called once a frame while there is no map and no start. A tap stays pending until reset(). *hint says what is
  // missing.
  bool wants_start(const FrameInput& frame, const MotionModel& motion, Hint* hint);

 private:
  const Config& config_;
  bool tapped_ = false;
  float steady_s_ = 0;  // time for which the camera has been held still
};

}  // namespace pptam
