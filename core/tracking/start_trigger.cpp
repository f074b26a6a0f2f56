#include "tracking/start_trigger.h"

namespace pptam {

namespace {

// Rest before initialisation starts by itself: its length, and the apparent rotation in radians/s that a hand at rest
// does not exceed.
constexpr float kSteadyTime_s = 0.3f;
constexpr float kSteadySpeed = 0.2f;

}  // namespace

bool StartTrigger::wants_start(const FrameInput& frame, const MotionModel& motion, Hint* hint) {
  if (tapped_) return true;
  if (!config_.auto_start) return false;
  const bool steady = motion.rotation_seen() && motion.prior().mean.tail<3>().norm() < kSteadySpeed;
  steady_s_ = steady ? steady_s_ + frame.dt_s() : 0;
  if (steady_s_ >= kSteadyTime_s) return true;
  if (frame.has_previous() && !motion.rotation_seen()) {
    *hint = Hint::kTooLittleTexture;       // not even the smallest image can be followed
  } else if (*hint != Hint::kStartLost) {  // bad news stays until the next start
    *hint = Hint::kHoldStill;
  }
  return false;
}

}  // namespace pptam
